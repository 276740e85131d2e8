"""In which stable placements the table leaves room for an end-effector: what makes a grasp worth sampling.

A planar motion on the table keeps all heights. So a grasp that has a corner of the gripper in an endless table at a
placement is infeasible there at every pose, but for those where that corner is beyond the table's edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import ConvexHull

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.geometry.shapes import surface_points
from regrasp_opt.objects import ObjectModel

ROUNDING = 1e-6
"""How far beyond the clearance the gripper is kept [m], so that the exact check agrees."""


class TableRoom(NamedTuple):
    """What is known of an object's placements and of an end-effector's corners.

    By placement, `up` (S, 3) is the vertical in the object frame and `level` (S,) the height of the object's origin
    above what must stay free [m]. `parts` are the corners (P, 3) of what moves together, in the frame of the TCP, and
    on which side of it: 1 and -1 for fingers, which are half the jaw width farther along y, 0 for the body.
    """

    up: FloatArray
    level: FloatArray
    parts: tuple[tuple[int, FloatArray], ...]

    @classmethod
    def of(cls, model: ObjectModel, end_effector: EndEffector, clearance: float) -> TableRoom:
        """Return the room that `clearance` [m] leaves above the table; without any placement there is room always."""
        poses = np.array([placement.pose for placement in model.placements]).reshape(-1, 4, 4)
        fingers = end_effector.finger_boxes(0.0, end_effector.pre_opening)
        half = len(fingers) // 2
        parts = []
        for side, shapes in ((0, end_effector.body), (1, fingers[:half]), (-1, fingers[half:])):
            if shapes:
                corners = np.concatenate([surface_points(shape) for shape in shapes])
                corners = corners[ConvexHull(corners).vertices]
                parts.append((side, corners - [0.0, 0.0, end_effector.tcp_offset]))
        return cls(poses[:, 2, :3], poses[:, 2, 3] - clearance - ROUNDING, tuple(parts))

    def among(self, placements: BoolArray) -> TableRoom:
        """Return the room in those of the placements for which the mask (S,) is true."""
        return self._replace(up=self.up[placements], level=self.level[placements])

    def heights(self, T_object_tcp: FloatArray, width: FloatArray) -> FloatArray:
        """Return how much room is below grasps (N, 4, 4) of jaw widths (N,) [m] in each placement (N, S) [m].

        It is negative where the gripper, on its way from open to closed, is lower than it may be.
        """
        up = np.einsum("sj,nji->nsi", self.up, T_object_tcp[:, :3, :3])
        origin = T_object_tcp[:, :3, 3] @ self.up.T + self.level
        lowest = np.full(origin.shape, np.inf)
        for side, corners in self.parts:
            low = (up.reshape(-1, 3) @ corners.T).min(axis=1, initial=np.inf).reshape(origin.shape)
            lowest = np.minimum(lowest, low + side * width[:, None] / 2 * up[..., 1])
        return origin + lowest

    def free(self, T_object_tcp: FloatArray, width: FloatArray) -> BoolArray:
        """Return in which placements (N, S) there is room for grasps (N, 4, 4) of jaw widths (N,) [m]."""
        return self.heights(T_object_tcp, width) >= 0.0
