"""What a sampler hands on: collision-free grasps with a grade each, before any are chosen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.grasps.surface import tangents


class GraspCandidates(NamedTuple):
    """TCP poses in the object frame (N, 4, 4), jaw widths (N,) [m] and grades (N,), 0 the best."""

    T_object_tcp: FloatArray
    width: FloatArray
    grade: IntArray

    def where(self, mask: BoolArray) -> GraspCandidates:
        """Return those for which `mask` (N,) is true."""
        return GraspCandidates(self.T_object_tcp[mask], self.width[mask], self.grade[mask])

    def extended(self, others: GraspCandidates) -> GraspCandidates:
        """Return these and the `others` behind them."""
        return GraspCandidates(*(np.concatenate(parts) for parts in zip(self, others, strict=True)))


NONE = GraspCandidates(np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, dtype=np.int64))
"""No candidates."""


def frames_about(
    positions: FloatArray, axis: FloatArray, turns: int, first: FloatArray, *, closing: bool = False
) -> FloatArray:
    """Return `turns` evenly turned frames (N * turns, 4, 4) at `positions` (N, 3) about unit `axis` (N, 3).

    The axis is z, or with `closing` y. The other of the two is as near as it gets to `first` (N, 3) in one of them.
    """
    count = len(positions)
    u, v = tangents(axis)
    start = np.arctan2(np.einsum("ni,ni->n", v, first), np.einsum("ni,ni->n", u, first))
    angle = start[:, None] + np.arange(turns) * 2 * np.pi / turns
    spoke = np.cos(angle)[..., None] * u[:, None] + np.sin(angle)[..., None] * v[:, None]
    fixed = np.broadcast_to(axis[:, None], spoke.shape)
    y, z = (fixed, spoke) if closing else (spoke, fixed)
    frames = np.zeros((count, turns, 4, 4))
    frames[..., :3, 0], frames[..., :3, 1], frames[..., :3, 2] = np.cross(y, z), y, z
    frames[..., :3, 3] = positions[:, None]
    frames[..., 3, 3] = 1.0
    return frames.reshape(-1, 4, 4)
