"""Cross-end-effector evaluation (Table II): a model trained with one tool guides one-step generation with another."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.models import TrainingRequest
from regrasp_opt.benchmarks.harness.oracle import Oracle, Resolution
from regrasp_opt.benchmarks.harness.report import Cell, Figure, Report, Table, mean, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import QUICK_GRID, Session
from regrasp_opt.benchmarks.harness.subjects import problem_key, resident
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
_BLOCK_COLUMNS = ("constant", "trained", "own", "least cell", "below constant", "cells", "paper")
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
    bodies, rows = session.bodies()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    for name, body in list(bodies.items())[: sizes.objects]:
        problems: dict[str, RegraspProblem] = {}
        for effector in sizes.end_effectors:
            try:
                problems[effector] = RegraspProblem.load(body, load_workcell(f"nova2-{effector}"))
            except RegraspError as error:
                rows.append({"object": name, "trained": effector, "tested": effector, "error": str(error)})
        energies = {CONSTANT: constant_energy()} | _energies(session, problems, sizes.samples)
        for tested, problem in problems.items():
            oracle = session.oracle(f"{name}, {tested}", problem, sizes.grid)
            prefix = f"{name}/{tested}"
            pairs = session.chosen(prefix, problem, oracle, {"1": sizes.pairs}, 60)
            hashes[prefix] = instances_hash(pairs)
            depends = problem_key(problem), instances_hash(pairs), oracle.xi, session.seed, K_TOP
            for trained, energy in energies.items():
                key = content_hash(depends[0], energy.fingerprint(), *depends[1:])
                columns: Row = {"object": name, "trained": trained, "tested": tested}
                arguments = (replace(problem), energy, pairs, oracle, session.seed)
                items.append(Item(f"{name}/{trained}/{tested}", key, measure_transfer, arguments, columns))
    results = session.execute("cross-effector", items)
    rows = results.rows + rows
    measured = [name for name in bodies if any(r["object"] == name and "sv" in r for r in rows)]
    tables = tuple(_table(rows, name, sizes.end_effectors) for name in measured)
    return Report(
        "cross-effector",
        "Across end-effectors",
        TEXT,
        (*tables, _blocks(rows)),
        rows,
        tuple(Figure(f"S.V. [%]: {t.title}", _heatmap(t)) for t in tables),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, "pairs": sizes.pairs, "samples": sizes.samples}
        | {"oracle": str(sizes.grid)},
    )


def constant_energy() -> EnergyModel:
    """Return the energy that knows nothing: the same for every pose and grasp."""
    zeros = [np.zeros(shape, np.float32) for shape in ((1, feature_count("tcp", False)), (1, 1), (1, 1))]
    biases = tuple(np.zeros(1, np.float32) for _ in zeros)
    return EnergyModel(tuple(zeros), biases, "silu", "tcp", use_width=False, bounded=True, threshold=1.0)


def _energies(session: Session, problems: dict[str, RegraspProblem], samples: int) -> dict[str, EnergyModel]:
    options = TrainingOptions(use_width=False, seed=session.seed)
    requests = [TrainingRequest(problem, options, samples, session.seed) for problem in problems.values()]
    return dict(zip(problems, session.trained(requests), strict=True))


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


def _cell(rows: list[Row], name: str, trained: str, tested: str) -> float | None:
    wanted = (name, trained, tested)
    return percent([r["sv"] for r in rows if "sv" in r and (r["object"], r["trained"], r["tested"]) == wanted])


def _table(rows: list[Row], name: str, end_effectors: tuple[str, ...]) -> Table:
    printed = CROSS_EFFECTOR.get(PAPER_OBJECT.get(name, ""), {})
    lines: list[tuple[Cell, ...]] = []
    for trained in (CONSTANT, *end_effectors, OWN):
        ours = [_cell(rows, name, tested if trained == OWN else trained, tested) for tested in end_effectors]
        paper = [printed.get(trained, {}).get(tested) for tested in end_effectors] if printed else []
        lines.append((trained, *ours, *paper))
    columns = ("trained", *end_effectors, *(f"paper {tested}" for tested in end_effectors if printed))
    pairs = Counter(row["tested"] for row in rows if row["object"] == name and row.get("trained") == CONSTANT)
    counts = ", ".join(f"{tested} {pairs[tested]}" for tested in end_effectors)
    return Table(name, columns, tuple(lines), f"S.V. [%] of the tested end-effector (column). Pairs: {counts}.")


def _blocks(rows: list[Row]) -> Table:
    """Return the means of the diagonal and of the blocks beside it, with the controls over the same cells."""
    lines: list[tuple[Cell, ...]] = []
    for name in dict.fromkeys(row["object"] for row in rows if "sv" in row):
        printed = CROSS_EFFECTOR.get(PAPER_OBJECT.get(name, ""), {})
        found = {(r["trained"], r["tested"]) for r in rows if r["object"] == name and "sv" in r}
        cells = sorted(cell for cell in found if cell[0] != CONSTANT)
        blocks = {"same tool": [cell for cell in cells if cell[0] == cell[1]]}
        for trained, tested in itertools.product(KINDS, repeat=2):
            inside = [c for c in cells if c[0] in KINDS[trained] and c[1] in KINDS[tested] and c[0] != c[1]]
            blocks[f"{trained} to {tested}"] = inside
        for direction, chosen in blocks.items():
            values = {cell: _cell(rows, name, *cell) or 0.0 for cell in chosen}
            control = {cell: _cell(rows, name, CONSTANT, cell[1]) or 0.0 for cell in chosen}
            own = [_cell(rows, name, tested, tested) or 0.0 for _, tested in chosen]
            below = sum(values[cell] < control[cell] for cell in chosen)
            paper = [printed[a][b] for a, b in chosen if printed]
            means = (mean(list(figures), 1) for figures in (control.values(), values.values(), own))
            lines.append(
                (name, direction, *means, min(values.values(), default=None), below, len(chosen), mean(paper, 1))
            )
    return Table(
        "Means of the blocks",
        ("object", "trained to tested", *_BLOCK_COLUMNS),
        tuple(lines),
        "S.V. [%], means over the same cells: with the constant energy, with that of the trained tool, with the tested "
        "tool's own, and as printed in the paper for the same mesh. Below constant: cells where the trained energy is "
        "worse than the constant one. 'same tool' is the diagonal; the other blocks leave it out.",
    )


def _heatmap(table: Table) -> go.Figure:
    names = [str(row[0]) for row in table.rows]
    tested = list(table.columns[1 : len(names) - 1])
    values = [list(row[1 : 1 + len(tested)]) for row in table.rows]
    figure = go.Figure(go.Heatmap(z=values, x=tested, y=names, zmin=0, zmax=100, texttemplate="%{z}"))
    figure.update_xaxes(title_text="tested")
    figure.update_yaxes(title_text="trained", autorange="reversed")
    figure.update_layout(height=400, width=520, margin={"l": 60, "r": 10, "t": 10, "b": 50})
    return figure
