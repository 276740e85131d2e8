"""Motions for verified plans: how many have one, how long planning it takes, and how long the arm moves."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from weakref import WeakSet

import numpy as np
import plotly.graph_objects as go

from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.report import Cell, Figure, Report, Table, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, error_rows, usable
from regrasp_opt.benchmarks.harness.subjects import planning_key, resident
from regrasp_opt.files import content_hash
from regrasp_opt.motion import MotionOptions, plan_motion, plan_with_motion
from regrasp_opt.planning import RegraspProblem, solve_sequence
from regrasp_opt.planning.tasks import random_task

TEXT = (
    "Random start-goal pairs that need a regrasp. The first plan that is proved has its motion planned, from the "
    "robot's home and back; where there is none, the search goes on with the next candidate. The motions are kept "
    "beside the rows, in the folder motions; from the repository, python -m tests.oracles verifies such files."
)
PAIRS = {True: 3, False: 50}
"""Pairs an object, in quick and in full runs."""
TIME_LIMIT = 120.0
"""Seconds after which the search for poses gives up."""


def run_motion(session: Session) -> Report:
    """Plan motions for random pairs of every object, and keep them."""
    subjects = session.subjects()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    for name, problem in usable(subjects):
        instances = _instances(session, name, problem)
        hashes[name] = instances_hash(instances)
        for instance in instances:
            depends = content_hash(planning_key(problem), instances_hash([instance]), session.seed, TIME_LIMIT)
            arguments = (replace(problem), instance, session.seed, session.folder / "motion" / "motions")
            items.append(Item(instance.name, depends, motion_row, arguments, {"object": name, "pair": instance.name}))
    results = session.execute("motion", items)
    rows = results.rows + error_rows(subjects)
    names = [name for name, _ in usable(subjects)]
    return Report(
        "motion",
        "Motion",
        TEXT,
        (_table(rows, names), _failures(rows)),
        rows,
        (Figure("Time for poses and motion together", _figure(rows, names)),),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, "time limit [s]": TIME_LIMIT},
    )


def _instances(session: Session, name: str, problem: RegraspProblem) -> list[Instance]:
    rng = session.rng(40)
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(PAIRS[session.quick])]
    return [Instance(f"{name}/motion/{i}", task.start, task.goal, None) for i, task in enumerate(tasks)]


_warmed: WeakSet[RegraspProblem] = WeakSet()


def motion_row(problem: RegraspProblem, instance: Instance, seed: int, folder: Path) -> list[Row]:
    """Plan poses and motion of `instance`, keep the motion in `folder`, and return the one row about it."""
    problem = resident(problem)
    if problem not in _warmed:  # lattice and solvers are made once a problem
        solve_sequence(problem, instance.start, instance.goal, max_regrasps=2, time_limit=5.0)
        _warmed.add(problem)
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


def _select(rows: list[Row], name: str, key: str) -> list[Row]:
    return [row for row in rows if row.get("object") == name and row.get(key)]


def _median(values: list[float]) -> float | None:
    return round(float(np.median(values)), 3) if values else None


def _table(rows: list[Row], names: list[str]) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for name in names:
        solved, moved = _select(rows, name, "solved"), _select(rows, name, "moves")
        lines.append(
            (
                name,
                sum(row.get("object") == name and "solved" in row for row in rows),
                len(solved),
                percent([row["first_moves"] for row in solved]),
                percent([row["moves"] for row in solved]),
                _median([row["pose_seconds"] for row in moved]),
                _median([row["motion_seconds"] for row in moved]),
                _median([row["seconds"] for row in moved]),
                max((row["seconds"] for row in moved), default=None),
                _median([row["duration"] for row in moved]),
                _median([row["stopping"] for row in moved]),
                _median([row["duration"] / row["stopping"] for row in moved]),
            )
        )
    return Table(
        "Motions",
        (
            "object",
            "pairs",
            "verified plans",
            "first moves [%]",
            "moves [%]",
            "poses [s]",
            "motion [s]",
            "both [s]",
            "slowest [s]",
            "takes [s]",
            "with stops [s]",
            "ratio",
        ),
        tuple(lines),
        "First moves: the first verified plan has a motion; moves: it or a later candidate has. Times are medians but "
        "for the slowest; takes: how long the arm moves; with stops: before trajectory optimisation, which is part of "
        "the time for the motion.",
    )


def _failures(rows: list[Row]) -> Table:
    bad = [row for row in rows if "solved" in row and not row.get("first_moves")]
    lines = [(row["pair"], row["status"], row.get("reason"), "yes" if row.get("moves") else "no") for row in bad]
    return Table(
        "Pairs whose first plan has no motion",
        ("pair", "status", "reason", "a later one has"),
        tuple(lines),
        "" if lines else "There are none.",
    )


def _figure(rows: list[Row], names: list[str]) -> go.Figure:
    figure = go.Figure()
    for name in names:
        here = _select(rows, name, "solved")
        times = sorted(row["seconds"] for row in here if row["moves"])
        share = [100 * (i + 1) / len(here) for i in range(len(times))]
        figure.add_trace(go.Scatter(x=times, y=share, mode="lines", line={"shape": "hv"}, name=name))
    figure.update_xaxes(type="log", title_text="seconds")
    figure.update_yaxes(title_text="verified plans with a motion [%]", range=[0, 101])
    figure.update_layout(height=380, margin={"l": 60, "r": 10, "t": 10, "b": 50})
    return figure
