"""Hard tiers: instances sorted by the fewest regrasps that an exact grid needs, made rare on purpose.

Few grasps, obstacles on the table and a narrow workspace make pairs that need two, three or more regrasps, and pairs
that cannot be solved on the grid at all; of these the planner must say so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import TIERS, Instance, choose_instances, instances_hash
from regrasp_opt.benchmarks.harness.oracle import Resolution
from regrasp_opt.benchmarks.harness.planners import plan_row, solvable, solved_by_both
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.conventions import IntArray, translation
from regrasp_opt.errors import RegraspError
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
class TierSizes:
    """How many instances: grasps in a subset, subsets of each size, pairs of a tier from one condition and in all.

    The other workcells have one subset of each size.
    """

    grasps: tuple[int, ...]
    subsets: int
    workcells: bool
    each: dict[str, int]
    most: dict[str, int]


QUICK = TierSizes((12,), 2, False, dict.fromkeys(TIERS, 1), {"1": 1, "2": 2, "3+": 2, "unsolvable": 1})
FULL = TierSizes(
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
    small = WorkspaceBounds((x - 0.1, x + 0.1), (y - 0.1, y + 0.1))
    return replace(cell.within(small), name=f"{cell.name}, narrow")


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


def conditions(session: Session, problem: RegraspProblem, sizes: TierSizes) -> Iterator[Condition]:
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
        whole = session.oracle(f"{name}, {condition.label}", condition.problem, condition.grid)
        oracle = whole.with_grasps(condition.ids)
        pool = session.pool(condition.problem).with_grasps(condition.ids)
        for tier, count in sizes.each.items():
            prefix = f"{name}/{condition.label}"
            chosen = choose_instances(pool, oracle, {tier: count}, session.rng(31, number), prefix)
            found[tier] += [(rank, condition, instance) for rank, instance in enumerate(chosen)]
    spread = {tier: sorted(triples, key=lambda triple: triple[0]) for tier, triples in found.items()}
    return [triple[1:] for tier, triples in spread.items() for triple in triples[: sizes.most[tier]]]


def run_hard_tiers(session: Session) -> Report:
    """Measure success, N and time by tier."""

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        pairs = hard_instances(session, name, problem)
        end = "ipopt from lattice", session.seed, TIME_LIMIT
        items = [pair_item(name, c.reduced, pair, plan_row, *end, condition=c.label) for c, pair in pairs]
        return items, instances_hash([pair for _, pair in pairs])

    settings = {"oracle": str(session.grid), "time limit [s]": TIME_LIMIT}
    return run_experiment(session, "hard-tiers", "Hard tiers", TEXT, work, (_table, _failures), settings=settings)


def _table(rows: list[Row], names: list[str]) -> Table:
    measured = [row for row in rows if "solved" in row]
    found = tables.grouped(measured, "object", "tier")
    groups = {(n, tier): found.get((n, tier), []) for n in dict.fromkeys(n for n, _ in found) for tier in TIERS}
    columns = {
        "pairs": len,
        "solved [%]": tables.share("solved"),
        "N as oracle [%]": tables.share(lambda row: row["num_regrasps"] == row["minimum"], of=solved_by_both),
        "N below it [%]": tables.share(lambda row: row["num_regrasps"] < row["minimum"], of=solved_by_both),
        "solved [s]": tables.average("seconds", of="solved"),
        "gave up [s]": tables.average("seconds", of=lambda row: not row["solved"]),
    }
    return tables.summary(
        "Success by the oracle's fewest regrasps",
        ("object", "oracle N"),
        groups,
        columns,
        "Plans of the tier 'unsolvable', and plans with fewer regrasps, are what the continuous planner finds between"
        " the poses of the grid. Shares of N are of the verified plans; times are means.",
    )


def _failures(rows: list[Row], names: list[str]) -> Table:
    bad = [row for row in rows if solvable(row) and not row["solved"]]
    columns = {"pair": "pair", "oracle N": "minimum", "status": "status", "seconds": "seconds"}
    return tables.listing("Solvable instances without a plan", bad, columns)
