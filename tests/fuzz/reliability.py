"""The reliability campaign: plans in adversity, damaged input, killed and interrupted commands.

``python -m tests.fuzz.reliability``, from the repository, writes ``rows.csv``, ``summary.json``, ``index.html`` and the
page ``reliability.md``; a run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import argparse
import signal
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.report import Report, write_report
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import planning_key, prepared_problem
from regrasp_opt.errors import RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem

from .faults import JOBS, kill_rows, signal_rows
from .fuzzing import fuzz_rows
from .tables import reliability_tables
from .targets import TARGETS
from .trials import (
    CONDITIONS,
    Condition,
    choose_pairs,
    minimum_on_grid,
    reduced,
    trial_rows,
    workcells,
)

COMMAND = "python -m tests.fuzz.reliability"
TEXT = (
    "Plans between random poses, half of the pairs sharing no grasp, in several workcells, with all and with few "
    "grasps; every claim of a plan is verified twice, by its certificate and from its file by the verifier of "
    "tests/oracles, which shares no code with the planner; every failure is asked of an exact grid. Damaged files for "
    "every reader, and damaged command lines. prepare and bench killed with SIGKILL, and ended with SIGINT and "
    "SIGTERM, at random moments."
)


@dataclass(frozen=True)
class Sizes:
    """Trials of each object, workcell and condition; files for each reader; kills and signals of each command."""

    trials: int
    files: int
    kills: int
    signals: int


QUICK = Sizes(2, 100, 2, 1)
FULL = Sizes(63, 10_000, 30, 10)
TRIALS_AT_A_TIME = 10
FILES_AT_A_TIME = 2000
KILLS_AT_A_TIME = 10
"""Kills that end with a run to the end and are kept together."""


@dataclass(frozen=True, eq=False)
class _Trials:
    """The trials of one object in one workcell under one condition."""

    columns: Row
    problem: RegraspProblem
    instances: list[Instance]

    def items(self, seed: int) -> list[Item]:
        key = planning_key(self.problem)
        bare, found = replace(self.problem), []
        for first in range(0, len(self.instances), TRIALS_AT_A_TIME):
            chosen = self.instances[first : first + TRIALS_AT_A_TIME]
            depends = content_hash("verified-twice", key, instances_hash(chosen), seed)
            found.append(Item(chosen[0].name, depends, trial_rows, (bare, chosen, seed), self.columns))
        return found


def run_reliability(session: Session) -> Report:
    """Run all parts."""
    sizes = QUICK if session.quick else FULL
    rows, hashes, revisions = _plan_part(session, sizes)
    alone = replace(session, jobs=1)  # signals are timed: nothing else may run beside them
    for part, runner in ((_fuzz_items(session, sizes), session), (_fault_items(session, sizes), alone)):
        results = runner.execute("reliability", part)
        rows += results.rows
        revisions += results.revisions
    return Report(
        "reliability",
        "Reliability",
        TEXT,
        reliability_tables(rows),
        rows,
        (),
        hashes,
        tuple(sorted(set(revisions))),
        {"quick": session.quick, "seed": session.seed, "oracle": str(session.coarse_grid), **vars(sizes)},
        command=COMMAND,
    )


def _plan_part(session: Session, sizes: Sizes) -> tuple[list[Row], dict[str, str], tuple[str, ...]]:
    trials, rows = _trials(session, sizes)
    results = session.execute("reliability", [item for group in trials for item in group.items(session.seed)])
    rows += results.rows
    for group in trials:
        _ask_the_oracle(session, group, rows)
    hashes = {group.instances[0].name: instances_hash(group.instances) for group in trials}
    return rows, hashes, results.revisions


def _trials(session: Session, sizes: Sizes) -> tuple[list[_Trials], list[Row]]:
    """Return all trials, and a row for each object or model that could not be had, with the reason."""
    bodies, rows = session.bodies()
    found: list[_Trials] = []
    for c, (cell_name, cell) in enumerate(workcells(session.folder / "reliability", session.quick)):
        for o, (name, body) in enumerate(bodies.items()):
            try:
                whole = prepared_problem(body, cell, jobs=session.jobs)
            except RegraspError as error:
                rows.append({"object": name, "workcell": cell_name, "error": str(error)})
                continue
            pool = session.pool(whole)
            for k, condition in enumerate(CONDITIONS):
                found += _group(session, sizes, whole, pool, (name, cell_name, condition), (c, o, k))
    return found, rows


def _group(
    session: Session, sizes: Sizes, whole: RegraspProblem, pool: Any, labels: tuple[str, str, Condition], stream: Any
) -> list[_Trials]:
    name, cell_name, condition = labels
    rng = session.rng(50, *stream)
    problem, ids = reduced(whole, condition, rng)
    prefix = f"{name}/{cell_name}/{condition.label}"
    count = sizes.trials if condition.preset == "default" else -(-sizes.trials // 4)  # the paper's takes long
    instances = choose_pairs(pool.with_grasps(ids), count, rng, prefix)
    columns: Row = {"part": "plans", "object": name, "workcell": cell_name, "condition": condition.label}
    return [_Trials(columns, problem, instances)] if instances else []


def _ask_the_oracle(session: Session, group: _Trials, rows: list[Row]) -> None:
    """Enter into the rows of failed trials the fewest regrasps that the exact grid needs; None if it has no plan.

    The paper's energy is not the planner's own, and what it loses is not counted.
    """
    if group.problem.preset == "paper":
        return
    instances = {instance.name: instance for instance in group.instances}
    failed = [row for row in rows if row.get("pair") in instances and row.get("solved") is False]
    if failed:
        name = f"{group.columns['object']}, {group.columns['workcell']}"
        oracle = session.oracle(name, group.problem, session.coarse_grid)  # of the grasps that are left
        for row in failed:
            row["minimum"] = minimum_on_grid(group.problem, oracle, instances[row["pair"]])


def _fuzz_items(session: Session, sizes: Sizes) -> list[Item]:
    items = []
    for name in TARGETS:
        for first in range(0, sizes.files, FILES_AT_A_TIME):
            count = min(FILES_AT_A_TIME, sizes.files - first)
            columns: Row = {"part": "files", "reader": name}
            arguments = (name, session.seed, first, count)
            depends = content_hash("fuzz-2", *arguments)
            items.append(Item(f"fuzz/{name}/{first}", depends, fuzz_rows, arguments, columns))
    return items


SIGNALS = (signal.SIGINT, signal.SIGTERM)


def _fault_items(session: Session, sizes: Sizes) -> list[Item]:
    items = []
    for name in JOBS:
        for first in range(0, sizes.kills, KILLS_AT_A_TIME):
            kills = (name, session.seed, first, min(KILLS_AT_A_TIME, sizes.kills - first))
            columns: Row = {"part": "faults", "command": name, "signal": "SIGKILL"}
            items.append(Item(f"kill/{name}/{first}", content_hash("kill", *kills), kill_rows, kills, columns))
        for number in SIGNALS:
            sent = (name, int(number), session.seed, sizes.signals)
            columns = {"part": "faults", "command": name, "signal": number.name}
            items.append(Item(f"{number.name}/{name}", content_hash("signal", *sent), signal_rows, sent, columns))
    return items


def main(words: list[str] | None = None) -> int:
    """Run the campaign with the options `words`, write its files and return the exit code."""
    parser = argparse.ArgumentParser(prog=COMMAND, description="Run the reliability campaign. Resumes.")
    parser.add_argument("--quick", action="store_true", help="minutes instead of hours")
    parser.add_argument("--objects", type=Path, help="folder of meshes to plan with besides the built-in ones")
    parser.add_argument("--jobs", type=int, default=-1, help="worker processes; -1 uses all cores")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out", type=Path, default=Path("benchmarks"), help="folder of the results; an interrupted run goes on there"
    )
    options = vars(parser.parse_args(words))
    try:
        session = Session(options.pop("out"), **options)
        report = run_reliability(session)
    except RegraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    folder = session.folder / report.name
    write_report(report, folder)
    print(f"written: {folder / report.name}.md, {folder / 'index.html'}, {folder / 'summary.json'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
