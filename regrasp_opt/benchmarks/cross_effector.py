"""Cross-end-effector evaluation (Table II): a model trained with one tool guides one-step generation with another."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
import plotly.graph_objects as go

from regrasp_opt.benchmarks.generation import GENERATORS, OneStepTask, generate, verdicts
from regrasp_opt.benchmarks.instances import Instance, choose_instances, instances_hash
from regrasp_opt.benchmarks.models import TrainingRequest, trained_energies
from regrasp_opt.benchmarks.oracle import Resolution
from regrasp_opt.benchmarks.paper import CROSS_EFFECTOR, END_EFFECTORS, PAPER_OBJECT
from regrasp_opt.benchmarks.report import Cell, Figure, Report, Table, mean, percent
from regrasp_opt.benchmarks.runner import Item, Row, progress_bar
from regrasp_opt.benchmarks.session import QUICK_GRID, Session
from regrasp_opt.benchmarks.subjects import problem_key, resident
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.energy.features import feature_count
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.energy.training import TrainingOptions
from regrasp_opt.errors import RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.solvers import PoseLattice
from regrasp_opt.workcell import load_workcell

TEXT = (
    "An energy trained with one end-effector (row) ranks intermediate poses for another (column), on the latter's "
    "grasps: 200 lattice poses for each placement. S.V. is the share of the 100 cheapest that, by the tested tool's "
    "exact check, share a grasp with start and goal. The jaw width is not an input, and all energies see equally many "
    "feasible samples. Pairs are drawn at random from those that an exact grid solves with one regrasp."
    "\n\n"
    "Much of S.V. is not the energy's doing. In every cell the cost has the tested tool's exact feasible grasps at "
    "start and goal and its exact table rule in it, and lattice poses are only ranked: there is no descent in these "
    "tables. The row 'constant' is the control: the same ends, rule and pairs, with an energy that is the same for "
    "every pose and grasp; poses of equal cost come in random order. What the trained energy adds is the difference to "
    "that row, and where it is below, the energy of the other tool does harm. The row 'own' repeats the diagonal, the "
    "energy of the tested tool itself."
)
K_TOP = 100
PER_PLACEMENT = 200
CONSTANT, OWN = "constant", "own"
"""Rows beside those of the trained end-effectors: the control, and the diagonal once more."""
_BLOCK_COLUMNS = ("constant", "trained", "own", "least cell", "below constant", "cells", "paper")
KINDS = {"grippers": END_EFFECTORS[:3], "suction": END_EFFECTORS[3:]}
"""The end-effectors of each kind; a block of the table leads from one kind to one."""


@dataclass(frozen=True)
class Sizes:
    """What a run covers."""

    end_effectors: tuple[str, ...]
    objects: int | None
    pairs: int
    samples: int
    grid: Resolution


QUICK = Sizes(("w", "r85", "s1"), 1, 2, 4_000, Resolution(0.1, 8))
FULL = Sizes(END_EFFECTORS, None, 30, 20_000, QUICK_GRID)


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
            pairs = choose_instances(session.pool(problem), oracle, {"1": sizes.pairs}, session.rng(60), prefix)
            hashes[prefix] = instances_hash(pairs)
            items += [
                _item(name, trained, tested, energy, problem, pairs, session.seed)
                for trained, energy in energies.items()
            ]
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
    with progress_bar(session.quiet) as bar:
        task = bar.add_task("training", total=len(requests))
        energies = trained_energies(
            requests, jobs=session.jobs, progress=lambda done, total: bar.update(task, completed=done, total=total)
        )
    return dict(zip(problems, energies, strict=True))


def _item(
    name: str,
    trained: str,
    tested: str,
    energy: EnergyModel,
    problem: RegraspProblem,
    pairs: list[Instance],
    seed: int,
) -> Item:
    return Item(
        f"{name}/{trained}/{tested}",
        content_hash(problem_key(problem), energy.fingerprint(), instances_hash(pairs), seed, PER_PLACEMENT),
        measure_transfer,
        (replace(problem), energy, pairs, seed),
        {"object": name, "trained": trained, "tested": tested},
    )


def measure_transfer(problem: RegraspProblem, model: EnergyModel, pairs: list[Instance], seed: int) -> list[Row]:
    """Return one row for each pair: S.V. of the poses that the energy `model` generates for `problem`.

    The model sees the TCP poses of the tested grasps as if they were its own tool's: the shift that would put the
    flange at the same place measured worse, because the reach matters less than where the fingers are.
    """
    problem = resident(problem)
    energy = GraspEnergy(model, problem.grasps)
    bounds = problem.workcell.bounds.array
    lattice = PoseLattice.build(energy, problem.placement_poses, bounds, table_rule=problem.table_rule)
    rows = []
    for instance in pairs:
        task = OneStepTask.between(problem, energy, instance.ends)
        rng = np.random.default_rng([seed, 61])
        found = generate(task, GENERATORS["lattice"](), CostOptions(), PER_PLACEMENT, rng, lattice)
        found = found.take(slice(0, K_TOP))
        valid = verdicts(problem.checker, task.poses(found.placements[:, 0], found.xi[:, 0]), task.feasible)
        rows.append({"pair": instance.name, "sv": float(valid.mean())})
    return rows


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
        for block, chosen in blocks.items():
            values = {cell: _cell(rows, name, *cell) or 0.0 for cell in chosen}
            control = {cell: _cell(rows, name, CONSTANT, cell[1]) or 0.0 for cell in chosen}
            own = [_cell(rows, name, tested, tested) or 0.0 for _, tested in chosen]
            below = sum(values[cell] < control[cell] for cell in chosen)
            paper = [printed[a][b] for a, b in chosen if printed]
            means = (mean(list(figures), 1) for figures in (control.values(), values.values(), own))
            lines.append((name, block, *means, min(values.values(), default=None), below, len(chosen), mean(paper, 1)))
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
