"""Proof that nothing collides while the robot rests at home; where it does, the file is wrong."""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.shapes import Shape, shape_geometry
from regrasp_opt.geometry.solids import Solid, distance
from regrasp_opt.scene.pairs import arm_pairs
from regrasp_opt.scene.workcell import Workcell


def collision_at_home(workcell: Workcell) -> tuple[str, str] | None:
    """Return the names of two bodies that collide at the robot's home, or None.

    Tested are the robot with itself, the end-effector (the jaw wide open) with the robot, and both with table and
    obstacles. The robot keeps the clearance that it needs from what stands still in its own file.
    """
    robot, effector, pairs = workcell.arm.robot, workcell.arm.end_effector, arm_pairs(workcell)
    within = robot.colliding_links(robot.home, [clearance for *_, clearance in pairs.links])
    if within is not None:
        return within
    frames = workcell.arm.T_world_base @ np.concatenate([np.eye(4)[None], robot.link_transforms(robot.home)])
    links = [
        (robot.link_of(i), Solid(body.geometry), frames[body.parentJoint] @ body.placement.homogeneous)
        for i, body in enumerate(robot.collision.geometryObjects)
    ]
    T_world_tip = workcell.arm.T_world_base @ robot.forward(robot.home)
    tool = [_body(shape, T_world_tip) for shape in (*effector.body, *effector.finger_boxes(effector.max_opening))]
    fixed = [_body(shape, np.eye(4)) for shape in (workcell.table.shape, *workcell.obstacles)]
    moving = [link for link, body in zip(links, robot.collision.geometryObjects, strict=True) if body.parentJoint]
    tests = [(a, b, 0.0) for a in (*moving, *tool) for b in fixed]
    tests += [(links[i], b, clearance) for i, clearance in pairs.tool for b in tool]
    for (name, body, T), (other_name, other, T_other), clearance in tests:
        if distance(body, other, T, T_other) <= clearance:
            return name, other_name
    return None


def _body(shape: Shape, T_world_parent: FloatArray) -> tuple[str, Solid, FloatArray]:
    return shape.name, Solid(shape_geometry(shape)), T_world_parent @ shape.pose
