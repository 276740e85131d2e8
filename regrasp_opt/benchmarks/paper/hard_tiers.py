"""Hard tiers: instances sorted by the fewest regrasps that an exact grid needs, made rare on purpose.

Few grasps, obstacles on the table and a narrow workspace make pairs that need two, three or more regrasps, and pairs
that cannot be solved on the grid at all; of these the planner must say so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from regrasp_opt.benchmarks.harness.instances import TIERS, Instance, choose_instances, instances_hash
from regrasp_opt.benchmarks.harness.oracle import Resolution
from regrasp_opt.benchmarks.harness.planners import plan_row
from regrasp_opt.benchmarks.harness.report import Cell, Report, Table, mean, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, error_rows, usable
from regrasp_opt.benchmarks.harness.subjects import planning_key
from regrasp_opt.conventions import IntArray, translation
from regrasp_opt.errors import RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.scene import Workcell, WorkspaceBounds

TEXT = (
    "Instances by the fewest regrasps on the exact grid, from subsets of the grasps, a table with obstacles and a "
    "narrow workspace. 'unsolvable' means at the resolution of the grid: a continuous planner may still find a plan."
)
TIME_LIMIT = 120.0
"""Seconds after which the planner gives up."""


@dataclass(frozen=True)
class Sizes:
    """How many instances: grasps in a subset, subsets of each size, pairs of a tier from one condition and in all.

    The other workcells have one subset of each size.
    """

    grasps: tuple[int, ...]
    subsets: int
    workcells: bool
    each: dict[str, int]
    most: dict[str, int]


QUICK = Sizes((12,), 2, False, dict.fromkeys(TIERS, 1), {"1": 1, "2": 2, "3+": 2, "unsolvable": 1})
FULL = Sizes(
    (8, 12, 16, 20, 30),
    4,
    True,
    {"1": 1, "2": 6, "3+": 12, "unsolvable": 1},
    {"1": 20, "2": 60, "3+": 60, "unsolvable": 10},
)


def with_obstacles(cell: Workcell) -> Workcell:
    """Return `cell` with a wall and two posts on the table."""
    boxes = (
        Box("wall", np.array([0.02, 0.30, 0.15]), translation(0.0, 0.45, cell.table.height + 0.075)),
        Box("left post", np.array([0.05, 0.05, 0.25]), translation(-0.30, 0.35, cell.table.height + 0.125)),
        Box("right post", np.array([0.05, 0.05, 0.25]), translation(0.30, 0.35, cell.table.height + 0.125)),
    )
    return replace(cell, name=f"{cell.name} with obstacles", obstacles=(*cell.obstacles, *boxes))


def narrowed(cell: Workcell) -> Workcell:
    """Return `cell` with its workspace shrunk to 0.2 m by 0.2 m, off its middle."""
    (x_low, x_high), (y_low, y_high) = cell.bounds.x, cell.bounds.y
    x, y = 0.25 * x_low + 0.75 * x_high, (y_low + y_high) / 2
    return replace(cell, name=f"{cell.name}, narrow", bounds=WorkspaceBounds((x - 0.1, x + 0.1), (y - 0.1, y + 0.1)))


@dataclass(frozen=True, eq=False)
class Condition:
    """One way to make pairs hard: the problem of all grasps in its workcell, the oracle's grid, the grasps left."""

    label: str
    problem: RegraspProblem
    grid: Resolution
    ids: IntArray

    @property
    def reduced(self) -> RegraspProblem:
        """The problem with the grasps that are left."""
        return replace(self.problem, grasps=self.problem.grasps.subset(self.ids))


def conditions(session: Session, problem: RegraspProblem, sizes: Sizes) -> Iterator[Condition]:
    """Yield the conditions for one object; a workcell for which no model can be prepared is left out."""
    problems = [("table", problem, session.grid)]
    if sizes.workcells:
        for label, cell, grid in (
            ("obstacles", with_obstacles(problem.workcell), session.coarse_grid),
            ("narrow", narrowed(problem.workcell), session.grid),
        ):
            try:
                problems.append((label, session.prepared(problem, cell), grid))
            except RegraspError:
                continue
    for number, (label, candidate, grid) in enumerate(problems):
        count = len(candidate.grasps)
        if number > 0:
            yield Condition(f"{label}, {count} grasps", candidate, grid, np.arange(count))
        for size in sizes.grasps:
            for repeat in range(sizes.subsets if number == 0 else 1):
                ids = np.sort(session.rng(30, number, size, repeat).permutation(count)[:size])
                yield Condition(f"{label}, {size} grasps, set {repeat}", candidate, grid, ids)


