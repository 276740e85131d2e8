"""One-step generation: many intermediate poses for one start and goal, ranked by cost, and their exact verdict.

As in the paper, every stable placement gets the same number of start points. `GENERATORS` differ in where these come
from, how they are refined and what is known of the ends.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from regrasp_opt.connectivity import BLOCKED, CostOptions, SequenceObjective, exact_energy
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, planar_transform
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.solvers import Candidates, LangevinRefiner, LatticeRefiner, PoseLattice, Refiner
from regrasp_opt.solvers.lattice import shared_cost

DISTINCT = np.array([0.005, 0.005, np.radians(5.0)])
"""Poses of one placement that fall into the same cell of this size [m, m, rad] count as the same."""

NO_GRASP = "no grasp of this set is feasible at one of the ends"
"""Why a pair is skipped."""


@dataclass(frozen=True)
class Generator:
    """How intermediate poses are generated: from the most promising lattice poses of each placement, or random ones.

    The energies at both ends are those of the exact checks that any planner makes there, or those of the model.
    """

    refiner: Refiner
    starts: Literal["lattice", "random"]
    ends: Literal["exact", "learned"]


GENERATORS = {
    "lattice": Generator(LatticeRefiner(), "lattice", "exact"),
    "langevin": Generator(LangevinRefiner(), "random", "exact"),
    "paper": Generator(LangevinRefiner(keep_best=False), "random", "learned"),
}
"""Ours; ours with the paper's optimiser; the paper's optimiser and ends."""


@dataclass(frozen=True, eq=False)
class OneStepTask:
    """One start-goal pair `ends` (2, 4, 4) as a generator sees it; `energy` is not always the problem's own."""

    problem: RegraspProblem
    energy: GraspEnergy
    ends: FloatArray

    @cached_property
    def feasible(self) -> BoolArray:
        """Exact feasibility (2, G) of all grasps at both ends."""
        return np.array([self.problem.feasible_grasps(T) for T in self.ends])

    @cached_property
    def lattice(self) -> PoseLattice:
        """The pose lattice of the task's energy."""
        problem = self.problem
        if self.energy is problem.energy:
            return problem.lattice
        return PoseLattice.build(self.energy, problem.rests.planar, problem.table_rule)

    @property
    def possible(self) -> bool:
        """Whether some grasp is feasible at each end."""
        return bool(self.feasible.any(axis=1).all())

    def objective(self, generator: Generator, options: CostOptions) -> SequenceObjective:
        """Return the cost that `generator` minimises; the one with learned ends does without the table rule."""
        problem = self.problem
        learned = generator.ends == "learned"
        start, goal = self.energy(self.ends) if learned else self._exact_ends()
        known = None if learned else problem.table_rule
        return SequenceObjective(self.energy, problem.rests.planar, start, goal, options, known)

    def verdicts(self, placements: IntArray, xi: FloatArray) -> BoolArray:
        """Return which poses, `placements` (B,) and `xi` (B, 3), share, exactly, a grasp with each of the ends."""
        ids = np.flatnonzero(self.feasible.any(axis=0))
        found = np.zeros(len(xi), dtype=bool)
        for b, T in enumerate(planar_transform(xi) @ self.problem.placement_poses[placements]):
            here = self.problem.checker.feasible(T, ids)
            found[b] = bool((self.feasible[:, ids] & here).any(axis=1).all())
        return found

    def _exact_ends(self) -> FloatArray:
        if self.energy.model.bounded:
            return exact_energy(self.feasible)
        return np.where(self.feasible, self.energy(self.ends), BLOCKED)


def generate(
    task: OneStepTask, generator: Generator, options: CostOptions, per_placement: int, rng: np.random.Generator
) -> Candidates:
    """Return ``per_placement`` intermediate poses for each placement, the cheapest first."""
    objective = task.objective(generator, options)
    if generator.starts == "random":
        placements = np.repeat(np.arange(len(objective.placements)), per_placement)
        low, high = objective.bounds
        positions = rng.uniform(low, high, (len(placements), 2))
        xi = np.column_stack([positions, rng.uniform(0, 2 * np.pi, len(placements))])
    else:
        chosen = _promising(task.lattice, objective, per_placement)
        placements, xi = task.lattice.placements[chosen], task.lattice.xi[chosen]
    starts = Candidates(placements[:, None], xi[:, None], objective.cost(placements[:, None], xi[:, None]))
    refined = generator.refiner.refine(objective, starts, rng).candidates
    return refined.best(len(refined))


def _promising(lattice: PoseLattice, objective: SequenceObjective, per_placement: int) -> IntArray:
    alpha = objective.options.alpha
    P = np.exp(-lattice.energies / alpha)
    masses = [P @ np.exp(-end / alpha).astype(np.float32) for end in (objective.start_energy, objective.goal_energy)]
    order = np.argsort(shared_cost(masses[0]) + shared_cost(masses[1]), kind="stable")
    return np.concatenate(
        [order[lattice.placements[order] == s][:per_placement] for s in range(len(objective.placements))]
    )


def distinct(placements: IntArray, xi: FloatArray) -> int:
    """Return how many different poses there are among placements (B,) and planar parameters (B, 3)."""
    return len(np.unique(np.column_stack([placements, np.round(xi / DISTINCT)]), axis=0))
