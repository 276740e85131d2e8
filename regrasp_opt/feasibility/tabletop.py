"""What a board always rules out: grasps that put the gripper or the wrist into it at every pose of a placement.

A planar motion turns an object about the normal and moves it along the board, so the height of the gripper above it
stays the same, and so does that of the wrist as far as the last joint's turning does not move it. A point of these
bodies that is as low as the board stands for all planar motions that keep it within the board's edges.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import numpy as np

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.grasps import GraspSet
from regrasp_opt.robots import Robot
from regrasp_opt.scene import Fixture, Support, Workcell

_ON_AXIS = 1e-6
"""How far from the last joint's axis [m], or turned from it [rad], a body may be that is taken to be symmetric."""


class _Body(NamedTuple):
    geometry: Any
    T_flange_body: FloatArray  # (4, 4), or (G, 4, 4) where it depends on the grasp
    clearance: float


def points_in_support(
    workcell: Workcell, grasps: GraspSet, placements: FloatArray, supports: Sequence[Support | Fixture]
) -> FloatArray:
    """Return a point (S, G, 2) [m] of gripper or wrist that is in the board, for each placement and grasp.

    It is seen along the normal, at xi = 0. Wherever that point, which moves with the object, is within the board's
    edges, the grasp is infeasible. NaN where no such point is known; the grasp may still be infeasible for other
    reasons.

    Parameters
    ----------
    placements : (S, 4, 4)
        Stable placements, T_support_object at xi = 0.
    supports : S of Support or Fixture
        What each of them is on.
    """
    effector = workcell.arm.end_effector
    margins = workcell.clearance
    fixed = [_Body(shape_geometry(s), s.pose, margins.gripper) for s in effector.body]
    fixed += [_Body(geometry, T, margins.arm) for geometry, T in wrist_bodies(workcell.arm.robot)]
    T_object_flange = grasps.T_object_tcp @ effector.T_tcp_flange
    found = np.full((len(placements), len(grasps), 2), np.nan)
    fingers, shifts = effector.finger_boxes(0.0, effector.pre_opening), effector.finger_shifts(grasps.width)
    bodies = []
    for k, box in enumerate(fingers):
        poses = np.tile(box.pose, (len(grasps), 1, 1))
        poses[:, :3, 3] += shifts[:, k]
        bodies.append(_Body(shape_geometry(box), poses, margins.gripper))
    for s, (placement, support) in enumerate(zip(placements, supports, strict=True)):
        if isinstance(support, Fixture):
            continue
        slab = -support.thickness, 0.0
        for body in bodies + fixed:
            point = _in_slab(body, placement @ T_object_flange, slab)
            # The nearest point to the object is the last to leave the board.
            nearer = ~(np.linalg.norm(point, axis=1) >= np.linalg.norm(found[s], axis=1))
            nearer &= np.isfinite(point).all(axis=1)
            found[s, nearer] = point[nearer]
    return found


def wrist_bodies(robot: Robot) -> list[tuple[Any, FloatArray]]:
    """Return the Coal geometry and ``T_flange_body`` of the arm's bodies that stand still in the flange's frame.

    These are the bodies of the last link, and those of the link before it that are round about the last joint's axis.
    """
    T_flange_joint, last = invert(robot.chain.tip), robot.dof
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


def _in_slab(body: _Body, T_flange: FloatArray, slab: tuple[float, float]) -> FloatArray:
    """Return points (G, 2) of `body` between the heights of `slab`, or nearer to its top than the clearance, or NaN.

    The flange is at poses (G, 4, 4). Bodies are convex but for meshes, so that they hold what is between their lowest
    and their highest point.
    """
    bottom, top = slab[0], slab[1] + body.clearance
    T = T_flange @ body.T_flange_body
    low, high = _extreme(body.geometry, T, -1.0), _extreme(body.geometry, T, 1.0)
    share = np.zeros(len(T))
    if not isinstance(body.geometry, coal.BVHModelOBBRSS):
        share = np.clip((bottom - low[:, 2]) / np.maximum(high[:, 2] - low[:, 2], 1e-12), 0.0, 1.0)
    point: FloatArray = low + share[:, None] * (high - low)
    inside = (point[:, 2] >= bottom - 1e-12) & (point[:, 2] < top)
    return np.where(inside[:, None], point[:, :2], np.nan)


def _extreme(geometry: Any, T: FloatArray, sign: float) -> FloatArray:
    """Return the highest (`sign` 1) or lowest (-1) point (G, 3) of a Coal geometry at poses (G, 4, 4)."""
    along = sign * T[:, 2, :3]  # the vertical in the body's frame
    if isinstance(geometry, coal.Box):
        local = np.sign(along) * np.array(geometry.halfSide)
    elif isinstance(geometry, coal.Sphere):
        local = geometry.radius * along
    elif isinstance(geometry, coal.Capsule):
        local = geometry.radius * along
        local[:, 2] += geometry.halfLength * np.sign(along[:, 2])
    elif isinstance(geometry, coal.Cylinder):
        across = along[:, :2] / np.maximum(np.linalg.norm(along[:, :2], axis=1), 1e-12)[:, None]
        local = np.column_stack([geometry.radius * across, geometry.halfLength * np.sign(along[:, 2])])
    else:
        points = np.array(geometry.vertices())
        local = points[(points @ along.T).argmax(axis=0)]
    moved: FloatArray = np.einsum("sij,sj->si", T[:, :3, :3], local) + T[:, :3, 3]
    return moved
