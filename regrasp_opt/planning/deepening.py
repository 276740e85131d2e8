"""Iterative deepening: for N = 0, 1, ... start points are refined, ranked by ``J_seq`` and verified in that order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from regrasp_opt.connectivity import CostOptions, SequenceObjective, exact_energy, pair_score
from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.planning.alternatives import Alternatives
from regrasp_opt.planning.clock import Clock
from regrasp_opt.planning.ends import known_energy
from regrasp_opt.planning.plan import RegraspPlan
from regrasp_opt.planning.plan_data import Status
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.recipes import Recipe
from regrasp_opt.planning.verification import LazyTransitions, PoseFeasibility, verify_sequence
from regrasp_opt.solvers import Candidates, PoseLattice, lattice_starts

PORTION = 50
"""Lattice chains that are verified before the next ones are chosen."""
SAME = 1e-3
"""How much planar parameters of the same plan differ at most [m, rad]."""


class Search:
    """Iterative deepening for one start and goal."""

    def __init__(
        self,
        problem: RegraspProblem,
        recipe: Recipe,
        ends: list[PoseFeasibility],
        options: CostOptions,
        seed: int,
        clock: Clock,
        accept: Callable[[RegraspPlan], bool] | None = None,
    ) -> None:
        self.problem, self.recipe, self.ends, self.clock, self.seed = problem, recipe, ends, clock, seed
        self.options, self.accept = options, accept
        self.stats: list[dict[str, Any]] = []
        self.cheapest: Candidates | None = None
        self.known: dict[bytes, PoseFeasibility] = {}
        self.refused: list[RegraspPlan] = []

    def run(self, counts: range) -> RegraspPlan:
        """Return the plan with the fewest intermediate poses, a number in `counts`."""
        start, goal = self.ends
        if 0 in counts and (start.all() & goal.all()).any():
            goal = goal.beside(start)
            cost = float(pair_score(exact_energy(start.all()), exact_energy(goal.all()), self.options.alpha))
            plan = self.result(Status.SOLVED, cost=cost, chain=[start, goal])
            if self._accepted(plan):
                return plan
        return self._deeper(range(max(1, counts.start), counts.stop))

    def _deeper(self, counts: range) -> RegraspPlan:
        for num_regrasps in counts:
            if isinstance(self.accept, Alternatives) and self.accept.deep_enough(num_regrasps):
                break
            found = self._at_depth(num_regrasps)
            if found is not None:
                return found
            if self.clock.over:
                return self._best_so_far()
        return self.result(Status.NOT_FOUND)

    def _at_depth(self, num_regrasps: int) -> RegraspPlan | None:
        """Return the plan with `num_regrasps` intermediate poses, or None."""
        objective, recipe = self.objective, self.recipe
        rng = np.random.default_rng([self.seed, num_regrasps])
        with self.clock.timed("starts"):
            chains = recipe.start_points(lambda: self.lattice, objective, num_regrasps, rng)
        if not len(chains):
            self.stats.append({"num_regrasps": num_regrasps, "refiner": recipe.refiner.name, "starts": 0})
            return None
        first = 0
        for size in recipe.batches:
            starts = chains.take(slice(first, first + size))
            first += size
            if not len(starts):
                break
            with self.clock.timed("refine"):
                refined = recipe.refiner.refine(objective, starts, rng)
            told = {"num_regrasps": num_regrasps, "refiner": recipe.refiner.name, "stages": recipe.stages}
            entry = {**told, **refined.stats}
            self.stats.append(entry)
            ranked = refined.candidates.best(recipe.verified)
            if len(ranked) and (self.cheapest is None or ranked.cost[0] < self.cheapest.cost[0]):
                self.cheapest = ranked.take(slice(0, 1))
            if recipe.check == "threshold":
                return self._by_threshold(objective, ranked, entry)
            found = self._first_verified(objective, ranked, entry)
            if found is not None or self.clock.over:
                return found
        return self._from_lattice(objective, num_regrasps) if recipe.fallback else None

    def _from_lattice(self, objective: SequenceObjective, num_regrasps: int) -> RegraspPlan | None:
        """Return the plan of the first lattice chain that is verified as it is, or None.

        What the checks of some find out is taken into account when the next ones are chosen.
        """
        entry: dict[str, Any] = {"num_regrasps": num_regrasps, "refiner": "lattice", "chains": 0}
        self.stats.append(entry)
        if self.lattice.source is None:  # other searches use it, too
            self.lattice = self.lattice.under(None)
        tried: set[bytes] = set()
        while (left := self.recipe.fallback - len(tried)) > 0:
            size = min(PORTION, left)
            with self.clock.timed("starts"):
                rng = np.random.default_rng([self.seed, num_regrasps])
                chains = lattice_starts(self.lattice, objective, num_regrasps, len(tried) + size, rng)
                keys = [key.tobytes() for key in np.dstack([chains.placements, chains.xi])]
                new = [index for index, key in enumerate(keys) if key not in tried][:size]
                chains, keys = chains.take(new), [keys[index] for index in new]
            found = self._first_verified(objective, chains, entry)
            if "accepted" in entry:
                entry["accepted"] += len(tried)
            if found is not None or self.clock.over or not len(chains):
                return found
            tried.update(keys)
            entry["chains"] = len(tried)
            self._learn(chains)
        return None

    def _learn(self, chains: Candidates) -> None:
        """Block in the lattice what is known by now to be infeasible at the poses of `chains`."""
        poses = {(p, *xi): (p, xi) for p, xi in zip(chains.placements.ravel(), chains.xi.reshape(-1, 3), strict=True)}
        numbers = np.array([self.lattice.number(int(p), xi) for p, xi in poses.values()])
        T = self.problem.rests.planar.at(self.lattice.placements[numbers], self.lattice.xi[numbers])
        known = [self._knowledge(each) for each in T]
        self.lattice.block(numbers, np.array([~pose.possible() | pose.object_collides for pose in known]))

    def _first_verified(
        self, objective: SequenceObjective, candidates: Candidates, entry: dict[str, Any]
    ) -> RegraspPlan | None:
        """Return the plan of the first candidate that is verified, or None; record its rank in `entry`."""
        for index in range(len(candidates)):
            if self.clock.over:
                return None
            if self._was_refused(candidates, index):
                continue
            with self.clock.timed("verify"):
                chain = self._verify(objective, candidates, index)
            if chain is None:
                continue
            plan = self._plan(objective, candidates, index, chain)
            if self._accepted(plan):
                entry["accepted"] = index
                picked = candidates.take(slice(index, index + 1))
                entry["threshold_passed"] = int(self._below_threshold(objective, picked).sum())
                return plan
        return None

    def _accepted(self, plan: RegraspPlan) -> bool:
        if self.accept is None:
            return True
        with self.clock.timed("accept"):
            accepted = self.accept(plan)
        if not accepted:
            self.refused.append(plan)
        return accepted

    def _was_refused(self, candidates: Candidates, index: int) -> bool:
        """Return whether the same poses were shown before, since several starts may be refined to one minimum.

        Where alternatives are looked for, the same placements may have been shown often enough.
        """
        placements, xi = candidates.placements[index], candidates.xi[index]
        if isinstance(self.accept, Alternatives) and self.accept.tried(placements):
            return True
        return any(
            np.array_equal(plan.placements, placements) and np.allclose(plan.xi, xi, atol=SAME) for plan in self.refused
        )

    def _by_threshold(
        self, objective: SequenceObjective, candidates: Candidates, entry: dict[str, Any]
    ) -> RegraspPlan | None:
        """Return what becomes of the cheapest candidate all of whose pairs pass `h` (Alg. 2); None if none passes."""
        passing = np.flatnonzero(self._below_threshold(objective, candidates))
        entry["threshold_passed"] = len(passing)
        if len(passing) == 0:
            return None
        index = int(passing[0])
        with self.clock.timed("verify"):
            chain = self._verify(objective, candidates, index)
        if chain is None:
            return self.result(Status.NOT_FOUND)
        plan = self._plan(objective, candidates, index, chain)
        if not self._accepted(plan):
            return self.result(Status.NOT_FOUND)
        entry["accepted"] = index
        return plan

    def _below_threshold(self, objective: SequenceObjective, candidates: Candidates) -> BoolArray:
        """Return for each candidate (B,) whether all its pairs have a grasp whose summed energy is at most `h`."""
        energies = objective.chain(objective.energies(candidates.placements, candidates.xi))
        summed = energies[:, :-1] + energies[:, 1:]
        return (summed <= self.problem.energy.model.threshold).any(axis=2).all(axis=1)

    def _verify(self, objective: SequenceObjective, candidates: Candidates, index: int) -> list[PoseFeasibility] | None:
        xi = candidates.xi[index]
        if not objective.placements.allow(candidates.placements[index], xi):  # a refiner is not believed
            return None
        poses = objective.poses(candidates.placements[index], xi)
        middle = [self._knowledge(T) for T in poses]
        if any(knowledge.object_collides for knowledge in middle):
            return None
        energies = objective.chain(objective.energies(candidates.placements[index], xi)[None])[0]
        chain = [self.ends[0], *middle, self.ends[1]]
        return [*chain[:-1], chain[-1].beside(chain[-2])] if verify_sequence(chain, energies) else None

    def _knowledge(self, T: FloatArray) -> PoseFeasibility:
        """Return what is known about pose `T`; chains of lattice poses have many poses in common."""
        return self.known.setdefault(T.tobytes(), PoseFeasibility(self.problem.checker, T))

    def _plan(
        self, objective: SequenceObjective, candidates: Candidates, index: int, chain: list[PoseFeasibility]
    ) -> RegraspPlan:
        picked = candidates.take(slice(index, index + 1))
        if chain[-1] is not self.ends[-1]:  # one of several equivalent goals
            objective = replace(objective, goal_energy=self._end_energy(chain[-1]))
        cost = float(objective.cost(picked.placements, picked.xi)[0])
        return self.result(Status.SOLVED, cost=cost, chain=chain, placements=picked.placements[0], xi=picked.xi[0])

    def _best_so_far(self) -> RegraspPlan:
        if self.cheapest is None:
            return self.result(Status.TIME_LIMIT)
        best = self.cheapest
        poses = self.objective.poses(best.placements[0], best.xi[0])
        chain = [self.ends[0], *(PoseFeasibility(self.problem.checker, T) for T in poses), self.ends[1]]
        return self.result(
            Status.TIME_LIMIT, cost=float(best.cost[0]), chain=chain, placements=best.placements[0], xi=best.xi[0]
        )

    @cached_property
    def lattice(self) -> PoseLattice:
        """The lattice of this search."""
        return self.problem.lattice

    @property
    def objective(self) -> SequenceObjective:
        """What is minimised between the two ends."""
        start, goal = (self._end_energy(end) for end in self.ends)
        known = self.problem.objective(start, goal, self.options)
        return known if self.recipe.knowledge == "exact" else replace(known, rule=None)

    def _end_energy(self, end: PoseFeasibility) -> FloatArray:
        """Return the energies (G,) at a fixed end, exact ones if they may be used."""
        energy, learned = self.problem.energy, self.recipe.knowledge == "learned"
        each = [energy(pose.T) if learned else known_energy(energy, pose.T, pose.all()) for pose in end.members]
        return np.min(each, axis=0) if len(each) > 1 else each[0]

    def result(
        self,
        status: Status,
        *,
        cost: float = float("nan"),
        chain: list[PoseFeasibility] | None = None,
        placements: Any = (),
        xi: Any = (),
    ) -> RegraspPlan:
        """Return the plan; the transitions of a solved one are enumerated when they are looked at."""
        chain = [pose.members[0] for pose in chain or self.ends]
        solved = status is Status.SOLVED
        poses: FloatArray = np.array([knowledge.T for knowledge in chain])
        return RegraspPlan(
            status=status,
            poses=poses,
            placements=np.array(placements, dtype=np.int64),
            xi=np.array(xi, dtype=np.float64).reshape(-1, 3),
            transitions=LazyTransitions(self.problem.checker, chain) if solved else (),
            cost=cost,
            timings=self.clock.report(),
            refiner_stats=self.stats,
            seed=self.seed,
            problem=self.problem.original,
            given=(chain[0].given, chain[-1].given),
        )
