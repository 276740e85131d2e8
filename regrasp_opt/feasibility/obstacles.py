"""What obstacles rule out at a pose: the object in one of them, or a point of the tool in one.

Both are sound, so that ruling out loses nothing: an object that is too near an obstacle cannot be put there, whatever
the grasp, and a tool with a point inside a solid collides. Neither needs inverse kinematics. The converse does not
hold: what is not ruled out may still collide, and the exact check decides.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import trimesh

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, invert
from regrasp_opt.feasibility.checker import FeasibilityChecker
from regrasp_opt.feasibility.tabletop import wrist_bodies
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape, surface_points
from regrasp_opt.scene import Support

SPACING = 0.03
"""Largest distance of the points of the tool, and of those of a mesh, that are looked at [m]."""
_AT_ONCE = 4096
"""Tool poses that are looked at together: some ten MB of points."""


class _Around(NamedTuple):
    """An obstacle: its shape, the world in its frame (4, 4), the box around it in the world (2, 3).

    ``points`` (P, 3) are on the surface of a mesh, in the world; other shapes have none. ``board`` is the number of the
    support that it is, -1 where it is none or belongs to a fixture.
    """

    shape: Shape
    T_shape_world: FloatArray
    box: FloatArray
    points: FloatArray
    board: int


class ObstacleRule:
    """Which poses and grasps the obstacles of a workcell rule out, and supports that the object is not on.

    Parameters
    ----------
    checker : FeasibilityChecker
        Of G grasps.
    """

    def __init__(self, checker: FeasibilityChecker) -> None:
        self._checker, cell = checker, checker.workcell
        self._obstacles = [_around(shape) for shape in cell.obstacles]
        for number, support in enumerate(cell.supports if len(cell.supports) > 1 else ()):
            board = number if isinstance(support, Support) else -1
            self._obstacles += [_around(shape, board) for shape in support.shapes]
        effector, grasps = cell.arm.end_effector, checker.grasps
        fixed = [_grid(shape) for shape in effector.body]
        fixed += [_axis(geometry, T) for geometry, T in wrist_bodies(cell.arm.robot)]
        fingers = effector.finger_boxes(0.0, effector.pre_opening)
        self._points = effector.points_at_widths(fixed, [_grid(box) for box in fingers], grasps.width)  # (G, P, 3)
        cores = [_core(shape) for shape in (*effector.body, *fingers)]
        poses = np.tile([core.pose for core in cores], (len(grasps), 1, 1, 1))  # (G, K, 4, 4)
        poses[:, len(effector.body) :, :3, 3] += effector.finger_shifts(grasps.width)
        self._T_core_flange = invert(poses)
        self._core = np.array([core.size for core in cores]) / 2  # (K, 3)
        self._box = self._points.min(axis=1), self._points.max(axis=1)  # (G, 3) each, around the tool
        self._middle = (self._box[0] + self._box[1]) / 2
        self._radius = np.linalg.norm(self._points - self._middle[:, None], axis=2).max(axis=1)

    def __call__(self, T: FloatArray, on: IntArray, candidates: BoolArray) -> BoolArray:
        """Return what is ruled out (B, G) at object poses `T` (B, 4, 4) T_world_object.

        The tool is tested for the `candidates` (B, G) only; where the object cannot be, no grasp can. The board of the
        number `on` (B,), on which the object stands, is left out: it is the business of another rule.
        """
        blocked = self._object_in_the_way(T, on)
        found = np.repeat(blocked[:, None], candidates.shape[1], axis=1)
        pose, grasp = np.nonzero(candidates & ~found)
        for first in range(0, len(pose), _AT_ONCE):
            at = pose[first : first + _AT_ONCE], grasp[first : first + _AT_ONCE]
            found[at] = self._tool_in_obstacle(T[at[0]], on[at[0]], at[1])
        return found

    def _object_in_the_way(self, T: FloatArray, on: IntArray) -> BoolArray:
        ball, margin = self._checker.object_ball, self._checker.workcell.clearance.gripper
        centers, near = T[:, :3, :3] @ ball.middle + T[:, :3, 3], np.zeros(len(T), dtype=bool)
        for each in self._obstacles:
            near |= (on != each.board) & (_distance(centers, each.box) <= ball.radius + margin)
        found = np.zeros(len(T), dtype=bool)
        found[near] = [self._checker.object_overlaps(pose, margin) is not None for pose in T[near]]
        return found

    def _tool_in_obstacle(self, T: FloatArray, on: IntArray, grasp_ids: IntArray) -> BoolArray:
        flange = self._checker.flange_poses(T, grasp_ids)
        centers = np.einsum("mij,mj->mi", flange[:, :3, :3], self._middle[grasp_ids]) + flange[:, :3, 3]
        found = np.zeros(len(T), dtype=bool)
        for each in self._obstacles:
            near = ~found & (on != each.board) & (_distance(centers, each.box) <= self._radius[grasp_ids])
            near = np.flatnonzero(near)
            if isinstance(each.shape, Mesh):
                found[near] = self._holds(each.points, flange[near], grasp_ids[near])
            else:
                T_shape_flange = each.T_shape_world @ flange[near]
                reaches = self._reaches(each.shape, T_shape_flange, grasp_ids[near])
                near, T_shape_flange = near[reaches], T_shape_flange[reaches]
                points = _moved(T_shape_flange, self._points[grasp_ids[near]])
                found[near] = _inside(each.shape, points).any(axis=1)
        return found

    def _reaches(self, shape: Box | Cylinder, T_shape_flange: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return for which tools (M,), at (M, 4, 4), the box around the tool may reach the one around `shape`."""
        half = shape.size / 2 if isinstance(shape, Box) else np.array([shape.radius, shape.radius, shape.length / 2])
        R, extent = T_shape_flange[:, :3, :3], (self._box[1] - self._box[0]) / 2
        middle = np.einsum("mij,mj->mi", R, self._middle[grasp_ids]) + T_shape_flange[:, :3, 3]
        beyond: FloatArray = np.abs(middle) - np.einsum("mij,mj->mi", np.abs(R), extent[grasp_ids])
        return np.asarray((beyond < half).all(axis=1))

    def _holds(self, points: FloatArray, flange: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return which tools (M,) at `flange` (M, 4, 4) have one of the `points` (P, 3), in the world, in a part."""
        found = np.zeros(len(flange), dtype=bool)
        portion = max(1, _AT_ONCE * 100 // max(1, len(points)))
        for first in range(0, len(flange), portion):
            ids = grasp_ids[first : first + portion]
            local = _moved(invert(flange[first : first + portion]), points)  # (M, P, 3)
            low, high = (box[ids][:, None] for box in self._box)
            m, p = np.nonzero((local > low).all(axis=-1) & (local < high).all(axis=-1))
            T = self._T_core_flange[ids[m]]
            inner = np.einsum("nkij,nj->nki", T[..., :3, :3], local[m, p]) + T[..., :3, 3]
            found[first + m[(np.abs(inner) < self._core).all(axis=-1).any(axis=-1)]] = True
        return found


def _around(shape: Shape, board: int = -1) -> _Around:
    corners, points = surface_points(shape), np.zeros((0, 3))
    if isinstance(shape, Mesh):
        points, _ = trimesh.remesh.subdivide_to_size(corners, shape.faces, SPACING)
        corners = points
    elif isinstance(shape, Cylinder):  # those on the rims do not reach out as far as the cylinder
        rim = np.array(np.meshgrid(*[(-h, h) for h in (shape.radius, shape.radius, shape.length / 2)]))
        corners = _moved(shape.pose, rim.reshape(3, -1).T)
    return _Around(shape, invert(shape.pose), np.array([corners.min(axis=0), corners.max(axis=0)]), points, board)


def _core(shape: Shape) -> Box:
    """Return a box within a body of the tool: the body itself, or the largest square prism in a cylinder."""
    if isinstance(shape, Box):
        return shape
    side, length = (shape.radius * np.sqrt(2), shape.length) if isinstance(shape, Cylinder) else (0.0, 0.0)
    return Box(shape.name, np.array([side, side, length]), shape.pose)


def _moved(T: FloatArray, points: FloatArray) -> FloatArray:
    """Return `points` (..., P, 3) moved by `T` (..., 4, 4)."""
    moved: FloatArray = points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]
    return moved


def _distance(points: FloatArray, box: FloatArray) -> FloatArray:
    """Return the distances (M,) of `points` (M, 3) from a box (2, 3) along the axes."""
    distance: FloatArray = np.linalg.norm(np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0), axis=1)
    return distance


def _inside(shape: Box | Cylinder, points: FloatArray) -> BoolArray:
    """Return which `points` (..., 3), in the frame of `shape`, lie in it."""
    if isinstance(shape, Box):
        return np.asarray((np.abs(points) < shape.size / 2).all(axis=-1))
    return (np.abs(points[..., 2]) < shape.length / 2) & (np.hypot(points[..., 0], points[..., 1]) < shape.radius)


def _grid(shape: Shape) -> FloatArray:
    """Return points (P, 3) on the surface of a body of the tool, in the frame of the flange."""
    if not isinstance(shape, Box):
        return surface_points(shape)
    axes = [np.linspace(-h, h, 1 + max(1, int(np.ceil(2 * h / SPACING)))) for h in shape.size / 2]
    local = np.array(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).T
    local = local[(np.abs(local) > shape.size / 2 * (1 - 1e-9)).any(axis=1)]
    return local @ shape.pose[:3, :3].T + shape.pose[:3, 3]


def _axis(geometry: Any, T: FloatArray) -> FloatArray:
    """Return points (3, 3) in a Coal body, along its axis, in the frame of the flange; none of a mesh (0, 3)."""
    if not isinstance(geometry, (coal.Box, coal.Sphere, coal.Cylinder, coal.Capsule)):
        return np.zeros((0, 3))
    half = geometry.halfLength if isinstance(geometry, (coal.Cylinder, coal.Capsule)) else 0.0
    local = np.outer([-1.0, 0.0, 1.0], [0.0, 0.0, half])
    return local @ T[:3, :3].T + T[:3, 3]
