"""The collision scene of one object in one workcell, arranged for one pose and one grasp at a time.

The gripper's fingers are boxes swept from the grasp width to the width at which the gripper approaches, so one test
covers every opening between the two. Bodies and pairs are those of `regrasp_opt.scene.collision_world` at a grasp.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.solids import overlap
from regrasp_opt.grasps import GraspSet
from regrasp_opt.scene.collision_model import CollisionModel
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase


class CollisionScene(CollisionModel):
    """What the arm may run into at a grasp. Configurations are (dof,), object poses (4, 4) T_world_object."""

    def __init__(self, world: CollisionWorld, grasps: GraspSet) -> None:
        super().__init__(world, ContactPhase.GRASP)
        swept = 2 * world.workcell.arm.end_effector.pre_opening
        self._openings = [(width, width + swept) for width in grasps.width.tolist()]
        self.set_grasp(0)
        self._boxes_first, self._queries = self.test(self.required)
        self._placed = b""
        self._measured = np.array([(i, j, k) for k, (i, j) in enumerate(self.pairs) if j in world.surroundings])
        items = [item.geometry for item in self.geometry.geometryObjects]
        for item in items:
            item.computeLocalAABB()
        self._centers, self._radii = [np.array(g.aabb_center) for g in items], np.array([g.aabb_radius for g in items])

    def place_object(self, T: FloatArray) -> None:
        """Put the object at `T` T_world_object."""
        key = np.asarray(T, dtype=np.float64).tobytes()
        if key != self._placed:
            self._placed = key
            super().place_object(T)

    def set_grasp(self, grasp_id: int) -> None:
        """Open the fingers as grasp `grasp_id` needs them."""
        self.open_jaw(*self._openings[grasp_id])

    def collides(self, q: FloatArray) -> bool:
        """Return whether any pair is nearer than its clearance at configuration `q`, or one body inside the other."""
        touching = pin.computeCollisions(self.model, self.data, self._boxes_first, q, True)
        return bool(touching or self.inside.found(q))

    def collisions(self, q: FloatArray) -> list[tuple[int, int]]:
        """Return the pairs of bodies, by index, that are nearer than their clearance at `q`, or one in the other."""
        pin.computeCollisions(self.model, self.data, self.geometry, self._queries, q, False)
        near = {k for k, result in enumerate(self._queries.collisionResults) if result.isCollision()}
        return [self.pairs[k] for k in sorted(near.union(self.inside.found(q)))]

    def clearance(self, q: FloatArray) -> float:
        """Return the least distance at `q` between arm or gripper and supports, obstacles or (arm only) object [m].

        Negative where bodies overlap or one is in the other. Self-collision is tested, but not part of it: neighbouring
        links are always near each other.
        """
        pin.forwardKinematics(self.model, self.data, q)
        pin.updateGeometryPlacements(self.model, self.data, self.geometry, self._queries)
        poses = self._queries.oMg
        centers = np.array([poses[i].act(c) for i, c in enumerate(self._centers)])
        first, second = self._measured[:, 0], self._measured[:, 1]
        gaps = np.linalg.norm(centers[first] - centers[second], axis=1) - self._radii[first] - self._radii[second]
        solids = self.inside.solids
        inside = set(self.inside.found(q))
        depths = [overlap(solids[i], solids[j]) for i, j, index in self._measured.tolist() if index in inside]
        least = min(depths, default=np.inf)
        for k in np.argsort(gaps):
            if gaps[k] >= least:  # spheres around the bodies are farther apart than the nearest pair so far
                break
            i, j, index = self._measured[k].tolist()
            distance = pin.computeDistance(self.geometry, self._queries, index).min_distance
            if distance <= 0 and solids[i].is_mesh and solids[j].is_mesh:  # Coal says 0 however deep they overlap
                distance = overlap(solids[i], solids[j])
            least = min(least, distance)
        return float(least)
