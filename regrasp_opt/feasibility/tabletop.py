"""What the table rules out for good: grasps that put the gripper or the wrist into it at every pose of a placement.

A planar motion turns an object about the vertical and moves it along the table, so the height of the gripper stays
the same, and so does that of the wrist as far as the last joint's turning does not move it. One test of these bodies
against the table stands for all planar motions that keep them within its edges.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.feasibility.geometry import shape_geometry
from regrasp_opt.grasps import GraspSet
from regrasp_opt.robots import Robot
from regrasp_opt.workcell import Workcell

_ON_AXIS = 1e-6
"""How far from the last joint's axis [m], or turned from it [rad], a body may be that is taken to be symmetric."""


class _Body(NamedTuple):
    geometry: Any
    T_flange_body: FloatArray
    clearance: float


def table_reach(workcell: Workcell, grasps: GraspSet, placements: FloatArray) -> FloatArray:
    """Return how far (S, G) [m] the object's (x, y) must be from the table's edges to prove a grasp infeasible.

    Part of the gripper or of the wrist is then in the table. Infinite where no part of them ever is; the grasp may
    still be infeasible everywhere for other reasons.

    Parameters
    ----------
    placements : (S, 4, 4)
        Stable placements, T_world_object at xi = 0.
    """
    table, effector = workcell.table.shape, workcell.end_effector
    top = coal.CollisionObject(shape_geometry(table), _transform(table.pose))
    margins = workcell.clearance
    fixed = [_Body(shape_geometry(s), s.pose, margins.gripper) for s in effector.body]
    fixed += [_Body(geometry, T, margins.arm) for geometry, T in wrist_bodies(workcell.robot)]
    T_object_flange = grasps.T_object_tcp @ effector.T_tcp_flange
    least = np.full((len(placements), len(grasps)), np.inf)
    for g, width in enumerate(grasps.width.tolist()):
        fingers = effector.finger_boxes(width, effector.pre_opening)
        bodies = [_Body(shape_geometry(s), s.pose, margins.gripper) for s in fingers] + fixed
        T_flange = placements @ T_object_flange[g]
        for body in bodies:
            least[:, g] = np.minimum(least[:, g], _reach(body, T_flange, top, table.pose[:2, 3]))
    return least


def wrist_bodies(robot: Robot) -> list[tuple[Any, FloatArray]]:
    """Return the Coal geometry and ``T_flange_body`` of the arm's bodies that stand still in the flange's frame.

    These are the bodies of the last link, and those of the link before it that are round about the last joint's axis.
    """
    tip = robot.model.frames[robot.model.getFrameId(robot.tip_frame)]
    T_flange_joint = invert(tip.placement.homogeneous)
    last = int(tip.parentJoint)
    T_joint_before = invert(robot.model.jointPlacements[last].homogeneous)
    axis, slides = robot.chain.axes[-1], bool(robot.chain.prismatic[-1])
    found = []
    for item in robot.collision.geometryObjects:
        T = item.placement.homogeneous
        if item.parentJoint == last:
            found.append((item.geometry, T_flange_joint @ T))
        elif item.parentJoint == last - 1 and last > 1 and not slides:
            T = T_joint_before @ T
            if _round_about(item.geometry, T, axis):
                found.append((item.geometry, T_flange_joint @ T))
    return found


def _round_about(geometry: Any, T: FloatArray, axis: FloatArray) -> bool:
    """Return whether a body at `T` (4, 4) is symmetric about the `axis` (3,) through the origin."""
    centered = bool(np.linalg.norm(np.cross(axis, T[:3, 3])) < _ON_AXIS)
    if isinstance(geometry, coal.Sphere):
        return centered
    long = isinstance(geometry, (coal.Cylinder, coal.Capsule))
    return long and centered and bool(np.linalg.norm(np.cross(axis, T[:3, 2])) < _ON_AXIS)


def _reach(body: _Body, T_flange: FloatArray, top: Any, center: FloatArray) -> FloatArray:
    """Return how far `body` extends from the origin (S,) [m] at flange poses (S, 4, 4) that put it into the table.

    Infinite at poses that do not, were the table's `center` (2,) at the origin and its edges far away.
    """
    request = coal.CollisionRequest()
    request.security_margin = body.clearance
    body.geometry.computeLocalAABB()
    radius, poses = float(body.geometry.aabb_radius), T_flange @ body.T_flange_body
    middle = poses[:, :3, :3] @ np.array(body.geometry.aabb_center) + poses[:, :3, 3]
    extent = np.linalg.norm(middle[:, :2], axis=1) + radius + body.clearance
    poses[:, :2, 3] += center - middle[:, :2]  # over the middle of the table
    for s in range(len(poses)):
        near = middle[s, 2] - radius < top.getAABB().max_[2] + body.clearance
        item = coal.CollisionObject(body.geometry, _transform(poses[s]))
        if not (near and coal.collide(item, top, request, coal.CollisionResult())):
            extent[s] = np.inf
    return extent


def _transform(T: FloatArray) -> Any:
    return coal.Transform3s(T[:3, :3], T[:3, 3])
