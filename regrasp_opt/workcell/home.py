"""Proof that nothing collides while the robot rests at home; where it does, the file is wrong."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.shapes import Box, Cylinder, Shape
from regrasp_opt.workcell.model import Workcell

Body = tuple[str, int, coal.CollisionObject]
"""Name, joint it moves with (0 for the base), and the body in the world frame."""


def coal_geometry(shape: Shape) -> coal.CollisionGeometry:
    """Return the Coal geometry of `shape`, about its own pose."""
    if isinstance(shape, Box):
        return coal.Box(*map(float, shape.size))
    if isinstance(shape, Cylinder):
        return coal.Cylinder(float(shape.radius), float(shape.length))
    mesh = coal.BVHModelOBBRSS()
    mesh.beginModel(len(shape.faces), len(shape.vertices))
    mesh.addVertices(np.asarray(shape.vertices, dtype=np.float64))
    mesh.addTriangles(np.asarray(shape.faces, dtype=np.int64))
    mesh.endModel()
    return mesh


def collision_at_home(workcell: Workcell) -> tuple[str, str] | None:
    """Return the names of two bodies that collide at the robot's home, or None.

    Tested are the robot with itself, and all that moves (links and end-effector, the jaw wide open) with
    the end-effector, the table and the obstacles. The base may touch what it stands on, and the last two
    links the end-effector.
    """
    robot = workcell.robot
    within = robot.colliding_links(robot.home)
    if within is not None:
        return within
    T_world_joints = workcell.T_world_base @ robot.link_transforms(robot.home)
    T_world_tip = workcell.T_world_base @ robot.forward(robot.home)
    links = [
        (robot.link_of(index), body.parentJoint, _placed(body.geometry, T @ body.placement.homogeneous))
        for index, body in enumerate(robot.collision.geometryObjects)
        for T in [T_world_joints[body.parentJoint - 1] if body.parentJoint else workcell.T_world_base]
    ]
    tool_shapes = (
        *workcell.end_effector.body,
        *workcell.end_effector.finger_boxes(workcell.end_effector.max_opening),
    )
    tool = [_body(shape, robot.dof + 1, T_world_tip) for shape in tool_shapes]
    fixed = [_body(shape, 0, np.eye(4)) for shape in (workcell.table.shape, *workcell.obstacles)]
    return _first_hit([*links, *tool], fixed, 1) or _first_hit(links, tool, 2)


def _first_hit(bodies: list[Body], others: list[Body], apart: int) -> tuple[str, str] | None:
    """Return the first pair that collides, of those whose joints are at least `apart` in the chain."""
    for name, joint, body in bodies:
        for other_name, other_joint, other in others:
            if abs(joint - other_joint) >= apart and coal.collide(
                body, other, coal.CollisionRequest(), coal.CollisionResult()
            ):
                return name, other_name
    return None


def _body(shape: Shape, joint: int, T_world_parent: FloatArray) -> Body:
    return shape.name, joint, _placed(coal_geometry(shape), T_world_parent @ shape.pose)


def _placed(geometry: coal.CollisionGeometry, T: FloatArray) -> coal.CollisionObject:
    return coal.CollisionObject(geometry, coal.Transform3s(pin.SE3(T).rotation, T[:3, 3]))
