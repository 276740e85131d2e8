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
from regrasp_opt.grasps import GraspSet
from regrasp_opt.scene import Arm, Support

SPACING = 0.03
"""Largest distance of the points of the tool that are looked at [m]."""
_BETWEEN = 0.015
"""Side of the cubes in each of which one point of a mesh is looked at [m]."""
_MOST = 50_000
"""Points that are drawn on a mesh at most, before one in each cube is kept."""
_AT_ONCE = 4096
"""Tool poses that are looked at together: some ten MB of points."""


class _Around(NamedTuple):
    """An obstacle: its shape, the world in its frame (4, 4), the box around it in the world (2, 3) [m].

    ``points`` (P, 3) are on the surface of a mesh, in the world; other shapes have none. ``board`` is the number of the
    support that it is, -1 where it is none or belongs to a fixture.
    """

    shape: Shape
    T_shape_world: FloatArray
    box: FloatArray
    points: FloatArray
    board: int


class ToolShape:
    """The tool at each of G grasps, in the frame of the flange: points in it, and boxes within its bodies.

    Attributes
    ----------
    points : (G, P, 3)
        On gripper and fingers, and in the wrist [m].
    T_core_flange : (G, K, 4, 4)
        The flange in the frames of the boxes.
    core : (K, 3)
        Half the sizes of the boxes [m].
    low, high, middle : (G, 3)
        Of the box around the points [m].
    radius : (G,)
        Of a ball around the points, at `middle` [m].
    """

    def __init__(self, arm: Arm, grasps: GraspSet) -> None:
        effector = arm.end_effector
        fixed = [_grid(shape) for shape in effector.body]
        fixed += [_axis(geometry, T) for geometry, T in wrist_bodies(arm.robot)]
        fingers = effector.finger_boxes(0.0, effector.pre_opening)
        self.points = effector.points_at_widths(fixed, [_grid(box) for box in fingers], grasps.width)
        cores = [_core(shape) for shape in (*effector.body, *fingers)]
        poses = np.tile([core.pose for core in cores], (len(grasps), 1, 1, 1))
        poses[:, len(effector.body) :, :3, 3] += effector.finger_shifts(grasps.width)
        self.T_core_flange, self.core = invert(poses), np.array([core.size for core in cores]) / 2
        self.low, self.high = self.points.min(axis=1), self.points.max(axis=1)
        self.middle = (self.low + self.high) / 2
        self.radius = np.linalg.norm(self.points - self.middle[:, None], axis=2).max(axis=1)


class ObstacleRule:
    """Which poses and grasps the obstacles of a workcell rule out, and supports that the object is not on.

    Parameters
    ----------
    checker : FeasibilityChecker
        Of G grasps.
    tool : ToolShape
        At these grasps.
    """

    def __init__(self, checker: FeasibilityChecker, tool: ToolShape) -> None:
        self._checker, self._tool, cell = checker, tool, checker.workcell
        self._obstacles = [_around(shape) for shape in cell.obstacles]
        for number, support in enumerate(cell.supports if len(cell.supports) > 1 else ()):
            board = number if isinstance(support, Support) else -1
            self._obstacles += [_around(shape, board) for shape in support.shapes]
        self._boxes = np.array([each.box for each in self._obstacles])  # (O, 2, 3)
        self._boards = np.array([each.board for each in self._obstacles])

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
        near = self._near(T[:, :3, :3] @ ball.middle + T[:, :3, 3], ball.radius + margin, on).any(axis=0)
        found = np.zeros(len(T), dtype=bool)
        found[near] = [self._checker.object_overlaps(pose, margin) is not None for pose in T[near]]
        return found

    def _near(self, centers: FloatArray, radius: FloatArray | float, on: IntArray) -> BoolArray:
        """Return which obstacles (O, M) may reach balls at `centers` (M, 3); objects are on boards `on` (M,)."""
        low, high = self._boxes[:, None, 0], self._boxes[:, None, 1]
        beyond = np.maximum(np.maximum(low - centers, centers - high), 0.0)
        return np.asarray(((beyond**2).sum(axis=-1) <= radius**2) & (on != self._boards[:, None]))

    def _tool_in_obstacle(self, T: FloatArray, on: IntArray, grasp_ids: IntArray) -> BoolArray:
        flange, tool = self._checker.flange_poses(T, grasp_ids), self._tool
        centers = np.einsum("mij,mj->mi", flange[:, :3, :3], tool.middle[grasp_ids]) + flange[:, :3, 3]
        around, found = self._near(centers, tool.radius[grasp_ids], on), np.zeros(len(T), dtype=bool)
        for number in np.flatnonzero(around.any(axis=1)).tolist():
            each, near = self._obstacles[number], np.flatnonzero(around[number] & ~found)
            if isinstance(each.shape, Mesh):
                found[near] = self._holds(each.points, flange[near], grasp_ids[near])
            else:
                T_shape_flange = each.T_shape_world @ flange[near]
                reaches = self._reaches(each.shape, T_shape_flange, grasp_ids[near])
                near, T_shape_flange = near[reaches], T_shape_flange[reaches]
                points = _moved(T_shape_flange, tool.points[grasp_ids[near]])
                found[near] = _inside(each.shape, points).any(axis=1)
        return found

    def _reaches(self, shape: Box | Cylinder, T_shape_flange: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return for which tools (M,), at (M, 4, 4), the box around the tool may reach the one around `shape`."""
        half = shape.size / 2 if isinstance(shape, Box) else np.array([shape.radius, shape.radius, shape.length / 2])
        R, extent, center = T_shape_flange[:, :3, :3], (self._tool.high - self._tool.low) / 2, self._tool.middle
        middle = np.einsum("mij,mj->mi", R, center[grasp_ids]) + T_shape_flange[:, :3, 3]
        beyond: FloatArray = np.abs(middle) - np.einsum("mij,mj->mi", np.abs(R), extent[grasp_ids])
        return np.asarray((beyond < half).all(axis=1))

    def _holds(self, points: FloatArray, flange: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return which tools (M,) at `flange` (M, 4, 4) have one of the `points` (P, 3), in the world, in a part."""
        found = np.zeros(len(flange), dtype=bool)
        portion = max(1, _AT_ONCE * 100 // max(1, len(points)))
        for first in range(0, len(flange), portion):
            ids = grasp_ids[first : first + portion]
            local = _moved(invert(flange[first : first + portion]), points)  # (M, P, 3)
            low, high = self._tool.low[ids][:, None], self._tool.high[ids][:, None]
            m, p = np.nonzero((local > low).all(axis=-1) & (local < high).all(axis=-1))
            T = self._tool.T_core_flange[ids[m]]
            inner = np.einsum("nkij,nj->nki", T[..., :3, :3], local[m, p]) + T[..., :3, 3]
            found[first + m[(np.abs(inner) < self._tool.core).all(axis=-1).any(axis=-1)]] = True
        return found


def _around(shape: Shape, board: int = -1) -> _Around:
    corners, points = surface_points(shape), np.zeros((0, 3))
    if isinstance(shape, Mesh):
        surface = trimesh.Trimesh(corners, shape.faces, process=False)
        corners = corners[np.unique(shape.faces)]  # Coal ignores vertices that belong to no face
        count = min(4 * int(np.ceil(surface.area / _BETWEEN**2)), _MOST)
        points = np.concatenate([corners, trimesh.sample.sample_surface(surface, count, seed=0)[0]])
        cells = np.unique(np.floor(points / _BETWEEN).astype(np.int64), axis=0, return_index=True)[1]
        points = points[cells]
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
