"""Every planner that is compared, behind one call: an instance in, one row out.

Those of the package are recipes of `solve_sequence`. Two baselines come beside them: the discrete regrasp graph, which
knows every grasp at every grid pose, and random poses that are checked as they come. All plans are verified by the same
checker, and a row holds the same columns whoever made it.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from weakref import WeakKeyDictionary

import numpy as np
from scipy.sparse import block_array, csr_array
from scipy.sparse.csgraph import dijkstra

from regrasp_opt.benchmarks.harness.instances import Instance
from regrasp_opt.benchmarks.harness.oracle import Resolution, build_oracle
from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.conventions import BoolArray, IntArray
from regrasp_opt.planning import Recipe, RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.recipes import RECIPES
from regrasp_opt.solvers import LangevinRefiner, LatticeRefiner, NlpRefiner, ProgramOptions

WARM_UP = 5.0
"""Seconds after which the uncounted first plan is given up."""
MAX_REGRASPS = 5
"""``N_max`` of the paper."""

PLANNERS: dict[str, Callable[[], Recipe]] = {
    "ipopt from lattice": RECIPES["ipopt"],
    "ipopt L-BFGS from lattice": lambda: Recipe(NlpRefiner(ProgramOptions(hessian="limited-memory"))),
    "sqpmethod from lattice": lambda: Recipe(NlpRefiner(ProgramOptions(plugin="sqpmethod"))),
    "ipopt from Langevin": RECIPES["langevin-ipopt"],
    "ipopt L-BFGS from Langevin": lambda: Recipe(
        NlpRefiner(ProgramOptions(hessian="limited-memory")), starts="langevin", fallback=0
    ),
    "Langevin from lattice": lambda: Recipe(LangevinRefiner(anneal=True)),
    "Langevin": RECIPES["langevin"],
    "lattice": RECIPES["lattice"],
    "random poses": lambda: Recipe(LatticeRefiner(), starts="random", batches=(1000,), verified=1000, fallback=0),
}
"""Recipes by the name under which they are reported."""


def plan_row(
    problem: RegraspProblem, instance: Instance, recipe: str | Recipe, seed: int, time_limit: float | None
) -> list[Row]:
    """Plan `instance` by a recipe, or a name in `PLANNERS`, and return the one row about it.

    It is planned a first time without counting it, so that the time is that of a planner in use: lattice and solver
    objects are made once a problem, not once a plan.
    """
    problem = resident(problem)
    used = PLANNERS[recipe]() if isinstance(recipe, str) else recipe
    warm_up(problem, instance, used)
    plan = solve_sequence(
        problem, instance.start, instance.goal, used, max_regrasps=MAX_REGRASPS, seed=seed, time_limit=time_limit
    )
    return [{**outcome(plan, instance), **effort(plan)}]


_warmed: WeakKeyDictionary[RegraspProblem, set[Recipe]] = WeakKeyDictionary()


def warm_up(problem: RegraspProblem, instance: Instance, recipe: Recipe) -> None:
    """Build what `recipe` keeps for `problem`: the lattice, and solvers for one and for two regrasps."""
    done = _warmed.setdefault(problem, set())
    if recipe not in done:
        solve_sequence(problem, instance.start, instance.goal, recipe, max_regrasps=2, time_limit=WARM_UP)
        done.add(recipe)


def outcome(plan: RegraspPlan, instance: Instance) -> Row:
    """Return what became of `instance`: status, N against the oracle's, cost, bottleneck and clearance."""
    solved = plan.solved
    return {
        "tier": instance.tier,
        "minimum": instance.minimum,
        "status": plan.status.name.lower(),
        "solved": solved,
        "num_regrasps": plan.num_regrasps if solved else None,
        "cost": plan.cost if solved else None,
        "bottleneck": min((len(t.grasp_ids) for t in plan.transitions), default=None),
        "clearance_mm": min((1e3 * float(t.clearance.max()) for t in plan.transitions), default=None),
    }


def solvable(row: Row) -> bool:
    """Return whether the oracle's grid holds a plan."""
    return row.get("minimum") is not None


def solved_by_both(row: Row) -> bool:
    """Return whether the oracle's grid holds a plan, and the planner found one."""
    return solvable(row) and row["solved"]


def effort(plan: RegraspPlan) -> Row:
    """Return what the plan took: seconds to the first verified plan, iterations, solves, and how many converged."""
    stats = plan.refiner_stats
    first = plan.timings["total"] - plan.timings.get("transitions", 0.0)
    return {
        "seconds": round(plan.timings["total"], 4),
        "first_verified": round(first, 4) if plan.solved else None,
        "iterations": int(sum(np.sum(entry.get("iterations", 0)) for entry in stats)),
        "evaluations": sum(int(entry.get("evaluations", 0)) for entry in stats),
        "solves": sum(int(entry.get("solves", 0)) for entry in stats),
        "converged": sum(int(entry.get("converged", 0)) for entry in stats),
        "threshold_passed": any(entry.get("threshold_passed", 0) > 0 for entry in stats),
    }


def graph_row(
    problem: RegraspProblem, instance: Instance, whole: RegraspProblem, ids: IntArray, resolution: Resolution
) -> list[Row]:
    """Plan `instance` on the discrete regrasp graph and return the one row about it.

    `problem` has the grasps `ids` of `whole`, whose exact grid has been computed before. Nodes are the grid poses, the
    start and the goal; two are joined if they share a grasp. The path with the fewest poses is found by breadth-first
    search over (pose, grasp) incidences, so the quadratic number of edges is never formed. The seconds leave out the
    grid itself, which is reported apart.
    """
    problem = resident(problem)
    oracle = build_oracle(resident(whole), resolution, jobs=1).with_grasps(ids)
    began = time.perf_counter()
    start, goal = (problem.feasible_grasps(T) for T in (instance.start, instance.goal))
    path = fewest_poses(oracle.feasible, start, goal)
    seconds = time.perf_counter() - began
    row: Row = {
        "tier": instance.tier,
        "minimum": instance.minimum,
        "status": "not_found" if path is None else "solved",
        "solved": path is not None,
        "num_regrasps": None if path is None else len(path),
        "seconds": round(seconds, 4),
        "first_verified": None if path is None else round(seconds, 4),
        "before": oracle.seconds,
    }
    if path is not None:
        chain = [start, *oracle.feasible[path], goal]
        row["bottleneck"] = min(int((a & b).sum()) for a, b in itertools.pairwise(chain))
    return [row]


def fewest_poses(feasible: BoolArray, start: BoolArray, goal: BoolArray) -> IntArray | None:
    """Return the numbers (N,) of the grid poses of a shortest path on the regrasp graph, or None if there is none.

    Exact feasibility is `feasible` (L, G) at the grid poses, `start` and `goal` (G,) at the ends; the path is empty if
    these share a grasp.
    """
    if (start & goal).any():
        return np.zeros(0, dtype=np.int64)
    rows = np.vstack([feasible, start, goal])
    incidence = csr_array(rows.astype(np.float64))
    poses, grasps = incidence.shape
    nothing = csr_array((poses, poses)), csr_array((grasps, grasps))
    graph = block_array([[nothing[0], incidence], [incidence.T, nothing[1]]], format="csr")
    first, node = poses - 2, poses - 1
    _, before = dijkstra(graph, directed=False, indices=first, unweighted=True, return_predecessors=True)
    path: list[int] = []
    while node != first:
        node = int(before[node])
        if node < 0:
            return None
        path += [node] if node < first else []
    return np.array(path[::-1], dtype=np.int64)
