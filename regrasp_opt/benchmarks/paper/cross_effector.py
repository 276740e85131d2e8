"""Cross-end-effector evaluation (Table II): a model trained with one tool guides one-step generation with another."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.oracle import Oracle, Resolution
from regrasp_opt.benchmarks.harness.report import Cell, Report, Table, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import QUICK_GRID, Session, run_experiment
from regrasp_opt.benchmarks.harness.subjects import TrainingRequest, problem_key, resident
from regrasp_opt.benchmarks.paper.published import CROSS_EFFECTOR, END_EFFECTORS, PAPER_OBJECT
from regrasp_opt.connectivity import CostOptions, block, exact_energy
from regrasp_opt.conventions import BoolArray, FloatArray, planar_transform
from regrasp_opt.energy.features import feature_count
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.energy.training import TrainingOptions
from regrasp_opt.errors import RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.scene import load_workcell

TEXT = (
    "An energy trained with one end-effector (row) ranks intermediate poses for another (column), on the latter's "
    "grasps: all poses of a grid, as they are. S.V. is the share of the 100 cheapest that, by the tested tool's exact "
    "check, share a grasp with start and goal. The jaw width is not an input, and all energies see equally many "
    "feasible samples. Pairs are drawn at random from those that the grid solves with one regrasp."
    "\n\n"
    "Much of S.V. is not the energy's doing. In every cell the cost has the tested tool's exact feasible grasps at "
    "start and goal and its exact table rule in it, and poses are only ranked: no descent is in these tables. The "
    "row 'constant' is the control: the same ends, rule and pairs, with an energy that is the same for every pose and "
    "grasp; poses of equal cost come in random order. What the trained energy adds is the difference to that row, and "
    "where it is below, the energy of the other tool does harm. The row 'own' repeats the diagonal, the energy of the "
    "tested tool itself."
)
K_TOP = 100
CONSTANT, OWN = "constant", "own"
"""Rows beside those of the trained end-effectors: the control, and the diagonal once more."""
KINDS = {"grippers": END_EFFECTORS[:3], "suction": END_EFFECTORS[3:]}
"""The end-effectors of each kind; a block of the table leads from one kind to one."""


@dataclass(frozen=True)
class TransferSizes:
    """What a run covers."""

    end_effectors: tuple[str, ...]
    objects: int | None
    pairs: int
    samples: int
    grid: Resolution


QUICK = TransferSizes(("w", "r85", "s1"), 1, 2, 4_000, Resolution(0.1, 8))
FULL = TransferSizes(END_EFFECTORS, None, 50, 20_000, QUICK_GRID)


def run_cross_effector(session: Session) -> Report:
    """Measure S.V. for every pair of a trained and a tested end-effector."""
    sizes = QUICK if session.quick else FULL

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        problems, items, frozen = {}, [], []
        for effector in sizes.end_effectors:
            try:
                problems[effector] = RegraspProblem.load(problem.object, load_workcell(f"nova2-{effector}"))
            except RegraspError as error:
                columns: Row = {"object": name, "trained": effector, "tested": effector}
                items.append(Item(f"{name}/{effector}", "", _refused, (str(error),), columns))
        options = TrainingOptions(use_width=False, seed=session.seed)
        requests = [TrainingRequest(candidate, options, sizes.samples) for candidate in problems.values()]
        trained_ones = zip(problems, session.trained(requests), strict=True)
        energies = {CONSTANT: constant_energy(), **dict(trained_ones)}
        for tested, candidate in problems.items():
            oracle = session.oracle(f"{name}, {tested}", candidate, sizes.grid)
            pairs = session.chosen(f"{name}/{tested}", candidate, oracle, {"1": sizes.pairs}, 60)
            frozen += pairs
            depends = problem_key(candidate), instances_hash(pairs), oracle.xi, session.seed, K_TOP
            for trained, energy in energies.items():
                key = content_hash(depends[0], energy.fingerprint(), *depends[1:])
                columns = {"object": name, "trained": trained, "tested": tested}
                arguments = (replace(candidate), energy, pairs, oracle, session.seed)
                items.append(Item(f"{name}/{trained}/{tested}", key, measure_transfer, arguments, columns))
        return items, instances_hash(frozen)

    def tables_of(rows: list[Row], names: list[str]) -> list[Table]:
        measured = [name for name in names if any(r["object"] == name and "sv" in r for r in rows)]
        return [_table(rows, name, sizes.end_effectors) for name in measured]

    settings = {"pairs": sizes.pairs, "samples": sizes.samples, "oracle": str(sizes.grid)}
    heading, made = ("cross-effector", "Across end-effectors", TEXT), (tables_of, _blocks)
    return run_experiment(session, *heading, work, made, settings=settings, most=sizes.objects)


def _refused(reason: str) -> list[Row]:
    raise RegraspError(reason)


def constant_energy() -> EnergyModel:
    """Return the energy that knows nothing: the same for every pose and grasp."""
    zeros = [np.zeros(shape, np.float32) for shape in ((1, feature_count("tcp", False)), (1, 1), (1, 1))]
    biases = tuple(np.zeros(1, np.float32) for _ in zeros)
    return EnergyModel(tuple(zeros), biases, "silu", "tcp", use_width=False, bounded=True, threshold=1.0)


def measure_transfer(
    problem: RegraspProblem, model: EnergyModel, pairs: list[Instance], oracle: Oracle, seed: int
) -> list[Row]:
    """Return one row for each pair: S.V. of the grid poses that are cheapest by the energy `model` for `problem`.

    The model sees the TCP poses of the tested grasps as if they were its own tool's: the shift that would put the
    flange at the same place measured worse, because the reach matters less than where the fingers are.
    """
    problem, rng = resident(problem), np.random.default_rng([seed, 61])
    feasible = np.array([[problem.feasible_grasps(T) for T in pair.ends] for pair in pairs])
    costs = bridge_costs(problem, GraspEnergy(model, problem.grasps), oracle, feasible)
    rows = []
    for pair, ends, cost in zip(pairs, feasible, costs, strict=True):
        mixed = rng.permutation(len(cost))  # ties in random order, or they would come from one corner of the workspace
        cheapest = mixed[np.argsort(cost[mixed], kind="stable")[:K_TOP]]
        rows.append({"pair": pair.name, "sv": float(oracle.one_step(*ends)[cheapest].mean())})
    return rows


def bridge_costs(problem: RegraspProblem, energy: GraspEnergy, oracle: Oracle, feasible: BoolArray) -> FloatArray:
    """Return ``J_seq`` (B, L) of each grid pose between exact ends `feasible` (B, 2, G), with the table rule."""
    options, poses = CostOptions(), planar_transform(oracle.xi) @ problem.placement_poses[oracle.placements]
    energies = block(energy(poses, np.float32), problem.table_rule(oracle.placements, oracle.xi))
    P, ends = (np.exp(-np.asarray(e, dtype=np.float64) / options.alpha) for e in (energies, exact_energy(feasible)))
    Q = -options.alpha * np.log(ends @ P.T)  # (B, 2, L), Eq. 4 as an inner product
    return np.asarray(Q.sum(axis=1) + options.regularisation * (Q[:, 0] - Q[:, 1]) ** 2)


def _cells(rows: list[Row], name: str) -> dict[tuple[str, str], float]:
    """Return S.V. [%] by trained and tested end-effector."""
    groups = tables.grouped((row for row in rows if "sv" in row and row["object"] == name), "trained", "tested")
    return {(trained, tested): percent(tables.values(here, "sv")) or 0.0 for (trained, tested), here in groups.items()}


def _table(rows: list[Row], name: str, end_effectors: tuple[str, ...]) -> Table:
    printed, cells = CROSS_EFFECTOR.get(PAPER_OBJECT.get(name, ""), {}), _cells(rows, name)
    lines: list[tuple[Cell, ...]] = []
    for trained in (CONSTANT, *end_effectors, OWN):
        ours = [cells.get((tested if trained == OWN else trained, tested)) for tested in end_effectors]
        paper = [printed.get(trained, {}).get(tested) for tested in end_effectors] if printed else []
        lines.append((trained, *ours, *paper))
    columns = ("trained", *end_effectors, *(f"paper {tested}" for tested in end_effectors if printed))
    pairs = Counter(row["tested"] for row in rows if row["object"] == name and row.get("trained") == CONSTANT)
    counts = ", ".join(f"{tested} {pairs[tested]}" for tested in end_effectors)
    return Table(name, columns, tuple(lines), f"S.V. [%] of the tested end-effector (column). Pairs: {counts}.")


def _blocks(rows: list[Row], names: list[str]) -> Table:
    """Return the means of the diagonal and of the blocks beside it, with the controls over the same cells."""
    groups: dict[tuple[str, str], list[Row]] = {}
    kind = {tool: name for name, tools in KINDS.items() for tool in tools}
    for name in dict.fromkeys(row["object"] for row in rows if "sv" in row):
        printed, cells = CROSS_EFFECTOR.get(PAPER_OBJECT.get(name, ""), {}), _cells(rows, name)
        directions = (f"{trained} to {tested}" for trained, tested in itertools.product(KINDS, repeat=2))
        groups |= {(name, direction): [] for direction in ("same tool", *directions)}
        for (trained, tested), sv in sorted(cells.items()):
            if trained != CONSTANT:
                direction = "same tool" if trained == tested else f"{kind[trained]} to {kind[tested]}"
                others = {key: cells.get((tool, tested), 0.0) for key, tool in ((CONSTANT, CONSTANT), (OWN, tested))}
                paper = printed[trained][tested] if printed else None
                groups[name, direction].append({"trained": sv, **others, "paper": paper})
    columns: dict[str, tables.Column] = {key: tables.average(key, 1) for key in ("constant", "trained", "own")}
    columns |= {
        "least cell": lambda here: min(tables.values(here, "trained"), default=None),
        "below constant": tables.count(lambda row: row["trained"] < row["constant"]),
        "cells": len,
        "paper": tables.average("paper", 1),
    }
    return tables.summary(
        "Means of the blocks",
        ("object", "trained to tested"),
        groups,
        columns,
        "S.V. [%], means over the same cells: with the constant energy, with that of the trained tool, with the tested "
        "tool's own, and as printed in the paper for the same mesh. Below constant: cells where the trained energy is "
        "worse than the constant one. 'same tool' is the diagonal; the other blocks leave it out.",
    )
