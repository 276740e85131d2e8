"""Free grasps: where the sampled set holds no plan, grasps move over the object until there is one.

For chains of poses that the energy finds promising, the poses and the grasp of each transition are optimised together,

    minimise   sum_i E(T_i, g_i) + E(T_{i+1}, g_i)          over xi and small steps of the grasps g_i,

with the energy as a function of the grasp's own pose. After each step a grasp is settled on the object by the rules of
the sampler (`GraspProjector`), and the next step starts there. What has settled joins the set, so chains grow from it
in the next round. The exact checker verifies each chain, and the planner searches the grown set from time to time.
"""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.connectivity import exact_energy
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.motion.free_grasps.pool import GraspPool
from regrasp_opt.motion.free_grasps.program import ChainSolve, FreeGraspProgram, displaced
from regrasp_opt.planning import RegraspPlan, RegraspProblem, Status, Transition, solve_sequence
from regrasp_opt.planning.verification import PoseFeasibility, enumerate_transition
from regrasp_opt.solvers.base import wrap_yaw
from regrasp_opt.threads import one_blas_thread

POSES = 1000
"""Random intermediate poses among which chains are chosen in each round."""

NOISE = 1.0
"""Scale of the Gumbel noise on the cost of chains [energy]: the same chain is not tried again and again."""

GOOD = 0.5
"""Objective at which a chain is not optimised further."""

UNVERIFIED = 1.0
"""Least energy of a grasp at an end where the exact check has refused it."""


@dataclass(frozen=True)
class FreeGraspOptions:
    """How much is tried.

    Attributes
    ----------
    rounds : int
        Rounds of chains.
    chains : int
        Chains of each round.
    steps : int
        Steps of the grasps of each chain.
    explored : int
        Random grasps of each round, moved from known ones and from anywhere on the surface; where few grasps work at
        an end, twice as many more with low energy there.
    searches : tuple of int
        Rounds after which the planner searches the grown set.
    """

    rounds: int = 12
    chains: int = 10
    steps: int = 3
    explored: int = 200
    searches: tuple[int, ...] = (4, 12)

    def __post_init__(self) -> None:
        for name in ("rounds", "chains", "steps", "explored"):
            if getattr(self, name) < 1:
                raise OptionError(f"{name} is {getattr(self, name)}; give at least 1")


def solve_with_free_grasps(
    problem: RegraspProblem,
    start: ArrayLike,
    goal: ArrayLike,
    *,
    max_regrasps: int = 2,
    seed: int = 0,
    options: FreeGraspOptions | None = None,
) -> RegraspPlan:
    """Plan with the grasps of `problem`, and where these allow no plan, with grasps moved on the object's surface.

    Parameters
    ----------
    problem : RegraspProblem
    start, goal : (4, 4) array_like
        T_world_object; the object rests on the table at both.
    max_regrasps : int
        Largest number N of intermediate poses. Grasps are optimised for N up to 1; longer plans are looked for in the
        set that results.
    seed : int
        The same seed gives the same plan on the same machine.
    options : FreeGraspOptions, optional

    Returns
    -------
    RegraspPlan
        A solved plan whose problem holds the grasps of `problem`, in their order, and behind them the moved ones that
        the plan uses; or the plan of `solve_sequence`, whose status says why there is none.

    Raises
    ------
    PoseError
        If `start` or `goal` cannot be a pose of the object in this workcell.
    OptionError
        If `max_regrasps` is out of range.
    ModelError
        If a file of the energy is broken, or none can be trained.
    """
    sampled = solve_sequence(problem, start, goal, max_regrasps=max_regrasps, seed=seed)
    if sampled.solved:
        return sampled
    begun = time.perf_counter()
    with one_blas_thread():
        search = _Search(problem, sampled.poses[[0, -1]], max_regrasps, seed, options or FreeGraspOptions())
        plan = search.run() or sampled
    timings = {**sampled.timings, "free grasps": time.perf_counter() - begun}
    return replace(plan, timings=timings, given=sampled.given)


class _Chain(NamedTuple):
    """Numbers of placements (N,), planar parameters (N, 3), and numbers of the grasps (N+1,) in the grown set."""

    placements: IntArray
    xi: FloatArray
    grasp_ids: IntArray


