"""Which links of a robot collide, asked of Pinocchio through the package's settings."""

import numpy as np
import pinocchio as pin

from regrasp_opt.geometry.solids import Containment, Solid
from regrasp_opt.scene.collision_model import settle_queries


def colliding_links(robot, q):
    """Return the first two links that collide, or of which one is inside the other, at `q` (dof,), or None."""
    geometry, pairs, joints = robot.collision.copy(), robot.self_collision_pairs(), robot.model.createData()
    for i, j in pairs:
        geometry.addCollisionPair(pin.CollisionPair(i, j))
    data, q = geometry.createData(), np.asarray(q, dtype=float)
    settle_queries(data, np.zeros(len(pairs)))
    pin.computeCollisions(robot.model, joints, geometry, data, q, False)
    hits = [k for k, result in enumerate(data.collisionResults) if result.isCollision()]
    solids = [Solid(item.geometry) for item in geometry.geometryObjects]
    hits += Containment(robot.model, joints, geometry, pairs, solids).found(q)
    return tuple(robot.link_of(i) for i in pairs[hits[0]]) if hits else None
