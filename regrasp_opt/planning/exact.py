"""Planning without any energy: random resting poses, exact checks of every grasp, and the shortest path between them.

The baseline that learning and optimisation have to beat, and a way to plan where nothing was trained. Poses that share
a grasp are neighbours; of the paths with the fewest poses, those whose worst pair shares the most grasps come first
(dynamic programming over the number of poses). More poses are drawn as long as that may save a regrasp.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.geometry.planar_poses import PlanarPoses

MAX_REGRASPS = 8
"""Largest number of intermediate poses that can be asked for."""

SIZES = (128, 512, 1024)
"""Numbers of random poses that are tried, one after the other; each keeps those of the one before."""

PORTION = 64
"""Poses that are checked before the clock is looked at."""

PATHS = 50
"""Paths of one length that are offered at most."""


class Path(NamedTuple):
    """Placement numbers (N,), planar parameters (N, 3) and feasible grasps (N, G) of N intermediate poses."""

    placements: IntArray
    xi: FloatArray
    feasible: BoolArray


class RestingPoses:
    """Random resting poses in the workspace with their exactly feasible grasps; they grow on demand.

    Parameters
    ----------
    checker : FeasibilityChecker
    placements : PlanarPoses
        S stable placements on the supports.
    rng : Generator
    choices : (C,) int, optional
        Numbers of those that are drawn; by default all.
    """

    def __init__(
        self,
        checker: FeasibilityChecker,
        placements: PlanarPoses,
        rng: np.random.Generator,
        choices: IntArray | None = None,
    ) -> None:
        self._checker, self._placements, self._rng, self._choices = checker, placements, rng, choices
        self.numbers = np.zeros(0, dtype=np.int64)
        self.xi = np.zeros((0, 3))
        self.feasible = np.zeros((0, len(checker.grasps)), dtype=bool)
        self.drawn = 0

    def grow(self, size: int) -> None:
        """Draw until `size` poses were drawn; those at which no grasp is feasible are not kept."""
        count, grasps = size - self.drawn, len(self._checker.grasps)
        numbers, xi = self._placements.draw(count, self._rng, self._choices)
        T = self._placements.at(numbers, xi)
        pairs = np.tile(np.arange(grasps), count)
        found = self._checker.feasible_pairs(np.repeat(T, grasps, axis=0), pairs).reshape(count, grasps)
        useful = found.any(axis=1)
        self.numbers = np.concatenate([self.numbers, numbers[useful]])
        self.xi = np.concatenate([self.xi, xi[useful]])
        self.feasible = np.concatenate([self.feasible, found[useful]])
        self.drawn = size

    def shortest_paths(self, start: BoolArray, goal: BoolArray, counts: range) -> Iterator[Path]:
        """Yield the paths with the fewest poses, a number in `counts`, from grasp set `start` (G,) to `goal` (G,).

        The widest come first: those whose neighbours share the most grasps, at the pair that shares the fewest.
        """
        sets = self.feasible.astype(np.float32)
        shared = sets @ sets.T
        widths = sets @ start.astype(np.float32)
        last = sets @ goal.astype(np.float32)
        before: list[IntArray] = []
        for count in range(1, counts.stop if len(sets) else 1):
            ends = np.minimum(widths, last)
            if count in counts and ends.any():
                for end in np.argsort(-ends, kind="stable")[:PATHS]:
                    if ends[end] > 0:
                        yield self._path(int(end), before)
                return
            through = np.minimum(widths[:, None], shared)
            before.append(through.argmax(axis=0))
            widths = through.max(axis=0)

    def _path(self, end: int, before: list[IntArray]) -> Path:
        """Return the path to pose `end`, from which `before` leads back to the first one."""
        path = [end]
        for previous in reversed(before):
            path.append(int(previous[path[-1]]))
        chosen = np.array(path[::-1])
        return Path(self.numbers[chosen], self.xi[chosen], self.feasible[chosen])
