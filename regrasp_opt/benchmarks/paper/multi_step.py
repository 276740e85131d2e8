"""Multi-step search (Table III): pairs that need at least one regrasp, planned and compared with the exact oracle."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import replace

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import instances_hash
from regrasp_opt.benchmarks.harness.planners import plan_row, solvable, solved_by_both
from regrasp_opt.benchmarks.harness.report import Cell, Figure, Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.benchmarks.paper.published import MULTI_STEP, PAPER_OBJECT
from regrasp_opt.planning import Recipe, RegraspProblem
from regrasp_opt.planning.recipes import RECIPES, paper_recipe
from regrasp_opt.solvers import NlpRefiner

TEXT = (
    "Start-goal pairs without a shared grasp. S.T. is the share of pairs for which a sequence passes the energy "
    "threshold h (Algorithms 1 and 2), S.H. the share whose sequence also passes the exact check. The oracle's fewest"
    " regrasps come from exact feasibility on a grid."
)
PAIRS = {True: 8, False: 50}
"""Pairs an object, in quick and in full runs."""
COMPARED = {True: 0, False: 10}
"""Pairs an object for which the paper's method is run too: it takes up to minutes a pair on a processor."""
TIME_LIMIT = 120.0
"""Seconds after which a planner gives up."""
K_TOP = (10, 50)
METHODS = (("ours", None), *((name, k) for name in ("ours, threshold", "paper's method") for k in K_TOP))
"""Planners and their K_top."""


def run_multi_step(session: Session) -> Report:
    """Measure S.T., S.H., length, time, and N against the oracle's."""

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        oracle = session.oracle(name, problem)
        chosen = session.chosen(name, problem, oracle, {"any": PAIRS[session.quick]}, 20)
        paper, end = replace(problem, preset="paper"), (session.seed, TIME_LIMIT)
        planners: list[tuple[str, int | None, RegraspProblem, Recipe]] = [("ours", None, problem, RECIPES["ipopt"]())]
        for k in K_TOP:  # the paper's acceptance: the cheapest candidate that passes `h`
            recipe = Recipe(NlpRefiner(), batches=(k,), verified=k, fallback=0, check="threshold")
            planners.append(("ours, threshold", k, problem, recipe))
        compared = [("paper's method", k, paper, paper_recipe(k)) for k in K_TOP]
        items = [
            pair_item(name, used, pair, plan_row, recipe, *end, label=f"/{planner}/{k}", planner=planner, k_top=k)
            for number, pair in enumerate(chosen)
            for planner, k, used, recipe in planners + (compared if number < COMPARED[session.quick] else [])
        ]
        return items, instances_hash(chosen)

    settings = {"oracle": str(session.grid), "time limit [s]": TIME_LIMIT}
    heading, made = ("multi-step", "Multi-step search", TEXT), (_table, _oracle_table, _failures)
    return run_experiment(session, *heading, work, made, figures=_figures, settings=settings)


def _ours(rows: list[Row], names: list[str]) -> dict[Hashable, list[Row]]:
    return tables.by_object([row for row in rows if row.get("planner") == "ours" and "solved" in row], names)


def _table(rows: list[Row], names: list[str]) -> Table:
    measured = tables.grouped([row for row in rows if "solved" in row], "object", "planner", "k_top")
    columns = {
        "pairs": len,
        "S.T. [%]": tables.share("threshold_passed"),
        "S.H. [%]": tables.share("solved"),
        "E.L.": tables.average("num_regrasps", of="solved"),
        "E.T. [s]": tables.average("seconds", of="solved"),
    }
    lines: list[tuple[Cell, ...]] = []
    for name in names:
        groups = {key: here for method in METHODS if (here := measured.get(key := (name, *method)))}
        lines += tables.summary("", (), groups, columns).rows
        printed = MULTI_STEP.get(PAPER_OBJECT.get(name, ""), {})
        source = f"as printed in the paper, {PAPER_OBJECT.get(name)}"
        lines += [(name, source, k, 50, *figures) for k, figures in printed.items()]
    return Table(
        "Threshold and hard success",
        ("object", "planner", "K_top", *columns),
        tuple(lines),
        "Ours verifies candidates until one passes; its S.T. is the share of pairs whose verified plan passes the "
        "threshold too, with exact energies at both ends. Its time leaves out lattice and solvers, made once a problem."
        " 'ours, threshold' accepts the cheapest candidate that passes, as the paper does. "
        "'paper's method' is the paper's preset and Algorithms 1 and 2, run on the first of these pairs, with the "
        "same grasps. Its S.H. counts sequences that pass both; the paper's also those that its threshold refuses, and "
        "may exceed S.T. The paper's times are those of its machine.",
    )


def _oracle_table(rows: list[Row], names: list[str]) -> Table:
    columns = {
        "pairs": len,
        "oracle solves [%]": tables.share(solvable),
        "S.H. of these [%]": tables.share("solved", of=solvable),
        "N as the oracle [%]": tables.share(lambda row: row["num_regrasps"] == row["minimum"], of=solved_by_both),
        "N no more [%]": tables.share(lambda row: row["num_regrasps"] <= row["minimum"], of=solved_by_both),
        "beyond it": tables.count(lambda row: row["solved"] and not solvable(row)),
    }
    return tables.summary(
        "Against the exact oracle",
        ("object",),
        _ours(rows, names),
        columns,
        "N as the oracle, and N no more: shares of the verified plans. Beyond it: pairs solved where the grid has no "
        "plan.",
    )


def _failures(rows: list[Row], names: list[str]) -> Table:
    bad = [
        row
        for row in rows
        if row.get("planner") == "ours"
        and solvable(row)
        and (not row["solved"] or row["num_regrasps"] > row["minimum"])
    ]
    columns = {"pair": "pair", "oracle N": "minimum", "status": "status", "our N": "num_regrasps", "seconds": "seconds"}
    return tables.listing("Pairs where ours falls short of the oracle", bad, columns)


def _figures(rows: list[Row], names: list[str]) -> list[Figure]:
    curves = tables.time_curves(_ours(rows, names), "first_verified", "solved", "pairs solved [%]")
    return [Figure("Time to the first verified plan", curves)]
