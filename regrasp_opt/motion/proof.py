"""Proof that a trajectory is free of collision over its whole length, between samples included.

Bodies at distance ``d_a`` and ``d_b`` at the two ends of an interval, which approach each other by at most ``L`` over
it, are at least ``(d_a + d_b - L) / 2`` apart all the way. An interval is therefore proved once both ends keep
``floor + L / 2``, which is what a level of a `Setting` with ``LEVELS[level] >= L`` asks for; otherwise it is halved
(adaptive bisection, after Schwarzer, Saha and Latombe, 2005). ``L`` comes from the Bezier polygon of each cubic piece,
which is never shorter than the curve, times how far a point can be from each joint's axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.scene import LEVELS, Setting
from regrasp_opt.motion.trajectory import Trajectory


class Proof(NamedTuple):
    """Whether a trajectory was proved, the time at which that failed [s] (or NaN), and how many tests it took."""

    holds: bool
    time: float
    tests: int


def prove(setting: Setting, trajectory: Trajectory) -> Proof:
    """Prove `trajectory` free of collision in `setting`, or return where that fails."""
    return _Prover(setting, trajectory).run()


class _Prover:
    def __init__(self, setting: Setting, trajectory: Trajectory) -> None:
        self._setting, self._trajectory = setting, trajectory
        self._known: dict[tuple[int, float, int], bool] = {}

    def run(self) -> Proof:
        times = self._trajectory.times
        intervals = [interval for piece in range(len(times) - 1) for interval in self._intervals(piece)]
        for piece, a, b in _spread(intervals):  # far apart first, so that a collision is met soon
            where = self._violation(piece, a, b)
            if where is not None:
                return Proof(False, float(times[piece] + where * (times[piece + 1] - times[piece])), len(self._known))
        return Proof(True, float("nan"), len(self._known))

    def _intervals(self, piece: int) -> list[tuple[int, float, float]]:
        """Return a `piece` cut into intervals (piece, u_a, u_b) over which nothing moves farther than the first level."""
        count = max(1, int(np.ceil(self._travel(piece, 0.0, 1.0) / LEVELS[0])))
        edges = np.linspace(0.0, 1.0, count + 1).tolist()
        return [(piece, a, b) for a, b in zip(edges[:-1], edges[1:], strict=True)]

    def _travel(self, piece: int, a: float, b: float) -> float:
        """Return a bound on how far any point moves on a `piece` between its parameters `a` and `b` [m]."""
        ends, slopes = self._at(piece, a, b)
        handles = slopes * (b - a) / 3
        inner = ends[1] - handles[1] - ends[0] - handles[0]
        return float(self._setting.travel(np.abs(handles).sum(axis=0) + np.abs(inner)))

    def _at(self, piece: int, *u: float) -> tuple[FloatArray, FloatArray]:
        """Return positions and derivatives (len(u), dof) by the parameter of a `piece` at `u`."""
        c0, c1, c2, c3 = self._trajectory.coefficients[:, piece]
        x = np.array(u)[:, None]
        return c0 + x * (c1 + x * (c2 + x * c3)), c1 + x * (2 * c2 + 3 * x * c3)

    def _violation(self, piece: int, a: float, b: float) -> float | None:
        """Return the parameter in [a, b] at which the proof of a `piece` fails, or None."""
        travel = self._travel(piece, a, b)
        if travel > LEVELS[0] * (1 + 1e-9):
            level = -1
        else:
            level = int(np.searchsorted(-LEVELS, -travel, side="right")) - 1
            level = min(max(level, 0), len(LEVELS) - 1)
            if self._passes(piece, a, level) and self._passes(piece, b, level):
                return None
        for u in (a, b):
            if not self._passes(piece, u, len(LEVELS) - 1):
                return u
        if level == len(LEVELS) - 1:
            return (a + b) / 2
        middle = (a + b) / 2
        where = self._violation(piece, a, middle)
        return self._violation(piece, middle, b) if where is None else where

    def _passes(self, piece: int, u: float, level: int) -> bool:
        if u == 1.0 and piece + 2 < len(self._trajectory.times):
            piece, u = piece + 1, 0.0
        key = piece, u, level
        if key not in self._known:
            self._known[key] = self._setting.passes(self._at(piece, u)[0][0], level)
        return self._known[key]


def _spread(items: list[tuple[int, float, float]]) -> list[tuple[int, float, float]]:
    """Return `items` in an order in which each next one is far from those before it."""
    order: list[int] = []
    stride = 1 << max(len(items) - 1, 0).bit_length()
    seen = np.zeros(len(items), dtype=bool)
    while stride:
        fresh = [i for i in range(0, len(items), stride) if not seen[i]]
        seen[fresh] = True
        order += fresh
        stride //= 2
    return [items[i] for i in order]
