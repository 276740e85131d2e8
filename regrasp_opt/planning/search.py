"""`solve_sequence`: the fewest intermediate poses such that all neighbours share a grasp (Alg. 1, with hard checks).

For N = 0, 1, ... the start points of a recipe are refined, ranked by ``J_seq`` and verified in that order; the first
that holds ends the search. A refiner is local, so with lattice starts the best lattice chains are then verified as they
are before N grows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from regrasp_opt.connectivity import CostOptions, exact_energy, sequence_cost
from regrasp_opt.conventions import as_seed
from regrasp_opt.errors import OptionError
from regrasp_opt.planning.alternatives import Alternatives
from regrasp_opt.planning.at_rest import TOLERANCE, as_tolerance
from regrasp_opt.planning.clock import Clock
from regrasp_opt.planning.deepening import Search
from regrasp_opt.planning.ends import resting_end
from regrasp_opt.planning.equivalents import equivalent_goals
from regrasp_opt.planning.exact import MAX_REGRASPS, PORTION, SIZES, Path, RestingPoses
from regrasp_opt.planning.filters import filtered
from regrasp_opt.planning.plan import RegraspPlan
from regrasp_opt.planning.plan_data import Status
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.recipes import EXACT, Recipe, as_recipe
from regrasp_opt.planning.verification import PoseFeasibility
from regrasp_opt.solvers import LatticeRefiner, Refiner
from regrasp_opt.threads import one_blas_thread

MOST_ALTERNATIVES = 100
"""Further plans that can be asked for."""


def solve_sequence(
    problem: RegraspProblem,
    start: Any,
    goal: Any,
    refiner: str | Refiner | Recipe = "ipopt",
    *,
    max_regrasps: int = 5,
    seed: int = 0,
    time_limit: float | None = None,
    options: CostOptions | None = None,
    accept: Callable[[RegraspPlan], bool] | None = None,
    tolerance: tuple[float, float] = TOLERANCE,
    symmetry: bool = False,
    num_regrasps: int | None = None,
    placements: Iterable[int] | None = None,
    supports: Iterable[str] | None = None,
    grasps: Any = None,
    alternatives: int = 0,
) -> RegraspPlan:
    """Plan from `start` to `goal` with as few regrasps as possible.

    Parameters
    ----------
    problem : RegraspProblem
    start, goal : (4, 4) array_like or dict
        T_world_object, as `regrasp_opt.conventions.as_pose` takes it. Where the object does not rest, the nearest
        resting pose takes its place, and `RegraspPlan.given` keeps what was measured.
    refiner : {"ipopt", "lattice", "langevin", "langevin-ipopt", "paper", "exact"} or Refiner or Recipe
        What improves candidate sequences, see `regrasp_opt.planning.recipes`. An object with the `Refiner` protocol
        gets lattice chains as start points. "exact" needs no energy: random resting poses, exact checks, and the
        shortest path (`regrasp_opt.planning.exact`); its cost is `J_seq` of the exact feasibilities.
    max_regrasps : int
        Largest number N of intermediate poses.
    seed : int
        The same seed gives the same plan on the same machine.
    time_limit : float, optional
        Seconds after which the search gives up between two candidates; the plan then holds the poses of the cheapest
        candidate so far, unverified and without transitions.
    options : CostOptions, optional
        Parameters of ``J_seq``; the paper's by default.
    accept : callable, optional
        Is shown each verified plan; where it returns False, the search goes on with the next candidate.
    tolerance : (float, float)
        How far `start` and `goal` may be from rest: distance [m] and angle [rad].
    symmetry : bool
        Goals that differ by a turn about the object's axis of symmetry count as equal, and the best is taken.
    num_regrasps : int, optional
        Exactly this number of intermediate poses, instead.
    placements, supports : iterables of int, and of str, optional
        Placements, and names of supports, that intermediate poses may have.
    grasps : (G,) bool, grasp numbers or callable, optional
        Grasps that may be used; a callable says which tool poses (M, 4, 4) T_world_tcp may be (`filters.from_above`).
    alternatives : int
        Further plans to look for, with at most one regrasp more, which differ in a support or placement, or share no
        grasp in some transition; they are in `RegraspPlan.alternatives`.

    Returns
    -------
    RegraspPlan
        Its status says how planning ended; SOLVED means that every transition was verified.

    Raises
    ------
    PoseError
        If `start` or `goal` cannot be a pose of the object in this workcell, is farther from rest than `tolerance`, or
        may be one of two resting poses.
    OptionError, UnknownNameError
        For an option out of its range, an unknown refiner, or `symmetry` of an object that has none.
    ModelError
        If the refiner needs an energy, and a file is broken or none can be trained (`ProblemData.energy`).
    """
    counts, clock = _counts(max_regrasps, num_regrasps), _clock(time_limit)
    others = Alternatives(_whole("alternatives", alternatives, MOST_ALTERNATIVES), accept)
    how = options or CostOptions(), as_seed(seed), clock, others if alternatives else accept
    recipe = None if isinstance(refiner, str) and refiner == EXACT else as_recipe(refiner)
    with one_blas_thread():
        problem = filtered(problem, placements, supports, grasps)
        ends = _ends(problem, start, goal, clock, as_tolerance(tolerance), symmetry=symmetry)
        kind = _ExactSearch if recipe is None else Search
        return others.of(_run(kind(problem, recipe or Recipe(LatticeRefiner()), ends, *how), counts))


def _run(search: Search, counts: range) -> RegraspPlan:
    for end, status in zip(search.ends, (Status.START_INFEASIBLE, Status.GOAL_INFEASIBLE), strict=True):
        if not end.all().any():
            _check_filter(search.problem, end)
            return search.result(status)
    return search.run(counts)


def _clock(time_limit: float | None) -> Clock:
    if time_limit is not None and not time_limit > 0:
        raise OptionError(f"time_limit is {time_limit}; give a positive number of seconds")
    return Clock(time_limit)


def _counts(max_regrasps: int, num_regrasps: int | None) -> range:
    """Return the numbers of regrasps to be tried."""
    if num_regrasps is not None:
        least = _whole("num_regrasps", num_regrasps, MAX_REGRASPS)
        return range(least, least + 1)
    return range(_whole("max_regrasps", max_regrasps, MAX_REGRASPS) + 1)


def _ends(
    problem: RegraspProblem, start: Any, goal: Any, clock: Clock, tolerance: tuple[float, float], *, symmetry: bool
) -> list[PoseFeasibility]:
    """Return what is known of both ends, whose grasps are checked here; equal goals count as one with `symmetry`."""
    poses = (resting_end(T, name, problem, tolerance) for T, name in ((start, "start"), (goal, "goal")))
    ends = [PoseFeasibility(problem.checker, T, given=given) for T, given in poses]
    with clock.timed("ends"):
        if symmetry:
            ends[1] = equivalent_goals(problem, ends[0], ends[1], tolerance)
        for end in ends:
            end.all()
    return ends


def _whole(name: str, value: Any, most: int) -> int:
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    if not whole or not 0 <= value <= most:
        raise OptionError(f"{name} is {value}; give a whole number from 0 to {most}")
    return int(value)


def _check_filter(problem: RegraspProblem, end: PoseFeasibility) -> None:
    """Raise an OptionError where only the choice of grasps keeps an end from having a feasible one."""
    if problem.original is not problem:
        free = int(problem.original.checker.feasible(end.T).sum())
        if free:
            raise OptionError(f"grasps leaves none of the {free} grasps that are feasible at start or goal; allow more")


class _ExactSearch(Search):
    """The shortest path between exactly checked random poses, without an energy."""

    def _deeper(self, counts: range) -> RegraspPlan:
        problem, rng = self.problem, np.random.default_rng(self.seed)
        poses = RestingPoses(problem.checker, problem.rests.planar, rng, problem.choices)
        found: RegraspPlan | None = None
        most = counts.stop - 1
        for size in SIZES if counts else ():
            if self.clock.over:
                return found or self.result(Status.TIME_LIMIT)
            with self.clock.timed("checks"):
                while poses.drawn < size and not self.clock.over:
                    poses.grow(min(size, poses.drawn + PORTION))
            told = {"refiner": EXACT, "max_regrasps": most}
            self.stats.append({**told, "poses": poses.drawn, "graspable": len(poses.xi)})
            start, goal = (end.all() for end in self.ends)
            better = next(filter(None, map(self._accepted_plan, poses.shortest_paths(start, goal, counts))), None)
            if better is not None:
                found, counts = better, range(counts.start, better.num_regrasps)
                self.stats[-1]["num_regrasps"] = better.num_regrasps
            if found is not None and (better is None or not counts):
                break  # more poses do not save a regrasp, or none can be saved
        return found or self.result(Status.NOT_FOUND)

    def _accepted_plan(self, path: Path) -> RegraspPlan | None:
        T = self.problem.rests.planar.at(path.placements, path.xi)
        known = zip(T, path.feasible, strict=True)
        middle = [PoseFeasibility(self.problem.checker, *each) for each in known]
        chain = [self.ends[0], *middle, self.ends[1].beside(middle[-1])]
        cost = float(sequence_cost(np.array([exact_energy(pose.all()) for pose in chain]), self.options))
        cost += float(self.problem.rests.planar.weights[path.placements].sum())
        plan = self.result(Status.SOLVED, cost=cost, chain=chain, placements=path.placements, xi=path.xi)
        return plan if self._accepted(plan) else None
