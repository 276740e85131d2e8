"""The joint problem and free grasps: how much a verified plan gains, and how many thinned sets still give a plan."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash, random_instances
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.conventions import IntArray
from regrasp_opt.motion import refine_plan, solve_with_free_grasps
from regrasp_opt.motion.refinement.measures import Measure
from regrasp_opt.planning import RegraspProblem, solve_sequence

TEXT = (
    "Start-goal pairs without a shared grasp. Joint problem: a verified plan is refined at equal N for the least joint"
    " travel, and once more for the largest least clearance. 'Before' takes the first grasp that each transition of the"
    " plan lists, 'discrete' the best grasps and arm branches at the plan's own poses, 'joint' is what the nonlinear"
    " program adds by moving poses and configurations. Free grasps: of ten grasps drawn at random the planner finds no"
    " plan while the whole set has one; the grasps then move on the object."
)
PAIRS = {True: 2, False: 25}
"""Pairs an object for the joint problem, in quick and in full runs."""
THINNED = {True: 4, False: 40}
"""Pairs an object whose grasp set is thinned; those that can still be solved do not count."""
KEPT = 10
"""Grasps of a thinned set."""
MAX_REGRASPS = 2
"""Most regrasps of plans with a thinned set, and of those that show that the whole set holds a plan."""
MEASURES: tuple[Measure, ...] = ("travel", "clearance")


def run_joint(session: Session) -> Report:
    """Measure joint travel, least clearance and the share of thinned instances that free grasps solve."""
    refined, thinned = PAIRS[session.quick], THINNED[session.quick]
    numbers = itertools.count()

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        number, seed = next(numbers), session.seed
        pairs = random_instances(problem, session.rng(40, number), max(refined, thinned), name)
        items = []
        for k, pair in enumerate(pairs):
            if k < refined:
                items.append(pair_item(name, problem, pair, refined_rows, seed, label=", refined"))
            if k < thinned:
                ids = np.sort(session.rng(41, number, k).permutation(len(problem.grasps))[:KEPT])
                items.append(pair_item(name, problem, pair, thinned_rows, ids, seed, label=", thinned"))
        return items, instances_hash(pairs)

    heading, settings = "Joint problem and free grasps", {"grasps kept": KEPT, "most regrasps": MAX_REGRASPS}
    made = partial(_measure_table, measure="travel"), partial(_measure_table, measure="clearance"), _thinned_table
    return run_experiment(session, "joint", heading, TEXT, work, made, settings=settings)


def refined_rows(problem: RegraspProblem, pair: Instance, seed: int) -> list[Row]:
    """Plan `pair`, refine the plan for each measure, and return a row for each."""
    plan = solve_sequence(resident(problem), pair.start, pair.goal, seed=seed)
    if not plan.solved:
        return [{"measure": measure, "status": plan.status.name.lower()} for measure in MEASURES]
    rows: list[Row] = []
    for measure in MEASURES:
        begun = time.perf_counter()
        result = refine_plan(plan, measure)
        before, after = getattr(result.before, measure), getattr(result.after, measure)
        discrete = before if result.discrete is None else getattr(result.discrete, measure)
        rows.append(
            {
                "measure": measure,
                "status": "solved",
                "num_regrasps": plan.num_regrasps,
                "before": before,
                "discrete": discrete,
                "after": after,
                "seconds": time.perf_counter() - begun,
                "verified": result.plan.residuals().hold,
                "reason": result.reason,
            }
        )
    return rows


def thinned_rows(problem: RegraspProblem, pair: Instance, ids: IntArray, seed: int) -> list[Row]:
    """Plan `pair` with the grasps `ids` (K,) alone, and with free grasps where only the whole set holds a plan."""
    whole = resident(problem)
    thinned = replace(whole, grasps=whole.grasps.subset(ids))
    alone = solve_sequence(thinned, pair.start, pair.goal, max_regrasps=MAX_REGRASPS, seed=seed)
    known = (
        alone.solved or not solve_sequence(whole, pair.start, pair.goal, max_regrasps=MAX_REGRASPS, seed=seed).solved
    )
    row: Row = {"measure": "free grasps", "thinned status": alone.status.name.lower(), "counts": not known}
    if known:
        return [row]
    begun = time.perf_counter()
    plan = solve_with_free_grasps(thinned, pair.start, pair.goal, max_regrasps=MAX_REGRASPS, seed=seed)
    return [
        {
            **row,
            "status": plan.status.name.lower(),
            "num_regrasps": plan.num_regrasps,
            "seconds": time.perf_counter() - begun,
            "verified": plan.solved and plan.residuals().hold,
            "moved grasps": len(plan.problem.grasps) - len(ids),
        }
    ]


def _measure_table(rows: Sequence[Row], names: Sequence[str], measure: Measure) -> Table:
    measured = [row for row in rows if row.get("measure") == measure and "after" in row]
    travel = measure == "travel"
    unit, scale, change = ("rad", 1.0, "lowered") if travel else ("mm", 1e3, "raised")

    def gain(before: str, after: str) -> tables.Column:
        sign = -100 if travel else 100
        return tables.middle(lambda row: sign * (row[after] / row[before] - 1), 1, of=lambda row: row[before] > 0)

    columns: dict[str, tables.Column] = {
        "pairs": len,
        f"before [{unit}]": tables.middle(lambda row: scale * row["before"], 2),
        f"discrete [{unit}]": tables.middle(lambda row: scale * row["discrete"], 2),
        f"joint [{unit}]": tables.middle(lambda row: scale * row["after"], 2),
        "by the choice [%]": gain("before", "discrete"),
        "by the program [%]": gain("discrete", "after"),
        "in all [%]": gain("before", "after"),
        "verified [%]": tables.share("verified"),
        "seconds": tables.average("seconds"),
    }
    return tables.summary(
        f"The {measure}, {change} at equal N",
        ("object",),
        tables.by_object(measured, names, "all"),
        columns,
        f"Medians over pairs; the shares are medians of how much the {measure} was {change} in each pair, by the choice"
        " of grasps and branches, on top of that by the program, and by both. The time is a mean.",
    )


def _thinned_table(rows: Sequence[Row], names: Sequence[str]) -> Table:
    measured = [row for row in rows if row.get("measure") == "free grasps"]

    def solved(row: Row) -> bool:
        return row["counts"] and row["status"] == "solved"

    columns: dict[str, tables.Column] = {
        "drawn": len,
        "unsolvable": tables.count("counts"),
        "solved [%]": tables.share(solved, of="counts"),
        "verified [%]": tables.share("verified", of=solved),
        "moved grasps": tables.average("moved grasps", of=solved),
        "solved [s]": tables.average("seconds", of=solved),
        "gave up [s]": tables.average("seconds", of=lambda row: row["counts"] and not solved(row)),
    }
    return tables.summary(
        f"Free grasps where {KEPT} sampled ones hold no plan",
        ("object",),
        tables.by_object(measured, names, "all"),
        columns,
        "Unsolvable: no plan with the thinned set, but one with the whole set. Verified: of the solved plans, those"
        " that their certificate confirms.",
    )
