"""The joint problem and free grasps: how much a verified plan gains, and how many thinned sets still give a plan."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.report import Cell, Report, Table, mean, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, error_rows, usable
from regrasp_opt.benchmarks.harness.subjects import planning_key, resident
from regrasp_opt.conventions import IntArray
from regrasp_opt.files import content_hash
from regrasp_opt.motion import refine_plan, solve_with_free_grasps
from regrasp_opt.motion.refinement.measures import Measure
from regrasp_opt.planning import RegraspProblem, solve_sequence
from regrasp_opt.planning.tasks import random_task

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
    subjects = session.subjects()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    for number, (name, problem) in enumerate(usable(subjects)):
        pairs = _pairs(session, number, name, problem, max(PAIRS[session.quick], THINNED[session.quick]))
        hashes[name] = instances_hash(pairs)
        for k, pair in enumerate(pairs):
            depends = content_hash(planning_key(problem), instances_hash([pair]), session.seed)
            columns: Row = {"object": name, "pair": pair.name}
            if k < PAIRS[session.quick]:
                arguments = (replace(problem), pair, session.seed)
                items.append(Item(f"{pair.name}, refined", depends, refined_rows, arguments, columns))
            if k < THINNED[session.quick]:
                ids = np.sort(session.rng(41, number, k).permutation(len(problem.grasps))[:KEPT])
                thinned = (replace(problem), pair, ids, session.seed)
                items.append(Item(f"{pair.name}, thinned", depends, thinned_rows, thinned, columns))
    results = session.execute("joint", items)
    rows = results.rows + error_rows(subjects)
    names = [name for name, _ in usable(subjects)]
    return Report(
        "joint",
        "Joint problem and free grasps",
        TEXT,
        (*(_measure_table(rows, names, measure) for measure in MEASURES), _thinned_table(rows, names)),
        rows,
        (),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, "grasps kept": KEPT, "most regrasps": MAX_REGRASPS},
    )


def _pairs(session: Session, number: int, name: str, problem: RegraspProblem, count: int) -> list[Instance]:
    rng = session.rng(40, number)
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(count)]
    return [Instance(f"{name}/{k}", task.start, task.goal, None) for k, task in enumerate(tasks)]


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
                "proved": result.plan.residuals().hold,
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
            "proved": plan.solved and plan.residuals().hold,
            "moved grasps": len(plan.problem.grasps) - len(ids),
        }
    ]


def _measure_table(rows: Sequence[Row], names: Sequence[str], measure: Measure) -> Table:
    measured = [row for row in rows if row.get("measure") == measure and "after" in row]
    unit, scale, change = ("rad", 1.0, "lowered") if measure == "travel" else ("mm", 1e3, "raised")
    lines: list[tuple[Cell, ...]] = []
    for name in (*names, "all"):
        here = [row for row in measured if name in (row["object"], "all")]
        values = [scale * np.array([row[key] for row in here]) for key in ("before", "discrete", "after")]
        sign = -1.0 if measure == "travel" else 1.0
        gains = [
            _gain(values[0], values[1], sign),
            _gain(values[1], values[2], sign),
            _gain(values[0], values[2], sign),
        ]
        medians = [round(float(np.median(v)), 2) if len(v) else None for v in values]
        proved = percent([row["proved"] for row in here])
        lines.append((name, len(here), *medians, *gains, proved, mean([row["seconds"] for row in here])))
    columns = (f"before [{unit}]", f"discrete [{unit}]", f"joint [{unit}]", "by the choice [%]", "by the program [%]")
    return Table(
        f"The {measure}, {change} at equal N",
        ("object", "pairs", *columns, "in all [%]", "proved [%]", "seconds"),
        tuple(lines),
        f"Medians over pairs; the shares are medians of how much the {measure} was {change} in each pair, by the choice"
        " of grasps and branches, on top of that by the program, and by both. The time is a mean.",
    )


def _gain(before: np.ndarray, after: np.ndarray, sign: float) -> float | None:
    good = before > 0
    return round(float(np.median(100 * sign * (after[good] / before[good] - 1))), 1) if good.any() else None


def _thinned_table(rows: Sequence[Row], names: Sequence[str]) -> Table:
    measured = [row for row in rows if row.get("measure") == "free grasps"]
    lines: list[tuple[Cell, ...]] = []
    for name in (*names, "all"):
        drawn = [row for row in measured if name in (row["object"], "all")]
        here = [row for row in drawn if row["counts"]]
        good = [row for row in here if row["status"] == "solved"]
        lines.append(
            (
                name,
                len(drawn),
                len(here),
                percent([row["status"] == "solved" for row in here]),
                percent([row["proved"] for row in good]),
                mean([row["moved grasps"] for row in good]),
                mean([row["seconds"] for row in good]),
                mean([row["seconds"] for row in here if row["status"] != "solved"]),
            )
        )
    return Table(
        f"Free grasps where {KEPT} sampled ones hold no plan",
        ("object", "drawn", "unsolvable", "solved [%]", "proved [%]", "moved grasps", "solved [s]", "gave up [s]"),
        tuple(lines),
        "Unsolvable: no plan with the thinned set, but one with the whole set. 'Proved' are those of the solved plans"
        " that the independent check confirms.",
    )
