"""Numerical inverse kinematics of any serial arm: Levenberg-Marquardt from many starts, kept within the limits.

For arms without a known decomposition, with more than six joints or fewer. The starts of a pose are those of many
stored random configurations whose poses are nearest to it. From there a few steps suffice, and as the number of stored
configurations with poses near a given one is about the same around each of its solutions, most of these are found.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from itertools import pairwise

import numpy as np
from scipy.spatial import KDTree

from regrasp_opt.conventions import FloatArray
from regrasp_opt.robots.ik import IkSolutions, distinct, in_pieces, nearest_rotations, one_turn, verify
from regrasp_opt.robots.kinematics import SerialChain
from regrasp_opt.robots.newton import descend

STORED = 50_000
"""Stored configurations. Making them takes 0.1 s, when the first pose is solved."""

PORTIONS = (0, 16, 64, 256)
"""Starts for each pose: the nearest 16, those up to the 64th, and so on.

For 120 random poses of either of two general six-joint arms, 64 starts found the branch that the pose came from in 92 %
of the cases, 256 in 99 %.
"""

REDUNDANT_PORTIONS = (0, 16, 64)
"""The same for more than six joints, where any few of the infinitely many solutions will do."""

STEPS = 12
"""Steps from one start."""

NEARBY = 3.0
"""Weight of the position, as a share of the arm's reach, beside the entries of the rotation matrix."""

AT_ONCE = 8192
"""Starts that descend together, however many poses there are."""


class NumericalIk:
    """Inverse kinematics by descent from stored starts: the same poses always give the same result.

    Parameters
    ----------
    chain : SerialChain
        The arm.
    lower, upper : (dof,) arrays
        Joint limits [rad, m].

    Attributes
    ----------
    parts : tuple of functions
        See `InverseKinematics`: one for each portion of starts, the nearest first.
    """

    name = "numerical"

    def __init__(self, chain: SerialChain, lower: FloatArray, upper: FloatArray) -> None:
        self._chain, self._lower, self._upper = chain, lower, upper
        # A joint that turns all the way round has no limits to keep.
        whole = ~chain.prismatic & (upper - lower >= 2 * np.pi)
        self._limits = np.where(whole, -np.inf, lower), np.where(whole, np.inf, upper)
        self._reach = chain.reach(lower, upper)
        portions = PORTIONS if chain.dof <= 6 else REDUNDANT_PORTIONS
        self._starts = portions[-1]
        self.parts: tuple[Callable[[FloatArray], IkSolutions], ...] = tuple(
            partial(self._solve_from, *portion) for portion in pairwise(portions)
        )

    def solve(self, T_base_tip: FloatArray) -> IkSolutions:
        """Return distinct solutions within the joint limits for poses (B, 4, 4), each one verified.

        Up to six joints nearly all branches, but not surely all.
        """
        return self._solve_from(0, self._starts, T_base_tip)

    def _solve_from(self, first: int, last: int, T_base_tip: FloatArray) -> IkSolutions:
        """Return the solutions that are found from the nearest starts, from number `first` to `last` of each pose."""
        return in_pieces(partial(self._solve_few, first, last), T_base_tip, AT_ONCE // (last - first))

    def _solve_few(self, first: int, last: int, T_base_tip: FloatArray) -> IkSolutions:
        T, (stored, tree) = nearest_rotations(T_base_tip), self._stored
        near = np.flatnonzero(np.linalg.norm(T[:, :3, 3], axis=1) <= self._reach)
        _, starts = tree.query(self._coordinates(T[near]), np.arange(first, last) + 1)
        index = np.repeat(near, last - first)
        q, _ = descend(self._chain, T[index], stored[starts.reshape(-1)], STEPS, self._limits)
        return distinct(verify(self._chain, T, IkSolutions(q, index), self._lower, self._upper))

    @cached_property
    def _stored(self) -> tuple[FloatArray, KDTree]:
        """Random configurations (STORED, dof), and the tree of their poses."""
        low, high = one_turn(self._chain, self._lower, self._upper)
        q = np.random.default_rng(0).uniform(low, high, (STORED, self._chain.dof))
        return q, KDTree(self._coordinates(self._chain.forward(q)))

    def _coordinates(self, T: FloatArray) -> FloatArray:
        """Return the points (B, 12) whose distance says how near poses (B, 4, 4) are to each other."""
        scaled = NEARBY / max(self._reach, 1e-9) * T[:, :3, 3]
        return np.concatenate([scaled, T[:, :3, :3].reshape(-1, 9)], axis=1)
