"""The refiner comparison: every planner on the same instances, with the same grasps and the same checker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.planners import PLANNERS, graph_row, plan_row, solvable, solved_by_both
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.benchmarks.paper.hard_tiers import Condition, hard_instances
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.model_store import read_report

TEXT = (
    "Every planner on the same start-goal pairs: pairs with all grasps that need a regrasp, and pairs of the hard "
    "tiers that the oracle solves. All plans are verified by the same exact checker; the time ends with that. The "
    "regrasp graph is the discrete baseline: exact feasibility on the grid, then a shortest path."
)
GRAPH = "regrasp graph"
UNPREPARED = ("random poses",)
"""Planners that need no model."""
PAIRS = {True: 2, False: 5}
"""Pairs an object with all grasps, in quick and in full runs."""
HARD = {True: {"2": 1, "3+": 1}, False: {"2": 3, "3+": 3}}
"""Pairs of the hard tiers an object, in quick and in full runs."""
TIME_LIMIT = {True: 20.0, False: 30.0}
"""Seconds after which a planner gives up."""


def run_refiners(session: Session) -> Report:
    """Measure success, quality and time of every planner."""

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        easy = session.chosen(name, problem, session.oracle(name, problem), {"any": PAIRS[session.quick]}, 40)
        every = Condition("all grasps", problem, session.grid, np.arange(len(problem.grasps)))
        pairs, hard = [(every, instance) for instance in easy], hard_instances(session, name, problem)
        for tier, count in HARD[session.quick].items():
            pairs += [pair for pair in hard if pair[1].tier == tier][:count]
        items = [item for condition, pair in pairs for item in _items(session, name, condition, pair)]
        return items, instances_hash([pair for _, pair in pairs])

    settings = {"oracle": str(session.grid), "time limit [s]": TIME_LIMIT[session.quick]}
    heading, made = ("refiners", "Refiners and baselines", TEXT), (_success_table, _quality_table)
    return run_experiment(session, *heading, work, made, figures=_figures, settings=settings)


def _items(session: Session, name: str, condition: Condition, instance: Instance) -> list[Item]:
    reduced, limit = condition.reduced, TIME_LIMIT[session.quick]
    prepared = sum(read_report(reduced.model_folder)["times"].values()) if reduced.model_folder else None

    def item(planner: str, function: Callable[..., list[Row]], *arguments: Any, **columns: Any) -> Item:
        columns = {"condition": condition.label, "planner": planner, **columns}
        return pair_item(name, reduced, instance, function, *arguments, label=f"/{planner}", **columns)

    return [item(GRAPH, graph_row, replace(condition.problem), condition.ids, condition.grid)] + [
        item(planner, plan_row, planner, session.seed, limit, before=None if planner in UNPREPARED else prepared)
        for planner in PLANNERS
    ]


def _by_planner(rows: list[Row]) -> dict[str, list[Row]]:
    measured = tables.grouped([row for row in rows if "solved" in row], "planner")
    return {name: measured.get((name,), []) for name in (GRAPH, *PLANNERS)}


def _success_table(rows: list[Row], names: list[str]) -> Table:
    def late(here: list[Row]) -> float | None:
        times = sorted(tables.values(here, "first_verified", of="solved"))
        return round(times[int(0.9 * (len(times) - 1))], 3) if times else None

    columns: dict[str, tables.Column] = {"pairs": len, "solved [%]": tables.share("solved", of=solvable)}
    for tier, label in (("1", "N=1"), ("2", "N=2"), ("3+", "N>=3")):
        columns[label] = tables.share("solved", of=lambda row, tier=tier: row["tier"] == tier)
    columns |= {
        "N no more than oracle [%]": tables.share(lambda row: row["num_regrasps"] <= row["minimum"], of=solved_by_both),
        "median [s]": tables.middle("first_verified", of="solved"),
        "90 % [s]": late,
        "mean, all [s]": tables.average("seconds", 3),
        "before [s]": tables.average("before", 1),
    }
    return tables.summary(
        "Success and time to the first verified plan",
        ("planner",),
        _by_planner(rows),
        columns,
        "Solved: of the pairs that the oracle solves. Mean, all: time spent on every pair, solved or not. Before: "
        "what is made once for an object, workcell and grasp set: the exact grid (processor time), or grasps, labels "
        "and trained energies (by the clock). What starts from the lattice is quick by the ranking, not by the "
        "descent: the energies of all lattice poses are there before start and goal are known, so all chains of one "
        "pose are scored by two products of a matrix and a vector. Where a number of regrasps cannot work the same "
        "scores say so, and nothing is refined or verified in vain.",
    )


def _quality_table(rows: list[Row], names: list[str]) -> Table:
    by_planner = _by_planner(rows)
    solved_by_all = set.intersection(
        *({row["pair"] for row in here if row["solved"]} for planner, here in by_planner.items() if planner != GRAPH)
    )

    def good(row: Row) -> bool:
        return row["solved"] and row["pair"] in solved_by_all

    def converged(here: list[Row]) -> float | None:
        solves = sum(tables.values(here, "solves"))
        return percent([sum(tables.values(here, "converged")) / solves]) if solves else None

    columns: dict[str, tables.Column] = {
        "pairs": tables.count(good),
        "N": tables.average("num_regrasps", of=good),
        "J_seq": tables.average("cost", of=good),
        "bottleneck [grasps]": tables.average("bottleneck", 1, of=good),
        "clearance [mm]": tables.average("clearance_mm", 1, of=good),
        "iterations": tables.average("iterations", 1, of=good),
        "evaluations": tables.average("evaluations", 0, of=good),
        "converged [%]": converged,
    }
    return tables.summary(
        "Plans for the pairs that every refiner solved",
        ("planner",),
        by_planner,
        columns,
        "Bottleneck: fewest shared grasps of a transition. Clearance: of the clearest grasp of the tightest "
        "transition. Evaluations: of J_seq and its derivatives by the refiner; a lattice's energies are made before. "
        "Converged: share of all nonlinear solves. What refining adds is the difference in J_seq to 'lattice'; what "
        "exact second derivatives save are the evaluations of L-BFGS and sqpmethod. 'ipopt from lattice' is the "
        "default because its poses are minima of the cost, and of whatever a user adds to it.",
    )


def _figures(rows: list[Row], names: list[str]) -> list[Figure]:
    curves = tables.time_curves(
        _by_planner(rows), "first_verified", "solved", "pairs with a verified plan [%]", height=420
    )
    return [Figure("Share of pairs with a verified plan over time", curves)]
