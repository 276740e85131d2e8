"""The nonlinear program of one problem, start and goal: `RegraspProblem.nlp`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.connectivity.casadi_costs import INPUT
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import OptionError, PoseError
from regrasp_opt.feasibility.diagnosis import diagnose, summary
from regrasp_opt.planning.ends import checked_end, known_energy
from regrasp_opt.planning.problem_data import ProblemData
from regrasp_opt.solvers import RegraspNLP, lattice_starts
from regrasp_opt.solvers.nlp import useful_grasps_near

_CHAINS = 400
"""Lattice chains among which the first with the wanted placements is looked for."""


def sequence_nlp(
    problem: ProblemData,
    start: Any,
    goal: Any,
    placements: Sequence[int] | None,
    num_regrasps: int,
    guess: Any,
    mask: Any,
    options: CostOptions,
) -> RegraspNLP:
    """Return the program that `RegraspProblem.nlp` describes."""
    energy = problem.energy
    ends = [_end(problem, end, name) for end, name in ((start, "start"), (goal, "goal"))]
    numbers = None if placements is None else energy.placement_numbers(placements)
    count = _count(num_regrasps if numbers is None else len(numbers))
    objective = _objective(problem, ends, options)
    if numbers is None or guess is None:
        numbers, near = _from_lattice(problem, objective, count, numbers)
        guess = near if guess is None else guess
    xi = np.asarray(guess, dtype=np.float64)
    if xi.shape != (count, 3):
        raise OptionError(f"the guess has shape {xi.shape}; give {count} rows (x, y, theta)")
    blocked = problem.ruled_out(numbers, xi)
    if mask is None and objective is not None:
        mask = np.isin(np.arange(len(energy)), useful_grasps_near(objective, blocked))
    functions = energy.casadi_functions(
        placements=numbers.tolist(),
        start=ends[0],
        goal=ends[1],
        mask=mask,
        blocked=blocked,
        options=options,
    )
    values = {"mask": np.ones(len(energy))} if isinstance(mask, str) else {}
    planar = problem.rests.planar[numbers]
    return RegraspNLP(functions, (planar.low, planar.high), xi, values)


def _count(num_regrasps: Any) -> int:
    if isinstance(num_regrasps, bool) or not isinstance(num_regrasps, (int, np.integer)) or num_regrasps < 1:
        raise OptionError(f"the program has {num_regrasps} intermediate poses; give at least 1")
    return int(num_regrasps)


def _end(problem: ProblemData, end: Any, name: str) -> Any:
    """Return the energies (G,) of an end, or "input"."""
    if isinstance(end, str) and end == INPUT:
        return end
    if np.shape(end) == (len(problem.grasps),):
        return np.asarray(end, dtype=np.float64)
    T = checked_end(end, name, problem)
    feasible = problem.feasible_grasps(T)
    if not feasible.any():
        raise PoseError(f"no grasp is feasible at the {name} pose: {summary(diagnose(problem.checker, T))}")
    return known_energy(problem.energy, T, feasible)


def _objective(problem: ProblemData, ends: list[Any], options: CostOptions) -> SequenceObjective | None:
    """Return the planner's objective, or None where an end is not known yet."""
    if any(isinstance(end, str) for end in ends):
        return None
    return problem.objective(ends[0], ends[1], options)


def _from_lattice(
    problem: ProblemData, objective: SequenceObjective | None, count: int, numbers: IntArray | None
) -> tuple[IntArray, FloatArray]:
    """Return placements and a guess (N, 3): of the best chain with those placements, or the workspace's centre."""
    if objective is not None:
        chains = lattice_starts(problem.lattice, objective, count, _CHAINS, np.random.default_rng(0))
        fits = np.ones(len(chains), dtype=bool) if numbers is None else (chains.placements == numbers).all(axis=1)
        if fits.any():
            return chains.placements[fits][0], chains.xi[fits][0]
    if numbers is None:
        raise OptionError("placements cannot be chosen for these ends; give placements")
    planar = problem.rests.planar
    middle = planar.inside(numbers, np.full((count, 3), 0.5))
    return numbers, np.where(np.isfinite(planar.high[numbers]), middle, 0.0)
