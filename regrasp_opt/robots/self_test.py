"""Tests whether an inverse kinematics finds the arm's own configurations, and chooses a solver by that.

Libraries fail for some arms without saying so: no branch for poses that the arm is at. So the solver is asked for
the poses of seeded configurations, and its answers have to hold these configurations.
"""

from __future__ import annotations

import logging
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, pose_distance
from regrasp_opt.robots.analytic import AnalyticIk, descriptions
from regrasp_opt.robots.ik import InverseKinematics, one_turn
from regrasp_opt.robots.kinematics import SerialChain
from regrasp_opt.robots.locked import LockedIk, Sample, halving
from regrasp_opt.robots.numerical import NumericalIk

logger = logging.getLogger(__name__)

TRIED = 64
"""Configurations that a solver is tried on."""
ENOUGH = 0.85
"""Share of them that an analytic solver has to find. Where axes are a millimetre off it misses up to a tenth, those
next to singularities; one that does not fit the arm misses most."""
ANYWHERE = 0.38
"""A joint is not locked where this share of its range leaves an arm without an analytic solver."""
SAME = 1e-3
"""A configuration is found where no joint of a solution is further away, but for whole turns [rad, m]."""


class IkTest(NamedTuple):
    """How well an inverse kinematics did on configurations of the arm itself.

    Attributes
    ----------
    solver : str
        ``"analytic"`` with EAIK's name of the decomposition and the joint that is locked, or ``"numerical"``.
    tried : int
        Number of configurations.
    solved : int
        For how many of their poses there was any solution.
    found : int
        How many of the configurations were among the solutions. More than six joints, or axes that coincide, have
        infinitely many solutions, of which it will hardly be one.
    residual : float
        Largest distance between a solution's pose and the one asked for [m, rad].
    """

    solver: str
    tried: int
    solved: int
    found: int
    residual: float


def self_test(ik: InverseKinematics, chain: SerialChain, lower: FloatArray, upper: FloatArray) -> IkTest:
    """Return how `ik` does on random configurations of `chain` within the limits (dof,) [rad, m]."""
    q = np.random.default_rng(0).uniform(lower, upper, (TRIED, chain.dof))
    T = chain.forward(q)
    solutions = ik.solve(T)
    apart = solutions.q - q[solutions.pose_index]
    apart = np.where(chain.prismatic, apart, apart - 2 * np.pi * np.round(apart / (2 * np.pi)))
    same = np.abs(apart).max(axis=1) <= SAME
    distance, angle = pose_distance(chain.forward(solutions.q), T[solutions.pose_index])
    return IkTest(
        solver=ik.name,
        tried=TRIED,
        solved=len(set(solutions.pose_index)),
        found=len(set(solutions.pose_index[same])),
        residual=float(np.maximum(distance, angle).max(initial=0.0)),
    )


def inverse_kinematics(name: str, chain: SerialChain, lower: FloatArray, upper: FloatArray) -> InverseKinematics:
    """Return the analytic solver that does best on `chain`, or a numerical one where none does well enough.

    Limits are arrays (dof,) [rad, m]; `name` is the arm's, for the log.
    """
    best = _analytic(chain, lower, upper)
    if best is not None and best[0] >= ENOUGH * TRIED:
        return best[1]
    if best is not None:
        logger.warning(
            "%s: the analytic inverse kinematics for %s finds %d of %d configurations of this arm; the numerical one "
            "is used",
            name,
            best[1].family,
            best[0],
            TRIED,
        )
    locked = _locked(chain, lower, upper)
    return NumericalIk(chain, lower, upper) if locked is None else locked


def _analytic(chain: SerialChain, lower: FloatArray, upper: FloatArray) -> tuple[int, AnalyticIk] | None:
    """Return the solver that finds most configurations of `chain`, and how many of `TRIED`; None if there is none."""
    best: tuple[int, AnalyticIk] | None = None
    for solver in descriptions(chain, lower, upper):
        found = self_test(solver, chain, lower, upper).found
        if best is None or found > best[0]:
            best = found, solver
        if found == TRIED:
            break
    return best


def _locked(chain: SerialChain, lower: FloatArray, upper: FloatArray) -> LockedIk | None:
    """Return the solver that reaches most poses of a chain of seven joints with one of them locked."""
    best: tuple[int, LockedIk] | None = None
    low, high = one_turn(chain, lower, upper)
    for joint in reversed(range(chain.dof)) if chain.dof == 7 else ():
        if not _samples(chain, lower, upper, joint, [low[joint] + ANYWHERE * (high[joint] - low[joint])]):
            continue
        levels = [_samples(chain, lower, upper, joint, values) for values in halving(low[joint], high[joint])]
        if not any(levels):
            continue
        ik = LockedIk(chain, lower, upper, joint, [level for level in levels if level])
        solved = self_test(ik, chain, lower, upper).solved
        if solved >= ENOUGH * TRIED and (best is None or solved > best[0]):
            best = solved, ik
        if solved == TRIED:
            break
    return None if best is None else best[1]


def _samples(chain: SerialChain, lower: FloatArray, upper: FloatArray, joint: int, values: list[float]) -> list[Sample]:
    """Return those of the `values` of a joint at which the arm that is left has an analytic solver."""
    others = np.arange(chain.dof) != joint
    solvers = [(x, _analytic(chain.locked(joint, x), lower[others], upper[others])) for x in values]
    return [Sample(x, best[1]) for x, best in solvers if best is not None and best[0] >= ENOUGH * TRIED]
