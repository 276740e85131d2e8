"""Inverse kinematics of an arm with one joint more than six: that joint is locked, and the others are solved.

The solutions of a pose are a curve. Where it meets a few values of one joint, it is found by the analytic solver of the
arm that has this joint locked there. Any joint will do that leaves an arm with a known decomposition, a slide under a
six-joint arm too; for most seven-joint arms it is one of the last three.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.robots.analytic import AnalyticIk, settle
from regrasp_opt.robots.ik import IkSolutions, in_pieces, nearest_rotations
from regrasp_opt.robots.kinematics import SerialChain

HALVINGS = 5
"""How often the steps between the values of the locked joint are halved."""

AT_ONCE = 2048
"""Poses times values that are solved together."""


class Sample(NamedTuple):
    """A value of the locked joint [rad, m] and the solver of the arm that is left, `SerialChain.locked`."""

    value: float
    others: AnalyticIk


class LockedIk:
    """All solutions of a chain at some values of one joint.

    Parameters
    ----------
    chain : SerialChain
    lower, upper : (dof,) arrays
        Joint limits [rad, m].
    joint : int
        Number of the locked joint.
    samples : sequence of sequences of Sample
        Each of them is a part of the solver: the first few are spread over the joint's range, and those of the next
        part lie between them.

    Attributes
    ----------
    joint : int
    samples : tuple of Sample
    parts : tuple of functions
        See `InverseKinematics`.
    """

    def __init__(
        self,
        chain: SerialChain,
        lower: FloatArray,
        upper: FloatArray,
        joint: int,
        samples: Sequence[Sequence[Sample]],
    ) -> None:
        self._chain, self._lower, self._upper, self.joint = replace(chain, still=joint), lower, upper, joint
        self.samples = tuple(sample for some in samples for sample in some)
        self.parts: tuple[Callable[[FloatArray], IkSolutions], ...] = tuple(
            partial(self._solve_at, some) for some in samples
        )

    @property
    def name(self) -> str:
        """What it is, for people."""
        return f"analytic, {self.samples[0].others.family} with joint {self.joint + 1} locked"

    def solve(self, T_base_tip: FloatArray) -> IkSolutions:
        """Return the branches within the joint limits at all samples for poses (B, 4, 4), each one verified."""
        return self._solve_at(self.samples, T_base_tip)

    def without_limits(self) -> LockedIk:
        """Return the solver of the same arm with joints that turn all the way round, but for the locked one."""
        free, turns = copy(self), ~self._chain.prismatic
        free._lower, free._upper = np.where(turns, -np.pi, self._lower), np.where(turns, np.pi, self._upper)
        return free

    def _solve_at(self, samples: Sequence[Sample], T_base_tip: FloatArray) -> IkSolutions:
        """Return the branches at `samples`."""
        return in_pieces(partial(self._solve_few, samples), T_base_tip, AT_ONCE // len(samples))

    def _solve_few(self, samples: Sequence[Sample], T_base_tip: FloatArray) -> IkSolutions:
        T = nearest_rotations(T_base_tip)
        found = [sample.others.near(T) for sample in samples]
        index = np.concatenate([near.pose_index for near, _ in found])
        order = np.argsort(index, kind="stable")
        q = [np.insert(near.q, self.joint, s.value, axis=1) for s, (near, _) in zip(samples, found, strict=True)]
        touching = None
        if any(polished is not None for _, polished in found):
            parts = [np.zeros(len(near.q), bool) if polished is None else polished for near, polished in found]
            touching = np.concatenate(parts)[order]
        near = IkSolutions(np.concatenate(q)[order], index[order])
        return settle(self._chain, T, near, touching, self._lower, self._upper)


def halving(lower: float, upper: float) -> list[list[float]]:
    """Return values between the limits of a joint: the middle, then those of the halves, and so on."""
    steps = [2**k for k in range(HALVINGS)]
    return [[lower + (upper - lower) * (i + 0.5) / n for i in range(n)] for n in steps]
