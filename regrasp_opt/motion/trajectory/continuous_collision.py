"""Verification that a trajectory is free of collision over its whole length, between samples included.

Bodies at distance ``d_a`` and ``d_b`` at the two ends of an interval, which approach each other by at most ``L`` over
it, are at least ``(d_a + d_b - L) / 2`` apart all the way. An interval is therefore verified once both ends keep
``floor + L / 2``, which is what a level of a `CollisionContext` with ``LEVELS[level] >= L`` asks for; otherwise it is
halved (adaptive bisection, after Schwarzer, Saha and Latombe, 2005). ``L`` comes from the Bezier polygon of each cubic
piece, which is never shorter than the curve, times how far a point can be from each joint's axis.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext
from regrasp_opt.motion.trajectory.trajectory import Trajectory

_LAST = len(LEVELS) - 1


def verify(context: CollisionContext, trajectory: Trajectory) -> bool:
    """Return whether `trajectory` is free of collision in `context` over its whole length.

    Intervals are pairs of path parameters: the number of a cubic piece plus the parameter in [0, 1] on it.
    """
    known: dict[tuple[float, int], bool] = {}

    def passes(s: float, q: FloatArray, level: int) -> bool:
        if (s, level) not in known:
            known[s, level] = context.passes(q, level)
        return known[s, level]

    intervals = _cut(context, trajectory)
    while len(intervals):
        travel, ends = _travel(context, trajectory, intervals)
        levels = (np.searchsorted(-LEVELS, -travel, side="right") - 1).tolist()  # -1 where even the first is too short
        split = []
        for n in _spread(len(intervals)):  # far apart first, so that a collision is met soon
            points = list(zip(intervals[n].tolist(), ends[n], strict=True))
            if levels[n] < 0 or not all(passes(s, q, levels[n]) for s, q in points):
                if levels[n] == _LAST or (levels[n] >= 0 and not all(passes(s, q, _LAST) for s, q in points)):
                    return False
                split.append(n)
        halves = intervals[split]
        middle = halves.mean(axis=1)
        intervals = np.concatenate([np.column_stack([halves[:, 0], middle]), np.column_stack([middle, halves[:, 1]])])
    return True


def _cut(context: CollisionContext, trajectory: Trajectory) -> FloatArray:
    """Return intervals (I, 2) that cover the trajectory, few of them too long for the first level."""
    pieces = np.arange(len(trajectory.times) - 1, dtype=np.float64)
    travel, _ = _travel(context, trajectory, np.column_stack([pieces, pieces + 1]))
    counts = np.maximum(np.ceil(travel / LEVELS[0]), 1).astype(int)
    edges = [np.linspace(k, k + 1, n, endpoint=False) for k, n in zip(pieces, counts, strict=True)]
    points = np.concatenate([*edges, pieces[-1:] + 1])
    return np.column_stack([points[:-1], points[1:]])


def _travel(context: CollisionContext, trajectory: Trajectory, intervals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return bounds (I,) on how far any point moves over `intervals` (I, 2) [m], and both ends (I, 2, dof)."""
    piece = np.minimum(intervals[:, 0].astype(int), len(trajectory.times) - 2)
    c0, c1, c2, c3 = trajectory.coefficients[:, piece]
    a, b = (intervals - piece[:, None]).T[:, :, None]
    h = b - a
    d0, d1 = c0 + a * (c1 + a * (c2 + a * c3)), h * (c1 + a * (2 * c2 + 3 * a * c3))
    d2, d3 = h**2 * (c2 + 3 * a * c3), h**3 * c3
    polygon = (np.abs(d1) + np.abs(d1 + d2) + np.abs(d1 + 2 * d2 + 3 * d3)) / 3
    return context.travel(polygon), np.stack([d0, d0 + d1 + d2 + d3], axis=1)


def _spread(count: int) -> list[int]:
    """Return the numbers below `count` in an order in which each next one is far from those before it."""
    order = [0]
    stride = 1 << count.bit_length()
    while stride > 1:
        order += range(stride // 2, count, stride)
        stride //= 2
    return order[:count]
