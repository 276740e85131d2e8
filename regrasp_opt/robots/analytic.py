"""All-branch inverse kinematics of six-joint arms with a known decomposition, through EAIK.

EAIK (Ostermeier, Kuelz, Althoff, 2024) solves the arm as a sequence of geometric subproblems. It knows
neither joint limits nor rounded poses, so targets are made exact rotations first and every branch is verified
afterwards. For some descriptions of an arm it fails where it solves others of the same arm: it takes parallel axes
to point the same way, and some subproblems degenerate where the zero configuration has right angles. And it knows
exact geometry only. So an arm is described in several ways, the plainest first, and what counts is whether the
solutions hold the arm's own configurations (`IkTest`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy

import numpy as np
from eaik.IK_HP import HPRobot

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.robots.alignment import aligned, senses
from regrasp_opt.robots.ik import IkSolutions, distinct, nearest_rotations, principal, verify
from regrasp_opt.robots.kinematics import SerialChain
from regrasp_opt.robots.newton import astride, descend, polish

POLISHED = 1e-7
"""Branches whose error is expected above this after two Newton steps are polished further [m, rad]."""
UNSURE = 1e-5
"""Above this they may have missed a branch that lies beside the one they went to, or be on their way to none."""
CAPTURE = 0.02
"""Least-squares solutions are given up where the tip misses the target by more [m, rad]."""
STEPS = 12
"""Further Newton steps for a branch."""
ASIDE = 0.1
"""Where branches nearly meet, one is looked for on either side, so far away [rad]."""


class AnalyticIk:
    """Inverse kinematics of a chain of six turning joints; see `analytic_ik`, which makes one.

    Parameters
    ----------
    chain : SerialChain
        The arm.
    lower, upper : (6,) arrays
        Joint limits [rad].
    zero : (6,) array
        The configuration that EAIK has as zero [rad].
    meet_from : int, optional
        Where given, EAIK is told of an arm with nearly parallel axes made parallel, and with those from this index
        on that nearly meet made to meet; its solutions are polished on the true arm.
    """

    def __init__(
        self, chain: SerialChain, lower: FloatArray, upper: FloatArray, zero: FloatArray, meet_from: int | None = None
    ) -> None:
        self._chain, self._lower, self._upper, self._zero = chain, lower, upper, zero
        frames, tip = chain.link_transforms(zero), chain.forward(zero)
        axes, points = (frames[:, :3, :3] @ chain.axes[..., None])[..., 0], frames[:, :3, 3]
        self._sense, self._polished = senses(axes), meet_from is not None
        if meet_from is not None:
            axes, points = aligned(axes, points, meet_from)
        points = np.concatenate([np.zeros((1, 3)), points, tip[None, :3, 3]])
        self._solver = HPRobot(axes * self._sense[:, None], np.diff(points, axis=0))
        self._R_tip_base_at_zero = tip[:3, :3].T

    @property
    def known(self) -> bool:
        """Whether EAIK knows a decomposition."""
        return bool(self._solver.hasKnownDecomposition())

    @property
    def family(self) -> str:
        """EAIK's name of the decomposition, for example ``"6R-THREE_INNER_PARALLEL"``."""
        return str(self._solver.getKinematicFamily())

    @property
    def name(self) -> str:
        """What it is, for people."""
        return f"analytic, {self.family}"

    @property
    def parts(self) -> tuple[Callable[[FloatArray], IkSolutions]]:
        """The whole: EAIK finds all branches at once."""
        return (self.solve,)

    def solve(self, T_base_tip: FloatArray) -> IkSolutions:
        """Return every branch within the joint limits for poses (B, 4, 4), each one verified."""
        T = nearest_rotations(T_base_tip)
        near, touching = self.near(T)
        return settle(self._chain, T, near, touching, self._lower, self._upper)

    def near(self, T: FloatArray) -> tuple[IkSolutions, BoolArray | None]:
        """Return what EAIK finds for poses `T` (B, 4, 4) with exact rotations.

        If that is for an arm next to the true one, it has yet to be polished. The second array (M,), which is None
        otherwise, says then which are only least-squares solutions.
        """
        targets = T.copy()
        targets[:, :3, :3] = T[:, :3, :3] @ self._R_tip_base_at_zero
        solutions = [self._solver.IK(target) for target in targets]
        raw = [solution.Q for solution in solutions]
        counts = np.array([len(q) for q in raw], dtype=np.int64)
        q = np.concatenate([np.zeros((0, 6)), *(branch for branch in raw if len(branch))]) * self._sense + self._zero
        found = IkSolutions(q, np.repeat(np.arange(len(T)), counts))
        if not self._polished:
            return found, None
        touching = [solution.is_LS for solution in solutions if len(solution.Q)]
        return found, np.concatenate([np.zeros(0, dtype=bool), *touching]).astype(bool)

    def without_limits(self) -> AnalyticIk:
        """Return the solver of the same arm with joints that turn all the way round."""
        free = copy(self)
        free._lower, free._upper = np.full(6, -np.pi), np.full(6, np.pi)
        return free


def settle(
    chain: SerialChain,
    T: FloatArray,
    near: IkSolutions,
    touching: BoolArray | None,
    lower: FloatArray,
    upper: FloatArray,
) -> IkSolutions:
    """Return the true solutions of `chain` within limits (dof,) for `T` (B, 4, 4) from those of `AnalyticIk.near`.

    Those of another arm are polished. Where a solution of that arm is only a least-squares one, `touching` (M,), this
    one may have two, or none.
    """
    if touching is None:
        return verify(chain, T, near, lower, upper)
    start, index = near
    q, errors = polish(chain, T[index], start)
    rough = np.flatnonzero((errors > POLISHED) & (errors < CAPTURE))
    unsure = np.flatnonzero((touching | (errors > UNSURE)) & (errors < CAPTURE))
    again = index[np.concatenate([rough, unsure, unsure])]
    starts = np.concatenate([q[rough], astride(chain, start[unsure], ASIDE)])
    better, left = descend(chain, T[again], starts, STEPS)
    q, index, errors = np.concatenate([q, better]), np.concatenate([index, again]), np.concatenate([errors, left])
    good = np.flatnonzero(errors <= POLISHED)
    good = good[np.argsort(index[good], kind="stable")]
    q, fits = principal(q[good], lower, upper, ~chain.prismatic)
    return distinct(IkSolutions(q[fits], index[good][fits]))


def descriptions(chain: SerialChain, lower: FloatArray, upper: FloatArray) -> Iterator[AnalyticIk]:
    """Yield solvers of `chain` that have a decomposition: of the arm as it is, then of arms next to it."""
    if chain.dof != 6 or chain.prismatic.any():
        return
    anywhere = np.random.default_rng(0).uniform(-1.0, 1.0, 6)
    wrist, everywhere, nowhere = 3, 0, 5
    for zero, meet_from in (
        (np.zeros(6), None),
        (anywhere, None),
        (anywhere, wrist),
        (anywhere, everywhere),
        (anywhere, nowhere),
    ):
        try:
            solver = AnalyticIk(chain, lower, upper, zero, meet_from)
        except RuntimeError:  # EAIK: axes that are parallel for one of its tests and meet for another
            continue
        if solver.known:
            yield solver
