"""The growing set of grasps in a search with free grasps, and how it grows at random."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.grasps import GraspSet
from regrasp_opt.grasps.projection import GraspProjector
from regrasp_opt.motion.free_grasps.program import random_move
from regrasp_opt.planning import RegraspProblem

ENOUGH = 5
"""Grasps that work at an end from which on none are looked for there in particular."""

CANDIDATES = 2000
"""Tool poses of which those with the least energy are tried at an end where grasps are looked for."""


class GraspPool:
    """The grasps of `problem`, of which there are `sampled`, and behind them those that were added.

    `T` is a list of T_object_tcp (4, 4), `width` one of jaw widths [m].
    """

    def __init__(self, problem: RegraspProblem, ends: FloatArray, rng: np.random.Generator) -> None:
        grasps = problem.grasps
        self.T, self.width, self.sampled = list(grasps.T_object_tcp), grasps.width.tolist(), len(grasps)
        self._problem, self._ends, self._rng, self._kind = problem, ends, rng, grasps.kind
        self._settler = GraspProjector(problem.object, problem.workcell.arm.end_effector)
        self._grade = self._settler.worst_grade(grasps)
        self._verified = np.zeros((len(ends), 0), dtype=bool)

    def add(self, T: FloatArray, width: float) -> int:
        """Append a grasp and return its number."""
        self.T.append(T)
        self.width.append(width)
        return len(self.T) - 1

    def grasps(self, ids: Any = slice(None)) -> GraspSet:
        """Return the grasps with numbers `ids`."""
        return GraspSet(np.array(self.T), np.array(self.width), self._kind).subset(np.arange(len(self.T))[ids])

    def problem(self) -> RegraspProblem:
        """Return the problem with all grasps."""
        return replace(self._problem, grasps=self.grasps())

    def verified(self) -> BoolArray:
        """Return which grasps (2, G) are feasible at start and goal."""
        known = self._verified.shape[1]
        if known < len(self.T):
            checker = replace(self._problem, grasps=self.grasps(slice(known, None))).checker
            fresh = np.array([checker.feasible(T) for T in self._ends])
            self._verified = np.hstack([self._verified, fresh])
        return self._verified

    def settled(self, T: FloatArray) -> GraspSet:
        """Return the grasps that tool poses (B, 4, 4) settle in."""
        return self._settler.settle(T, self._grade)[0]

    def explore(self, count: int) -> None:
        """Add what `count` random tool poses settle in: half of them moved from known grasps, half from anywhere.

        Where few known grasps work at an end, twice as many more are those of `CANDIDATES` with the least energy there.
        """
        tools = [self._random(count)[0]]
        for T_end, verified in zip(self._ends, self.verified(), strict=True):
            if verified.sum() < ENOUGH:
                T, width = self._random(CANDIDATES)
                energy = GraspEnergy(self._problem.energy.model, GraspSet(T, width, self._kind))(T_end)
                tools.append(T[np.argsort(energy)[: 2 * count]])
        grasps = self.settled(np.concatenate(tools))
        for T, width in zip(grasps.T_object_tcp, grasps.width.tolist(), strict=True):
            self.add(T, width)

    def _random(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return tool poses (K, 4, 4), K at most `count`, and widths (K,)."""
        base = self._rng.integers(len(self.T), size=count - count // 2)
        near = np.array([self.T[k] @ random_move(self._kind, self._rng) for k in base]).reshape(-1, 4, 4)
        far, width = self._settler.anywhere(count // 2, self._rng)
        return np.concatenate([near, far]), np.concatenate([np.array(self.width)[base], width])
