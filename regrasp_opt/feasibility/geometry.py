"""What stands still in a workcell, as Coal collision objects."""

from __future__ import annotations

from typing import Any

import coal

from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.scene import Workcell


def static_bodies(workcell: Workcell) -> list[tuple[Any, str]]:
    """Return what stands fixed besides the table, as Coal collision objects in the world, with what to call each."""
    bodies = []
    for shape in workcell.obstacles:
        pose = coal.Transform3s(shape.pose[:3, :3], shape.pose[:3, 3])
        bodies.append((coal.CollisionObject(shape_geometry(shape), pose), f"the obstacle '{shape.name}'"))
    robot = workcell.arm.robot
    for number, item in enumerate(robot.collision.geometryObjects):
        if item.parentJoint == 0:
            T = workcell.arm.T_world_base @ item.placement.homogeneous
            pose = coal.Transform3s(T[:3, :3], T[:3, 3])
            name = f"the robot's link '{robot.link_of(number)}'" if number in robot.obstacles else "the robot's base"
            bodies.append((coal.CollisionObject(item.geometry, pose), name))
    return bodies
