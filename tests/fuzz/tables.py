"""The tables of the reliability campaign.

Coverage and mutants are read from the files that `coverage json` and `tests/mutants.py` leave in the present folder;
where there are none they are not measured.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from regrasp_opt.benchmarks.harness.report import Cell, Table
from regrasp_opt.benchmarks.harness.runner import Row

from .trials import MAX_REGRASPS


def reliability_tables(rows: Sequence[Row]) -> tuple[Table, ...]:
    """Return the summary, and a table of each part."""
    return _summary(rows), _plan_table(rows), _fuzz_table(rows), _fault_table(rows)


def _of(rows: Sequence[Row], part: str) -> list[Row]:
    return [row for row in rows if row.get("part") == part and "error" not in row]


def _total(rows: Sequence[Row], column: str) -> int:
    return sum(int(row.get(column) or 0) for row in rows)


def _lost(rows: Sequence[Row]) -> list[Row]:
    """Return the trials without a plan for which the grid has one of at most `MAX_REGRASPS` regrasps."""
    known = [row for row in rows if not row["solved"] and row.get("minimum") is not None]
    return [row for row in known if row["minimum"] <= MAX_REGRASPS]


def _summary(rows: Sequence[Row]) -> Table:
    plans, files, faults = (_of(rows, part) for part in ("plans", "files", "faults"))
    own = [row for row in plans if "paper" not in row["condition"]]
    solvable = sum(row["solved"] for row in own) + len(_lost(own))
    killed = [row for row in faults if row["signal"] == "SIGKILL"]
    interrupted = [row for row in faults if row["signal"] != "SIGKILL"]
    broken = sum(_total(files, kind) for kind in ("traceback", "crash", "hang", "harmed"))
    kill_faults = sum(_total(killed, kind) for kind in ("half_files", "failed", "different"))
    least = min((row["inputs"] for row in _by_reader(files)), default=0)
    lines: list[tuple[Cell, ...]] = [
        ("planning problems tried", len(plans), "2000"),
        (
            "false positives: plans that one of the two refutes",
            sum(bool(row["wrong"]) for row in plans) if plans else None,
            "0",
        ),
        ("false negatives: solvable on the exact grid, but not solved", len(_lost(own)) if own else None, ""),
        (
            "false negatives, share of the solvable [%]",
            round(100 * len(_lost(own)) / solvable, 2) if solvable else None,
            "1",
        ),
        ("damaged files and command lines tried", _total(files, "inputs"), ""),
        ("of these for each reader, at least", least, "10000"),
        ("tracebacks, crashes, hangs, files harmed", broken if files else None, "0"),
        ("kills", _total(killed, "kills"), "50"),
        ("half files, runs that did not recover, other results", kill_faults if killed else None, "0"),
        ("SIGINT and SIGTERM sent", _total(interrupted, "sent"), ""),
        ("longest time to end [s]", max((row["slowest"] for row in interrupted), default=None), "2"),
        ("branch coverage [%]", branch_coverage(Path("coverage.json")), "90"),
        ("mutants tried", *mutants(Path("mutants/counts.json"))[:1], ""),
        ("mutants killed [%]", *mutants(Path("mutants/counts.json"))[1:], "90"),
    ]
    note = (
        "A dash: not measured. False negatives leave out the paper's energy, which is not the planner's own. Coverage "
        "is that of `coverage run -m pytest`, `coverage combine` and `coverage json`, mutants are a seeded sample of "
        "`python tests/mutants.py`, both run in the folder from which this page is made."
    )
    return Table("Summary", ("what", "measured", "wanted"), tuple(lines), note)


def branch_coverage(path: Path) -> float | None:
    """Return the branch coverage [%] that ``coverage json`` wrote to `path`, or None if it has not."""
    totals = _json(path).get("totals", {})
    branches = totals.get("num_branches")
    return round(100 * totals["covered_branches"] / branches, 1) if branches else None


def mutants(path: Path) -> tuple[int | None, float | None]:
    """Return how many mutants ``tests/mutants.py`` has tried, and the share [%] of these that tests notice."""
    counts = _json(path)
    caught = counts.get("killed", 0) + counts.get("timeout", 0)
    total = caught + counts.get("survived", 0) + counts.get("no_tests", 0)
    return (total, round(100 * caught / total, 1)) if total else (None, None)


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def _plan_table(rows: Sequence[Row]) -> Table:
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in _of(rows, "plans"):
        groups.setdefault((row["workcell"], row["condition"]), []).append(row)
    lines: list[tuple[Cell, ...]] = []
    for (cell, condition), here in groups.items():
        low, failed = _total(here, "low"), _total(here, "low_failed")
        late = sum(row["status"] == "time_limit" for row in here)
        wrong = sum(bool(row["wrong"]) for row in here)
        share = round(100 * failed / low, 1) if low else None
        solved = sum(row["solved"] for row in here)
        lost = None if "paper" in condition else len(_lost(here))
        lines.append((cell, condition, len(here), solved, wrong, lost, late, low, failed, share))
    return Table(
        "Plans",
        ("workcell", "condition", "problems", "solved", "false solved", "false no plan", "time limit",
         "low-energy candidates", "of these false", "false [%]"),
        tuple(lines),
        "Low-energy candidates: refined sequences that the learned energy takes for plans by its threshold. Those that "
        "are false fail the exact check, and none becomes a plan. False no plan: solvable on the exact grid with at "
        f"most {MAX_REGRASPS} regrasps, time limits included; not asked of the paper's energy.",
    )  # fmt: skip


def _by_reader(rows: Sequence[Row]) -> list[Row]:
    names = dict.fromkeys(row["reader"] for row in rows)
    kinds = ("inputs", "read", "refused", "traceback", "crash", "hang", "harmed")
    return [
        {"reader": name, **{kind: _total([row for row in rows if row["reader"] == name], kind) for kind in kinds}}
        for name in names
    ]


def _fuzz_table(rows: Sequence[Row]) -> Table:
    lines = tuple(tuple(row.values()) for row in _by_reader(_of(rows, "files")))
    examples = "; ".join(f"{row['reader']} {row['examples']}" for row in _of(rows, "files") if row["examples"])
    return Table(
        "Damaged files and command lines",
        ("reader", "files", "read", "refused", "tracebacks", "crashes", "hangs", "harmed"),
        lines,
        examples or "Read: the damage left a file or command line that is still good, or made another good one.",
    )


def _fault_table(rows: Sequence[Row]) -> Table:
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in _of(rows, "faults"):
        groups.setdefault((row["command"], row["signal"]), []).append(row)
    lines = tuple(
        (
            *key,
            _total(here, "kills") + _total(here, "sent"),
            _total(here, "half_files"),
            _total(here, "failed") if "failed" in here[0] else None,
            _total(here, "different") if "different" in here[0] else None,
            _total(here, "tracebacks") if "tracebacks" in here[0] else None,
            here[0].get("slowest"),
            here[0].get("codes"),
        )
        for key, here in groups.items()
    )
    examples = "; ".join(str(row["examples"]) for row in _of(rows, "faults") if row.get("examples"))
    return Table(
        "Killed and interrupted commands",
        ("command", "signal", "times", "half files", "not recovered", "other results", "tracebacks", "slowest end [s]",
         "exit codes"),
        lines,
        examples or "After a kill every file is opened; in the end the results equal those of a run left alone.",
    )  # fmt: skip
