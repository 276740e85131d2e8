"""Whether an end-effector in a grasp pose is clear of the object (Coal, on its true, concave surface).

The fingers are checked in every opening between almost closed and the approach opening, so that the jaw can
come in and let go. In most poses that overlap, a box has a point of the surface well inside, which arrays find many
times sooner than Coal; Coal decides the rest. Given grasps are also tested for bodies wholly inside the object, which
touch no surface. Those of the sampler cannot have any: a finger begins `CONTACT_TOLERANCE` beyond a contact, just
outside the surface, and the fingers and the body touch one another.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import coal
import numpy as np
import trimesh
from numpy.typing import NDArray

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.geometry.shapes import Box, Shape, mesh_geometry, shape_geometry
from regrasp_opt.geometry.solids import Solid
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.objects import ObjectModel

CONTACT_TOLERANCE = 0.001
"""How far each finger stands beyond its contact where it must be clear of the object [m]."""

BODY_CLEARANCE = 0.002
"""Least distance of a parallel gripper's body to the object [m]; a suction cup's may touch it."""

WIDENINGS = (0.0, 0.0015, 0.003)
"""How much wider than the contact line a flat pad may close on a hollow or bumpy side [m]."""

SCREENS = (0, 32, 128, 512)
"""Where the parts of the surface points end that are looked for in the boxes, one part after the other."""

SCREEN_DEPTH = 1e-5
"""How deep in a box a point decides [m]: far more than what Coal rounds."""

SCREENED = 2**16
"""Pairs of a pose and a point that are looked at together."""


class GripperClearance:
    """The collision test of one end-effector against one object, both fixed in shape; of insides too if `given`."""

    def __init__(
        self, vertices: FloatArray, faces: IntArray, end_effector: EndEffector, *, given: bool = False
    ) -> None:
        self._object = mesh_geometry(vertices, faces)
        self._solid = Solid(self._object) if given else None
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        points = trimesh.sample.sample_surface(mesh, SCREENS[-1], seed=0)[0]
        middle = points.mean(axis=0)
        self._points = np.column_stack([points - middle, np.ones(len(points))]).astype(np.float32)
        self._offset = np.pad(middle[:, None], ((0, 1), (3, 0)))
        self._T_tcp_flange = end_effector.T_tcp_flange
        inner = min(CONTACT_TOLERANCE, end_effector.pre_opening)
        self._fingers = end_effector.finger_boxes(2 * inner, swept=end_effector.pre_opening - inner)
        self._body = end_effector.body
        self._margin = BODY_CLEARANCE if end_effector.kind == "parallel" else 0.0

    def body_free(self, T_object_tcp: FloatArray) -> BoolArray:
        """Return in which of the TCP poses (N, 4, 4) the body is clear of the object (N,)."""
        placed = self._placed_body(T_object_tcp)
        return self._decide(self._screen(placed, len(T_object_tcp)), placed, self._margin)

    def fingers_free(self, T_object_tcp: FloatArray, width: FloatArray) -> BoolArray:
        """Return in which of the grasps (N, 4, 4), of jaw widths (N,) [m], both fingers are clear (N,)."""
        placed = self._placed_fingers(T_object_tcp, width)
        return self._decide(self._screen(placed, len(T_object_tcp)), placed, 0.0)

    def fitting(self, T_object_tcp: FloatArray, contact: FloatArray, widest: float) -> FloatArray:
        """Return the jaw widths (N,) [m], at most `widest`, at which grasps (N, 4, 4) are clear of the object, or NaN.

        They are at least the distances `contact` (N,) of the contacts [m]; the first of the `WIDENINGS` counts.
        """
        found = np.full(len(contact), np.nan)
        left = np.flatnonzero(self.body_free(T_object_tcp))
        for widening in WIDENINGS:
            left = left[contact[left] + widening <= widest]
            free = self.fingers_free(T_object_tcp[left], contact[left] + widening)
            found[left[free]] = contact[left[free]] + widening
            left = left[~free]
        return found

    def may_be_free(self, T_object_tcp: FloatArray, width: FloatArray) -> BoolArray:
        """Return which of the grasps (N, 4, 4), of jaw widths (N,) [m], are clear as far as a screen can tell (N,)."""
        placed = self._placed_body(T_object_tcp) + self._placed_fingers(T_object_tcp, width)
        return self._screen(placed, len(T_object_tcp))

    def _placed_body(self, T_object_tcp: FloatArray) -> list[tuple[Shape, FloatArray]]:
        return [(shape, T_object_tcp @ (self._T_tcp_flange @ shape.pose)) for shape in self._body]

    def _placed_fingers(self, T_object_tcp: FloatArray, width: FloatArray) -> list[tuple[Shape, FloatArray]]:
        placed: list[tuple[Shape, FloatArray]] = []
        for index, box in enumerate(self._fingers):
            poses = T_object_tcp @ (self._T_tcp_flange @ box.pose)
            side = 0.5 if index < len(self._fingers) // 2 else -0.5
            poses[:, :3, 3] += side * width[:, None] * T_object_tcp[:, :3, 1]
            placed.append((box, poses))
        return placed

    def _screen(self, placed: Sequence[tuple[Shape, FloatArray]], count: int) -> BoolArray:
        """Return in which of `count` poses no box of the shapes, placed in the object frame, holds a point (count,)."""
        free = np.ones(count, dtype=bool)
        for start, end in pairwise(SCREENS):
            for shape, poses in placed:
                if isinstance(shape, Box):
                    left = np.flatnonzero(free)
                    free[left] = ~_reaches_in(self._points[start:end], shape, poses[left] - self._offset)
        return free

    def _decide(self, free: BoolArray, placed: Sequence[tuple[Shape, FloatArray]], margin: float) -> BoolArray:
        """Return which of the `free` (N,) are so to Coal as well, with all shapes at their poses (N, 4, 4)."""
        origin, request = coal.Transform3s(), coal.CollisionRequest()
        request.security_margin = request.distance_upper_bound = margin
        for shape, poses in placed:
            geometry = shape_geometry(shape)
            points = Solid(geometry).shells.points if self._solid else np.zeros((0, 3))
            for index in np.flatnonzero(free):
                rotation, position = poses[index, :3, :3], poses[index, :3, 3]
                where = coal.Transform3s(rotation, position)
                hit = coal.collide(self._object, origin, geometry, where, request, coal.CollisionResult())
                free[index] = not hit and not (self._solid and self._solid.holds(points @ rotation.T + position))
        return free


def _reaches_in(points: NDArray[np.float32], box: Box, poses: FloatArray) -> BoolArray:
    """Return in which poses (N, 4, 4) a box has one of the points (P, 4), each with a 1 behind it, well inside (N,)."""
    scale = 1.0 / np.maximum(box.size / 2 - SCREEN_DEPTH, 1e-12)
    found = np.zeros(len(poses), dtype=bool)
    step = SCREENED // len(points)
    for start in range(0, len(poses), step):
        rotation, position = poses[start : start + step, :3, :3] * scale, poses[start : start + step, :3, 3]
        shift = -np.einsum("ni,nij->jn", position, rotation)
        into = np.concatenate([rotation.transpose(2, 0, 1), shift[..., None]], axis=2)
        place = into.reshape(-1, 4).astype(np.float32) @ points.T
        x, y, z = (np.abs(place, out=place) < 1.0).reshape(3, -1, len(points))
        found[start : start + step] = (x & y & z).any(axis=1)
    return found


def gripper_free(grasps: GraspSet, model: ObjectModel, end_effector: EndEffector) -> BoolArray:
    """Return in which grasps (G,) body and fingers are clear of the object and not inside it."""
    grasps.need_widths()
    clearance = GripperClearance(model.vertices, model.faces, end_effector, given=True)
    return clearance.body_free(grasps.T_object_tcp) & clearance.fingers_free(grasps.T_object_tcp, grasps.width)
