"""What our functions cost in somebody's own optimisation problem, against our own program for the same poses.

The same local search, from the same start with the same Ipopt options, is set up four times: as the planner solves it,
as `RegraspProblem.nlp`, as a CasADi `Opti` problem that calls ``J_seq``, and as the same with plainly built
expressions that CasADi differentiates itself. They are timed in turn in one process, so that their ratios hold on a
busy machine.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import median
from typing import Any

import casadi as ca
import numpy as np

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.experiment import run_experiment
from regrasp_opt.benchmarks.harness.instances import Instance, random_instances
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import planning_key
from regrasp_opt.connectivity import BLOCKED, SequenceObjective, exact_energy
from regrasp_opt.connectivity.casadi_chain import cost_of_scores, pair_score
from regrasp_opt.conventions import FloatArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.solvers import Candidates, NlpRefiner, ProgramOptions, lattice_starts
from regrasp_opt.solvers.options import plugin_options
from regrasp_opt.threads import one_blas_thread

TEXT = (
    "One local search by Ipopt from the best chain of lattice poses, set up in four ways: as the planner does it, as "
    "`RegraspProblem.nlp`, as an `Opti` problem of one's own with `J_seq` in it, and as an `Opti` problem that has "
    "the same cost as a plainly built expression, whose derivatives CasADi multiplies in its own loops. Same start, "
    "grasps, bounds and Ipopt options; building a solver is not counted. Times are medians of calls in turn within "
    "one process; a ratio is that of two medians."
)
PAIRS = {True: 1, False: 5}
"""Start-goal pairs an object, in quick and in full runs."""
REGRASPS = (1, 2, 3)
"""Numbers of intermediate poses."""
REPEATS = 9
WAYS = ("planner", "nlp", "opti", "plain")


def run_embedding(session: Session) -> Report:
    """Measure the time of one local search in each of the ways, one process at a time."""

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        pairs = random_instances(problem, session.rng(60), PAIRS[session.quick], name)
        items = [
            Item(
                f"{pair.name}/{regrasps}",
                content_hash(planning_key(problem), pair.start, pair.goal, REPEATS),
                embedding_rows,
                (replace(problem), pair, regrasps),
                {"object": name, "pair": number, "N": regrasps},
            )
            for number, pair in enumerate(pairs)
            for regrasps in REGRASPS
        ]
        return items, content_hash(*(T for pair in pairs for T in (pair.start, pair.goal)))

    return run_experiment(
        replace(session, jobs=1),
        "embedding",
        "Our functions in other programs",
        TEXT,
        work,
        lambda rows, names: [_table(rows)],
        settings={"repeats": REPEATS},
    )


def embedding_rows(problem: RegraspProblem, pair: Instance, num_regrasps: int) -> list[Row]:
    """Return one row with the median time [ms], iterations and final cost of each way.

    Raises
    ------
    OptionError
        If no lattice chain has a chance to hold.
    """
    ends = [exact_energy(problem.feasible_grasps(T)) for T in pair.ends]
    objective = problem.objective(ends[0], ends[1])
    with one_blas_thread():
        starts = lattice_starts(problem.lattice, objective, num_regrasps, 1, np.random.default_rng(0))
        if not len(starts):
            raise OptionError(f"no chain of {num_regrasps} lattice pose(s) has a chance; take another pair")
        ways = _ways(problem, objective, starts)
        outcomes = {name: way() for name, way in ways.items()}
        times: dict[str, list[float]] = {name: [] for name in ways}
        for _ in range(REPEATS):
            for name, way in ways.items():
                began = time.perf_counter()
                way()
                times[name].append(1e3 * (time.perf_counter() - began))
    row: Row = {}
    for name, (iterations, cost) in outcomes.items():
        row |= {f"{name}_ms": median(times[name]), f"{name}_iterations": iterations, f"{name}_cost": cost}
    return [row]


def _ways(
    problem: RegraspProblem, objective: SequenceObjective, starts: Candidates
) -> dict[str, Callable[[], tuple[int, float]]]:
    """Return the ways; each solves once and tells its iterations and cost."""
    numbers, xi = starts.placements[0], starts.xi[0]
    refiner, rng = NlpRefiner(), np.random.default_rng(0)
    ends = objective.start_energy, objective.goal_energy
    nlp = problem.nlp(*ends, placements=numbers.tolist(), guess=xi)
    solver, arguments = nlp.solver(), nlp.arguments
    plain = _plain_cost(problem, objective, starts)

    def by_planner() -> tuple[int, float]:
        refined = refiner.refine(objective, starts, rng)
        return refined.stats["iterations"][0], float(refined.candidates.cost[0])

    def by_nlp() -> tuple[int, float]:
        solution = solver.solve(**arguments)
        return solution.iterations, solution.f

    return {
        "planner": by_planner,
        "nlp": by_nlp,
        "opti": _opti(nlp.functions.J_seq, xi, objective.bounds),
        "plain": _opti(plain, xi, objective.bounds),
    }


def _opti(cost: Callable[[Any], Any], xi: FloatArray, bounds: FloatArray) -> Callable[[], tuple[int, float]]:
    """Return a search that somebody might write: minimise `cost` of (N, 3) within the workspace, from `xi` (N, 3)."""
    opti = ca.Opti()
    variable = opti.variable(*xi.shape)
    objective = cost(variable)
    opti.minimize(objective)
    for i in range(len(xi)):
        opti.subject_to(opti.bounded(bounds[0], variable[i, :2].T, bounds[1]))
    options = {"print_time": False, "detect_simple_bounds": True, "error_on_fail": False}
    opti.solver("ipopt", {**options, **plugin_options(ProgramOptions())})

    def solve() -> tuple[int, float]:
        opti.set_initial(variable, xi)
        found = opti.solve_limited()  # all ways stop at the same number of iterations
        return int(found.stats()["iter_count"]), float(found.value(objective))

    return solve


def _plain_cost(problem: RegraspProblem, objective: SequenceObjective, starts: Candidates) -> Callable[[Any], Any]:
    """Return ``J_seq`` of the grasps that `RegraspProblem.nlp` uses, as an expression without our derivatives."""
    numbers, xi = starts.placements[0], starts.xi[0]
    rule = problem.table_rule(numbers, xi)
    ids = objective.useful_grasps(len(xi))
    ids = ids[~rule[:, ids].all(axis=0)]
    expressions = CasadiEnergy(problem.energy.model, len(ids))
    layers = [expressions.layer(problem.energy.planar_layer(T, ids)) for T in problem.placement_poses[numbers]]
    known = [ca.DM(row[ids].astype(np.float64)) for row in rule]

    def cost(variable: Any) -> Any:
        learned = [expressions.planar_expression(layer, variable[i, :].T) for i, layer in enumerate(layers)]
        middle = [(1 - row) * energy + BLOCKED * row for row, energy in zip(known, learned, strict=True)]
        chain = [ca.DM(objective.start_energy[ids]), *middle, ca.DM(objective.goal_energy[ids])]
        scores = [pair_score(a, b, objective.options) for a, b in itertools.pairwise(chain)]
        return cost_of_scores(scores, objective.options.regularisation)

    return cost


def _table(rows: list[Row]) -> Table:
    groups = tables.grouped([row for row in rows if "nlp_ms" in row], "N")
    columns: dict[str, tables.Column] = {
        "searches": len,
        **{f"{way} [ms]": tables.middle(f"{way}_ms", 1) for way in WAYS},
    }
    for way, other in (("opti", "planner"), ("opti", "nlp"), ("plain", "opti")):
        columns[f"{way} / {other}"] = _ratio(way, other)
    note = "Medians over the searches; a ratio is the median of each search's own ratio."
    return tables.summary("One local search", ("N",), dict(sorted(groups.items())), columns, note)


def _ratio(way: str, other: str) -> tables.Column:
    return tables.middle(lambda row: row[f"{way}_ms"] / row[f"{other}_ms"], 2)
