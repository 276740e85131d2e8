"""Whether an end-effector in a grasp pose is clear of the object (Coal, on its true, concave surface).

The fingers are checked in every opening between almost closed and the approach opening, so that the jaw can
come in and let go. Given grasps are also tested for bodies wholly inside the object, which touch no surface. Those of
the sampler cannot have any: a finger begins `CONTACT_TOLERANCE` beyond a contact, just outside the surface, and the
fingers and the body touch one another.
"""

from __future__ import annotations

import coal
import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.geometry.shapes import Shape, mesh_geometry, shape_geometry
from regrasp_opt.geometry.solids import Solid
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.objects import ObjectModel

CONTACT_TOLERANCE = 0.001
"""How far each finger stands beyond its contact where it must be clear of the object [m]."""

BODY_CLEARANCE = 0.002
"""Least distance of a parallel gripper's body to the object [m]; a suction cup's may touch it."""


class GripperClearance:
    """The collision test of one end-effector against one object, both fixed in shape; of insides too if `given`."""

    def __init__(
        self, vertices: FloatArray, faces: IntArray, end_effector: EndEffector, *, given: bool = False
    ) -> None:
        self._object = mesh_geometry(vertices, faces)
        self._solid = Solid(self._object) if given else None
        self._T_tcp_flange = end_effector.T_tcp_flange
        inner = min(CONTACT_TOLERANCE, end_effector.pre_opening)
        self._fingers = end_effector.finger_boxes(2 * inner, swept=end_effector.pre_opening - inner)
        self._body = end_effector.body
        self._margin = BODY_CLEARANCE if end_effector.kind == "parallel" else 0.0

    def body_free(self, T_object_tcp: FloatArray) -> BoolArray:
        """Return in which of the TCP poses (N, 4, 4) the body is clear of the object (N,)."""
        free = np.ones(len(T_object_tcp), dtype=bool)
        for shape in self._body:
            self._reject(free, shape, T_object_tcp @ (self._T_tcp_flange @ shape.pose), self._margin)
        return free

    def fingers_free(self, T_object_tcp: FloatArray, width: FloatArray) -> BoolArray:
        """Return in which of the grasps (N, 4, 4), of jaw widths (N,) [m], both fingers are clear (N,)."""
        free = np.ones(len(T_object_tcp), dtype=bool)
        half = len(self._fingers) // 2
        for index, box in enumerate(self._fingers):
            outward = (0.5 if index < half else -0.5) * width
            poses = T_object_tcp @ (self._T_tcp_flange @ box.pose)
            poses[:, :3, 3] += outward[:, None] * T_object_tcp[:, :3, 1]
            self._reject(free, box, poses, 0.0)
        return free

    def _reject(self, free: BoolArray, shape: Shape, poses: FloatArray, margin: float) -> None:
        geometry = shape_geometry(shape)
        points = Solid(geometry).shells.points
        request, origin = coal.CollisionRequest(), coal.Transform3s()
        request.security_margin = margin
        for index in np.flatnonzero(free):
            placed = coal.Transform3s(poses[index, :3, :3], poses[index, :3, 3])
            hit = coal.collide(self._object, origin, geometry, placed, request, coal.CollisionResult())
            free[index] = not hit and not (
                self._solid is not None and self._solid.holds(points @ poses[index, :3, :3].T + poses[index, :3, 3])
            )


def gripper_free(grasps: GraspSet, model: ObjectModel, end_effector: EndEffector) -> BoolArray:
    """Return in which grasps (G,) body and fingers are clear of the object and not inside it."""
    clearance = GripperClearance(model.vertices, model.faces, end_effector, given=True)
    return clearance.body_free(grasps.T_object_tcp) & clearance.fingers_free(grasps.T_object_tcp, grasps.width)
