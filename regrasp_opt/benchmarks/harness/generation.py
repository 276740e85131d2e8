"""One-step generation: many intermediate poses for one start and goal, ranked by cost, and their exact verdict.

As in the paper, every stable placement gets the same number of start points. `GENERATORS` differ in where these come
from, how they are refined and what is known of the ends.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from regrasp_opt.connectivity import BLOCKED, CostOptions, SequenceObjective, TableRule, exact_energy
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, planar_transform
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.solvers import Candidates, LangevinRefiner, LatticeRefiner, PoseLattice, Refiner
from regrasp_opt.solvers.lattice import shared_cost

DISTINCT = np.array([0.005, 0.005, np.radians(5.0)])
"""Poses of one placement that fall into the same cell of this size [m, m, rad] count as the same."""


@dataclass(frozen=True)
class Generator:
    """How intermediate poses are generated.

    Attributes
    ----------
    refiner : Refiner
    starts : {"lattice", "random"}
        The most promising lattice poses of each placement, or random ones.
    ends : {"exact", "learned"}
        Energies at start and goal: from the exact checks that any planner makes there, or from the model.
    """

    refiner: Refiner
    starts: Literal["lattice", "random"]
    ends: Literal["exact", "learned"]


GENERATORS: dict[str, Callable[[], Generator]] = {
    "lattice": lambda: Generator(LatticeRefiner(), "lattice", "exact"),
    "langevin": lambda: Generator(LangevinRefiner(), "random", "exact"),
    "paper": lambda: Generator(LangevinRefiner(keep_best=False), "random", "learned"),
}
"""Ours; ours with the paper's optimiser; the paper's optimiser and ends."""


@dataclass(frozen=True, eq=False)
class OneStepTask:
    """One start-goal pair as a generator sees it.

    Attributes
    ----------
    energy : GraspEnergy
    placements, bounds
        Same as in `SequenceObjective`.
    ends : (2, 4, 4)
        Start and goal.
    feasible : (2, G) bool
        Exact feasibility at both.
    table_rule : TableRule
        Same as in `SequenceObjective`; the generator with learned ends does without.
    """

    energy: GraspEnergy
    placements: FloatArray
    bounds: FloatArray
    ends: FloatArray
    feasible: BoolArray
    table_rule: TableRule

    @staticmethod
    def between(problem: RegraspProblem, energy: GraspEnergy, ends: FloatArray) -> OneStepTask:
        """Return the task of `problem` between the two poses `ends` (2, 4, 4) with `energy` for its grasps."""
        feasible = np.array([problem.feasible_grasps(T) for T in ends])
        bounds = problem.workcell.bounds.array
        return OneStepTask(energy, problem.placement_poses, bounds, ends, feasible, problem.table_rule)

    @property
    def possible(self) -> bool:
        """Whether some grasp is feasible at each end."""
        return bool(self.feasible.any(axis=1).all())

    def objective(self, generator: Generator, options: CostOptions) -> SequenceObjective:
        """Return the cost that `generator` minimises."""
        start, goal = self._end_energies(generator.ends)
        known = None if generator.ends == "learned" else self.table_rule
        return SequenceObjective(self.energy, self.placements, start, goal, self.bounds, options, known)

    def poses(self, placements: IntArray, xi: FloatArray) -> FloatArray:
        """Return object poses (B, 4, 4) of placement numbers (B,) and planar parameters (B, 3) (Eq. 6)."""
        return planar_transform(xi) @ self.placements[placements]

    def _end_energies(self, ends: Literal["exact", "learned"]) -> FloatArray:
        if ends == "learned":
            return self.energy(self.ends)
        if self.energy.model.bounded:
            return exact_energy(self.feasible)
        return np.where(self.feasible, self.energy(self.ends), BLOCKED)


def generate(
    task: OneStepTask,
    generator: Generator,
    options: CostOptions,
    per_placement: int,
    rng: np.random.Generator,
    lattice: PoseLattice | None = None,
) -> Candidates:
    """Return ``per_placement`` intermediate poses for each placement, the cheapest first.

    Parameters
    ----------
    lattice : PoseLattice, optional
        Of the task's energy; it is made if it is needed and not given.
    """
    objective = task.objective(generator, options)
    if generator.starts == "random":
        starts = _random_starts(objective, per_placement, rng)
    else:
        if lattice is None:
            lattice = PoseLattice.build(task.energy, task.placements, task.bounds, rule=task.table_rule)
        starts = _lattice_starts(lattice, objective, per_placement)
    refined = generator.refiner.refine(objective, starts, rng).candidates
    return refined.best(len(refined))


def _random_starts(objective: SequenceObjective, per_placement: int, rng: np.random.Generator) -> Candidates:
    count = len(objective.placements) * per_placement
    low, high = objective.bounds
    xi = np.column_stack([rng.uniform(low, high, (count, 2)), rng.uniform(0, 2 * np.pi, count)])[:, None]
    return _candidates(objective, np.repeat(np.arange(len(objective.placements)), per_placement)[:, None], xi)


def _lattice_starts(lattice: PoseLattice, objective: SequenceObjective, per_placement: int) -> Candidates:
    alpha = objective.options.alpha
    P = np.exp(-lattice.energies / alpha)
    masses = [P @ np.exp(-end / alpha).astype(np.float32) for end in (objective.start_energy, objective.goal_energy)]
    promise = shared_cost(masses[0]) + shared_cost(masses[1])
    order = np.argsort(promise, kind="stable")
    parts = [order[lattice.placements[order] == s][:per_placement] for s in range(len(objective.placements))]
    chosen = np.concatenate(parts)
    return _candidates(objective, lattice.placements[chosen][:, None], lattice.xi[chosen][:, None])


def _candidates(objective: SequenceObjective, placements: IntArray, xi: FloatArray) -> Candidates:
    return Candidates(placements, xi, objective.cost(placements, xi))


def verdicts(checker: FeasibilityChecker, poses: FloatArray, feasible: BoolArray) -> BoolArray:
    """Return which `poses` (B, 4, 4) share, exactly, a grasp with each of two ends of `feasible` (2, G) grasps."""
    ids = np.flatnonzero(feasible.any(axis=0))
    found = np.zeros(len(poses), dtype=bool)
    for b, T in enumerate(poses):
        here = checker.feasible(T, ids)
        found[b] = bool((feasible[:, ids] & here).any(axis=1).all())
    return found


def distinct(placements: IntArray, xi: FloatArray) -> int:
    """Return how many different poses there are among placements (B,) and planar parameters (B, 3)."""
    return len(np.unique(np.column_stack([placements, np.round(xi / DISTINCT)]), axis=0))
