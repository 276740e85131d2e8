"""Verification that a trajectory is free of collision over its whole length, between samples included.

Bodies at distance ``d_a`` and ``d_b`` at the two ends of an interval, which approach each other by at most ``L`` over
it, are at least ``(d_a + d_b - L) / 2`` apart all the way. An interval is therefore verified once both ends keep
``floor + L / 2``, which is what a level of a `CollisionContext` with ``LEVELS[level] >= L`` asks for; otherwise it is
halved (adaptive bisection, after Schwarzer, Saha and Latombe, 2005). ``L`` comes from the Bezier polygon of each cubic
piece, which is never shorter than the curve, times how far a point can be from each joint's axis; over several pieces
it is the sum.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext
from regrasp_opt.motion.trajectory.trajectory import Trajectory

_LAST = len(LEVELS) - 1


def verify(context: CollisionContext, trajectory: Trajectory) -> bool:
    """Return whether `trajectory` is free of collision in `context` over its whole length.

    Intervals are pairs of path parameters: the number of a cubic piece plus the parameter in [0, 1] on it. Each is part
    of a piece, or some whole ones.
    """
    pieces = np.arange(len(trajectory.times) - 1.0)
    far = np.cumsum(np.append(0.0, _travel_within(context, trajectory, np.column_stack([pieces, pieces + 1]))))
    known: dict[tuple[float, int], bool] = {}

    def passes(s: float, q: FloatArray, level: int) -> bool:
        if (s, level) not in known:
            known[s, level] = context.passes(q, level)
        return known[s, level]

    intervals = _cut(far)
    while len(intervals):
        travel, ends = _travel_within(context, trajectory, intervals), _positions(trajectory, intervals)
        long = intervals[:, 1] - intervals[:, 0] > 1
        travel[long] = np.diff(far[intervals[long].astype(int)], axis=1)[:, 0]
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
        middle = np.where(halves[:, 1] - halves[:, 0] > 1, np.floor(middle), middle)
        intervals = np.concatenate([np.column_stack([halves[:, 0], middle]), np.column_stack([middle, halves[:, 1]])])
    return True


def _cut(far: FloatArray) -> FloatArray:
    """Return intervals (I, 2) that cover a trajectory, none of them much longer than the first level allows for.

    `far` (M,) bounds how far any point has moved at each knot [m].
    """
    points, knot = [0.0], 0
    while knot < len(far) - 1:
        reached = int(np.searchsorted(far, far[knot] + LEVELS[0], side="right")) - 1
        if reached == knot:
            count = int(np.ceil((far[knot + 1] - far[knot]) / LEVELS[0]))
            points += (knot + np.arange(1, count) / count).tolist()
            reached += 1
        points.append(float(reached))
        knot = reached
    return np.column_stack([points[:-1], points[1:]])


def _travel_within(context: CollisionContext, trajectory: Trajectory, intervals: FloatArray) -> FloatArray:
    """Return bounds (I,) on how far any point moves over `intervals` (I, 2), each of them part of a piece [m]."""
    piece = np.minimum(intervals[:, 0].astype(int), len(trajectory.times) - 2)
    _, c1, c2, c3 = trajectory.coefficients[:, piece]
    a, b = (intervals - piece[:, None]).T[:, :, None]
    h = b - a
    d1, d2, d3 = h * (c1 + a * (2 * c2 + 3 * a * c3)), h**2 * (c2 + 3 * a * c3), h**3 * c3
    return context.travel((np.abs(d1) + np.abs(d1 + d2) + np.abs(d1 + 2 * d2 + 3 * d3)) / 3)


def _positions(trajectory: Trajectory, s: FloatArray) -> FloatArray:
    """Return the positions (..., dof) at path parameters `s` (...)."""
    piece = np.minimum(s.astype(int), len(trajectory.times) - 2)
    c0, c1, c2, c3 = trajectory.coefficients[:, piece]
    u = (s - piece)[..., None]
    positions: FloatArray = c0 + u * (c1 + u * (c2 + u * c3))
    return positions


def _spread(count: int) -> list[int]:
    """Return the numbers below `count` in an order in which each next one is far from those before it."""
    order = [0]
    stride = 1 << count.bit_length()
    while stride > 1:
        order += range(stride // 2, count, stride)
        stride //= 2
    return order[:count]
