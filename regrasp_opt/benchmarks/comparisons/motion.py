"""Motions for verified plans: how many have one, how long planning it takes, and how long the arm moves."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash, random_instances
from regrasp_opt.benchmarks.harness.planners import warm_up
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.motion import MotionOptions, plan_motion, plan_with_motion
from regrasp_opt.planning import RegraspProblem, solve_sequence
from regrasp_opt.planning.recipes import RECIPES

TEXT = (
    "Random start-goal pairs that need a regrasp. The first verified plan has its motion planned, from the "
    "robot's home and back; where there is none, the search goes on with the next candidate. The motions are kept "
    "beside the rows, in the folder motions; from the repository, python -m tests.oracles verifies such files."
)
PAIRS = {True: 3, False: 50}
"""Pairs an object, in quick and in full runs."""
TIME_LIMIT = 120.0
"""Seconds after which the search for poses gives up."""


def run_motion(session: Session) -> Report:
    """Plan motions for random pairs of every object, and keep them."""
    folder = session.folder / "motion" / "motions"

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        pairs = random_instances(problem, session.rng(40), PAIRS[session.quick], f"{name}/motion")
        items = [pair_item(name, problem, p, motion_row, session.seed, folder) for p in pairs]
        return items, instances_hash(pairs)

    settings, made = {"time limit [s]": TIME_LIMIT}, (_table, _failures)
    return run_experiment(session, "motion", "Motion", TEXT, work, made, figures=_figures, settings=settings)


def motion_row(problem: RegraspProblem, instance: Instance, seed: int, folder: Path) -> list[Row]:
    """Plan poses and motion of `instance`, keep the motion in `folder`, and return the one row about it."""
    problem = resident(problem)
    warm_up(problem, instance, RECIPES["ipopt"]())
    options = MotionOptions(seed=seed)
    began = time.perf_counter()
    plan = solve_sequence(problem, instance.start, instance.goal, seed=seed, time_limit=TIME_LIMIT)
    planned = time.perf_counter() - began
    row: Row = {
        "status": plan.status.name.lower(),
        "solved": plan.solved,
        "num_regrasps": plan.num_regrasps if plan.solved else None,
        "pose_seconds": round(planned, 4),
    }
    if not plan.solved:
        return [row]
    motion = plan_motion(plan, options)
    row |= {"first_moves": motion.solved, "reason": motion.reason}
    if not motion.solved:
        motion = plan_with_motion(
            problem, instance.start, instance.goal, options=options, seed=seed, time_limit=TIME_LIMIT
        )
    seconds = time.perf_counter() - began
    row |= {"moves": motion.solved, "motion_seconds": round(seconds - planned, 4), "seconds": round(seconds, 4)}
    if not motion.solved:
        return [row]
    stopping = plan_motion(motion.plan, replace(options, optimise=False))
    folder.mkdir(parents=True, exist_ok=True)
    motion.save(folder / f"{instance.name.replace('/', '-')}.json")
    return [{**row, "duration": round(motion.duration, 3), "stopping": round(stopping.duration, 3)}]


def _table(rows: list[Row], names: list[str]) -> Table:
    columns: dict[str, tables.Column] = {
        "pairs": len,
        "verified plans": tables.count("solved"),
        "first moves [%]": tables.share("first_moves"),
        "moves [%]": tables.share("moves"),
        "poses [s]": tables.middle("pose_seconds", of="moves"),
        "motion [s]": tables.middle("motion_seconds", of="moves"),
        "both [s]": tables.middle("seconds", of="moves"),
        "slowest [s]": lambda here: max(tables.values(here, "seconds", of="moves"), default=None),
        "takes [s]": tables.middle("duration"),
        "with stops [s]": tables.middle("stopping"),
        "ratio": tables.middle(lambda row: row["duration"] / row["stopping"], of="moves"),
    }
    groups = tables.by_object([row for row in rows if "solved" in row], names)
    return tables.summary(
        "Motions",
        ("object",),
        groups,
        columns,
        "First moves: the first verified plan has a motion; moves: it or a later candidate has. Times are medians but "
        "for the slowest; takes: how long the arm moves; with stops: before trajectory optimisation, which is part of "
        "the time for the motion.",
    )


def _failures(rows: list[Row], names: list[str]) -> Table:
    bad = [row for row in rows if "solved" in row and not row.get("first_moves")]
    columns: dict[str, tables.Value] = {"pair": "pair", "status": "status", "reason": "reason"}
    columns["a later one has"] = lambda row: "yes" if row.get("moves") else "no"
    return tables.listing("Pairs whose first plan has no motion", bad, columns)


def _figures(rows: list[Row], names: list[str]) -> list[Figure]:
    solved = tables.by_object([row for row in rows if row.get("solved")], names)
    curves = tables.time_curves(solved, "seconds", "moves", "verified plans with a motion [%]")
    return [Figure("Time for poses and motion together", curves)]