def hard_instances(session: Session, name: str, problem: RegraspProblem) -> list[tuple[Condition, Instance]]:
    """Return the instances of all tiers for one object, spread over the conditions."""
    sizes = QUICK if session.quick else FULL
    found: dict[str, list[tuple[int, Condition, Instance]]] = {tier: [] for tier in TIERS}
    for number, condition in enumerate(conditions(session, problem, sizes)):
        oracle = session.oracle(f"{name}, {condition.label}", condition.problem, condition.grid).with_grasps(
            condition.ids
        )
        pool = session.pool(condition.problem).with_grasps(condition.ids)
        for tier, count in sizes.each.items():
            prefix = f"{name}/{condition.label}"
            chosen = choose_instances(pool, oracle, {tier: count}, session.rng(31, number), prefix)
            found[tier] += [(rank, condition, instance) for rank, instance in enumerate(chosen)]
    instances = []
    for tier, triples in found.items():
        spread = sorted(triples, key=lambda triple: triple[0])[: sizes.most[tier]]
        instances += [(condition, instance) for _, condition, instance in spread]
    return instances


def run_hard_tiers(session: Session) -> Report:
    """Measure success, N and time by tier."""
    subjects = session.subjects()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    for name, problem in usable(subjects):
        pairs = hard_instances(session, name, problem)
        hashes[name] = instances_hash([instance for _, instance in pairs])
        for condition, instance in pairs:
            reduced = condition.reduced
            depends = content_hash(planning_key(reduced), instances_hash([instance]), session.seed, TIME_LIMIT)
            columns: Row = {"object": name, "pair": instance.name, "condition": condition.label}
            arguments = (replace(reduced), instance, "ipopt from lattice", session.seed, TIME_LIMIT)
            items.append(Item(instance.name, depends, plan_row, arguments, columns))
    results = session.execute("hard-tiers", items)
    rows = results.rows + error_rows(subjects)
    return Report(
        "hard-tiers",
        "Hard tiers",
        TEXT,
        (_table(rows), _failures(rows)),
        rows,
        (),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, "oracle": str(session.grid), "time limit [s]": TIME_LIMIT},
    )


def _table(rows: list[Row]) -> Table:
    measured = [row for row in rows if "solved" in row]
    lines: list[tuple[Cell, ...]] = []
    for name in dict.fromkeys(row["object"] for row in measured):
        for tier in TIERS:
            here = [row for row in measured if (row["object"], row["tier"]) == (name, tier)]
            good = [row for row in here if row["solved"]]
            known = [row for row in good if row["minimum"] is not None]
            lines.append(
                (
                    name,
                    tier,
                    len(here),
                    percent([row["solved"] for row in here]),
                    percent([row["num_regrasps"] == row["minimum"] for row in known]),
                    percent([row["num_regrasps"] < row["minimum"] for row in known]),
                    mean([row["seconds"] for row in good]),
                    mean([row["seconds"] for row in here if not row["solved"]]),
                )
            )
    return Table(
        "Success by the oracle's fewest regrasps",
        ("object", "oracle N", "pairs", "proved [%]", "N as oracle [%]", "N below it [%]", "solved [s]", "gave up [s]"),
        tuple(lines),
        "Plans of the tier 'unsolvable', and plans with fewer regrasps, are what the continuous planner finds between"
        " the poses of the grid. Shares of N are of the proved plans; times are means.",
    )


def _failures(rows: list[Row]) -> Table:
    bad = [row for row in rows if "solved" in row and row["minimum"] is not None and not row["solved"]]
    lines = tuple((row["pair"], row["minimum"], row["status"], row["seconds"]) for row in bad)
    note = "" if lines else "There are none."
    return Table("Solvable instances without a plan", ("pair", "oracle N", "status", "seconds"), lines, note)
