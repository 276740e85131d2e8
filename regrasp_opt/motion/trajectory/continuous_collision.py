"""Verification that a trajectory is free of collision over its whole length, between samples included.

Bodies at distance ``d_a`` and ``d_b`` at the two ends of an interval, which approach each other by at most ``L`` over
it, are at least ``(d_a + d_b - L) / 2`` apart all the way. An interval is therefore verified once both ends keep
``floor + L / 2``, which is what a level of a `CollisionContext` with ``LEVELS[level] >= L`` asks for; otherwise it is
halved (adaptive bisection, after Schwarzer, Saha and Latombe, 2005). ``L`` comes from the Bezier polygon of each cubic
piece, which is never shorter than the curve, times how far a point can be from each joint's axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext
from regrasp_opt.motion.trajectory.trajectory import Trajectory

_LAST = len(LEVELS) - 1


class Verification(NamedTuple):
    """Whether a trajectory was verified, the time at which that failed [s] (or NaN), and how many tests it took."""

    holds: bool
    time: float
    tests: int


def verify(context: CollisionContext, trajectory: Trajectory) -> Verification:
    """Verify `trajectory` free of collision in `context`, or return where that fails."""
    return _Verifier(context, trajectory).run()


class _Verifier:
    """Intervals are pairs of path parameters: the number of a cubic piece plus the parameter in [0, 1] on it."""

    def __init__(self, context: CollisionContext, trajectory: Trajectory) -> None:
        self._setting, self._trajectory = context, trajectory
        self._known: dict[tuple[float, int], bool] = {}

    def run(self) -> Verification:
        intervals = self._cut()
        while len(intervals):
            travel, ends = self._travel(intervals)
            levels = np.searchsorted(-LEVELS, -travel, side="right") - 1  # -1 where even the first is too short
            split = []
            for n in _spread(len(intervals)):  # far apart first, so that a collision is met soon
                level = int(levels[n])
                if level < 0:
                    split.append(n)
                    continue
                if all(self._passes(s, q, level) for s, q in zip(intervals[n], ends[n], strict=True)):
                    continue
                for s, q in zip(intervals[n], ends[n], strict=True):
                    if level == _LAST or not self._passes(s, q, _LAST):
                        return Verification(False, self._time(s), len(self._known))
                split.append(n)
            halves = intervals[split]
            middle = halves.mean(axis=1)
            intervals = np.concatenate(
                [np.column_stack([halves[:, 0], middle]), np.column_stack([middle, halves[:, 1]])]
            )
        return Verification(True, float("nan"), len(self._known))

    def _cut(self) -> FloatArray:
        """Return intervals (I, 2) that cover the trajectory, few of them too long for the first level."""
        pieces = np.arange(len(self._trajectory.times) - 1, dtype=np.float64)
        travel, _ = self._travel(np.column_stack([pieces, pieces + 1]))
        counts = np.maximum(np.ceil(travel / LEVELS[0]), 1).astype(int)
        edges = [np.linspace(k, k + 1, n, endpoint=False) for k, n in zip(pieces, counts, strict=True)]
        points = np.concatenate([*edges, pieces[-1:] + 1])
        return np.column_stack([points[:-1], points[1:]])

    def _travel(self, intervals: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds (I,) on how far any point moves over `intervals` (I, 2) [m], and both ends (I, 2, dof)."""
        piece = np.minimum(intervals[:, 0].astype(int), len(self._trajectory.times) - 2)
        c0, c1, c2, c3 = self._trajectory.coefficients[:, piece]
        a, b = (intervals - piece[:, None]).T[:, :, None]
        h = b - a
        d0, d1 = c0 + a * (c1 + a * (c2 + a * c3)), h * (c1 + a * (2 * c2 + 3 * a * c3))
        d2, d3 = h**2 * (c2 + 3 * a * c3), h**3 * c3
        polygon = (np.abs(d1) + np.abs(d1 + d2) + np.abs(d1 + 2 * d2 + 3 * d3)) / 3
        return self._setting.travel(polygon), np.stack([d0, d0 + d1 + d2 + d3], axis=1)

    def _passes(self, s: float, q: FloatArray, level: int) -> bool:
        key = float(s), level
        if key not in self._known:
            self._known[key] = self._setting.passes(q, level)
        return self._known[key]

    def _time(self, s: float) -> float:
        return float(np.interp(s, np.arange(len(self._trajectory.times)), self._trajectory.times))


def _spread(count: int) -> list[int]:
    """Return the numbers below `count` in an order in which each next one is far from those before it."""
    order = [0]
    stride = 1 << count.bit_length()
    while stride > 1:
        order += range(stride // 2, count, stride)
        stride //= 2
    return order[:count]