class _Search:
    """One search between two ends."""

    def __init__(
        self, problem: RegraspProblem, ends: FloatArray, max_regrasps: int, seed: int, options: FreeGraspOptions
    ) -> None:
        self.problem, self.ends, self.max_regrasps, self.seed, self.options = problem, ends, max_regrasps, seed, options
        self.rng = np.random.default_rng([seed, 17])
        self.pool = GraspPool(problem, ends, self.rng)
        self.model = problem.energy.model
        sizes = range(min(max_regrasps, 1) + 1)
        self.programs = [FreeGraspProgram(self.model, size, problem.grasps.kind) for size in sizes]

    def run(self) -> RegraspPlan | None:
        """Return a verified plan, or None."""
        for number in range(1, self.options.rounds + 1):
            self.pool.explore(self.options.explored)
            chains = [self._optimised(chain) for chain in self._chains()]
            grown = self.pool.problem()
            for chain in chains:
                if self._holds(grown, chain):
                    return self._plan_of(chain)
            if number in self.options.searches:
                plan = solve_sequence(grown, *self.ends, max_regrasps=self.max_regrasps, seed=self.seed)
                if plan.solved:
                    return self._trimmed(plan)
        return None

    def _chains(self) -> list[_Chain]:
        """Return promising chains, a quarter of them without an intermediate pose, no two with the same grasps."""
        problem, energy = self.problem, GraspEnergy(self.model, self.pool.grasps())
        ends = np.where(self.pool.verified(), 0.0, np.maximum(energy(self.ends), UNVERIFIED))
        direct = np.argsort(ends.sum(axis=0) + NOISE * self.rng.gumbel(size=len(energy)))
        nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        count = self.options.chains if len(self.programs) == 1 else max(1, self.options.chains // 4)
        chains = [_Chain(*nothing, direct[k : k + 1]) for k in range(min(count, len(direct)))]
        if len(self.programs) == 1:
            return chains
        numbers, xi = problem.rests.planar.draw(POSES, self.rng)
        middle = energy(problem.rests.planar.at(numbers, xi), np.float32)
        ids = np.stack([(middle + end).argmin(axis=1) for end in ends], axis=1)
        cost = sum((middle + end).min(axis=1) for end in ends) + NOISE * self.rng.gumbel(size=POSES)
        seen: set[tuple[int, ...]] = set()
        for k in np.argsort(cost):
            pair = tuple(ids[k].tolist())
            if pair not in seen and len(chains) < self.options.chains:
                seen.add(pair)
                chains.append(_Chain(numbers[[k]], xi[[k]], ids[k]))
        return chains

    def _optimised(self, chain: _Chain) -> _Chain:
        """Return the chain with its poses and grasps moved; the grasps have settled and joined the set."""
        size = len(chain.xi)
        placements, ids = self.problem.rests.planar[chain.placements], chain.grasp_ids.copy()
        solve = ChainSolve(chain.xi, 0.3 * self.rng.normal(size=(size + 1, 6)), np.inf)
        for _ in range(self.options.steps):
            grasps = self.pool.grasps(ids)
            solve = self.programs[size].solve(placements, self.ends, grasps.T_object_tcp, grasps.width, solve)
            moved = [self._settled(int(k), d) for k, d in zip(ids, solve.steps, strict=True)]
            if moved == ids.tolist():
                break
            ids = np.array(moved, dtype=np.int64)
            if solve.cost < GOOD:
                break
            solve = solve._replace(steps=np.zeros_like(solve.steps))
        return _Chain(chain.placements, solve.xi, ids)

    def _settled(self, grasp_id: int, step: FloatArray) -> int:
        """Return the number of the grasp in which a step settles, a shorter one if need be, else of the old grasp."""
        for share in (1.0, 0.5, 0.25):
            T = displaced(self.pool.T[grasp_id], share * step)
            grasps = self.pool.settled(T[None])
            if len(grasps):
                return self.pool.add(grasps.T_object_tcp[0], float(grasps.width[0]))
        return grasp_id

    def _poses(self, chain: _Chain) -> FloatArray:
        middle = self.problem.rests.planar.at(chain.placements, chain.xi)
        return np.concatenate([self.ends[:1], middle, self.ends[1:]])

    def _holds(self, grown: RegraspProblem, chain: _Chain) -> bool:
        """Return whether the exact checker verifies a chain with its own grasps."""
        poses, checker = self._poses(chain), grown.checker
        if any(checker.object_collides(T) for T in poses[1:-1]):
            return False
        pairs = zip(itertools.pairwise(poses), chain.grasp_ids, strict=True)
        return all(checker.feasible(T, np.array([grasp_id]))[0] for ends, grasp_id in pairs for T in ends)

    def _plan_of(self, chain: _Chain) -> RegraspPlan:
        """Return the plan of a chain that holds, with the sampled grasps and those of the chain."""
        sampled = self.pool.sampled
        moved = [k for k in dict.fromkeys(chain.grasp_ids.tolist()) if k >= sampled]
        problem = replace(self.problem, grasps=self.pool.grasps([*range(sampled), *moved]))
        poses = self._poses(chain)
        known = [PoseFeasibility(problem.checker, T) for T in poses]
        transitions = tuple(enumerate_transition(problem.checker, a, b) for a, b in itertools.pairwise(known))
        return self._plan(problem, poses, chain.placements, wrap_yaw(chain.xi), transitions)

    def _trimmed(self, plan: RegraspPlan) -> RegraspPlan:
        """Return a plan on the grown set without the moved grasps that it does not use."""
        used = np.unique(np.concatenate([t.grasp_ids for t in plan.transitions]))
        keep = np.append(np.arange(self.pool.sampled), used[used >= self.pool.sampled])
        problem = replace(self.problem, grasps=self.pool.grasps(keep))
        transitions = tuple(replace(t, grasp_ids=np.searchsorted(keep, t.grasp_ids)) for t in plan.transitions)
        return self._plan(problem, plan.poses, plan.placements, plan.xi, transitions)

    def _plan(
        self,
        problem: RegraspProblem,
        poses: FloatArray,
        placements: IntArray,
        xi: FloatArray,
        transitions: tuple[Transition, ...],
    ) -> RegraspPlan:
        start, goal = (exact_energy(problem.checker.feasible(poses[end])) for end in (0, -1))
        cost = float(problem.objective(start, goal).cost(placements[None], xi[None])[0])
        stats = [{"refiner": "free grasps", "num_regrasps": len(xi), "grown": len(self.pool.T) - self.pool.sampled}]
        return RegraspPlan(Status.SOLVED, poses, placements, xi, transitions, cost, {}, stats, self.seed, problem)
