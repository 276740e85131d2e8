"""One intermediate pose (Table I, Fig. 6): the share of generated poses that an exact check confirms.

For pairs of poses that share no grasp and that the grid oracle solves with one regrasp, every generator ranks its
poses by cost; S.V. is the share of the K_top cheapest that share a grasp with both ends. ``unseen`` repeats it with
grasps that training never saw.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from regrasp_opt.benchmarks.generation import GENERATORS, OneStepTask, distinct, generate, verdicts
from regrasp_opt.benchmarks.instances import Instance, choose_instances, instances_hash
from regrasp_opt.benchmarks.oracle import PAPER_GRID, Oracle
from regrasp_opt.benchmarks.paper import ONE_STEP, PAPER_OBJECT
from regrasp_opt.benchmarks.report import Figure, Report, Table, percent
from regrasp_opt.benchmarks.runner import Item, Row
from regrasp_opt.benchmarks.session import Session, error_rows, usable
from regrasp_opt.benchmarks.subjects import planning_key, resident
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.costs import CostVariant
from regrasp_opt.conventions import BoolArray
from regrasp_opt.files import content_hash
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.planning import RegraspProblem

K_TOP = (200, 100, 50, 10)
PER_PLACEMENT = 200
UNSEEN_SEED = 1
PAIRS = {True: 3, False: 10}
"""Pairs an object, in quick and in full runs."""

METHODS: dict[str, tuple[str, str, CostVariant]] = {
    "ours J": ("default", "lattice", "J"),
    "Langevin J": ("default", "langevin", "J"),
    "Langevin J+": ("default", "langevin", "J+"),
    "Langevin J^h": ("default", "langevin", "Jh"),
    "paper's preset J": ("paper", "paper", "J"),
}
"""Name of a method: preset of the energy, generator and cost."""

UNSEEN_METHODS = ("ours J", "Langevin J", "paper's preset J")
_PICTURED = ("ours J", "Langevin J", "Langevin J+", "Langevin J^h")


def run_one_step(session: Session, *, unseen: bool = False) -> Report:
    """Measure S.V. with the grasps of the training, or with `unseen` ones."""
    subjects = session.subjects()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    truth: dict[str, Oracle] = {}
    pairs: dict[str, tuple[RegraspProblem, Instance]] = {}
    for name, problem in usable(subjects):
        oracle = session.oracle(name, problem, None if session.quick else PAPER_GRID)
        rng = session.rng(10)
        chosen = choose_instances(session.pool(problem), oracle, {"1": PAIRS[session.quick]}, rng, name)
        truth[name], hashes[name] = oracle, instances_hash(chosen)
        tested = _with_unseen_grasps(problem) if unseen else problem
        for instance in chosen:
            pairs.setdefault(name, (problem, instance))
            items += _items(name, tested, instance, oracle if not unseen else None, session, unseen)
    experiment = "unseen" if unseen else "one-step"
    results = session.execute(experiment, items)
    rows = results.rows + error_rows(subjects)
    tables = [_table(rows, unseen)]
    figures: list[Figure] = []
    if not unseen:
        tables.append(_truth_table(truth, rows))
        figures = [Figure(f"Intermediate poses for one pair: {n}", _figure(*pairs[n], truth[n])) for n in pairs]
    return Report(
        experiment,
        "One intermediate pose, unseen grasps" if unseen else "One intermediate pose",
        __doc__.split("\n\n", 1)[1].replace("\n", " ").strip(),
        tuple(tables),
        rows,
        tuple(figures),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, "starts per placement": PER_PLACEMENT},
    )


def _with_unseen_grasps(problem: RegraspProblem) -> RegraspProblem:
    unseen = sample_grasps(
        problem.object,
        problem.workcell.end_effector,
        len(problem.grasps),
        seed=UNSEEN_SEED,
        exclude=problem.grasps,
    )
    return RegraspProblem.load(problem.object, problem.workcell, grasps=unseen, model=problem.model_folder)


def _items(
    name: str, problem: RegraspProblem, instance: Instance, oracle: Oracle | None, session: Session, unseen: bool
) -> list[Item]:
    depends = content_hash(
        planning_key(problem), instances_hash([instance]), session.seed, PER_PLACEMENT, str(session.grid)
    )
    share = None
    if oracle is not None:
        start, goal = (problem.feasible_grasps(T) for T in (instance.start, instance.goal))
        share = float(oracle.one_step(start, goal).mean())
    return [
        Item(
            f"{instance.name}/{method}",
            depends,
            measure_pair,
            (_bare(problem, METHODS[method][0]), instance, method, session.seed),
            {"object": name, "pair": instance.name, "method": method, "grid_share": share},
        )
        for method in (UNSEEN_METHODS if unseen else METHODS)
    ]


def _bare(problem: RegraspProblem, preset: Any) -> RegraspProblem:
    """Return `problem` with the energy of `preset`, without the heavy parts that may be attached."""
    return RegraspProblem(
        problem.object, problem.workcell, problem.grasps, problem.placements, problem.model_folder, preset
    )


def measure_pair(problem: RegraspProblem, instance: Instance, method: str, seed: int) -> list[Row]:
    """Return one row for each K_top: S.V., distinct poses among the K_top, and the time of the generation."""
    problem = resident(problem)
    task = _task(problem, instance)
    if not task.feasible.any(axis=1).all():
        return [{"skipped": "no grasp of this set is feasible at one of the ends"}]
    began = time.perf_counter()
    found = _generate(problem, task, method, seed)
    seconds = time.perf_counter() - began
    top = found.take(slice(0, max(K_TOP)))
    placements, xi = top.placements[:, 0], top.xi[:, 0]
    valid = verdicts(problem.checker, task.poses(placements, xi), task.feasible)
    direct = bool(task.feasible.all(axis=0).any())
    return [
        {
            "k_top": k,
            "sv": float(valid[:k].mean()),
            "distinct": distinct(placements[:k], xi[:k]),
            "direct": direct,
            "seconds": round(seconds, 3),
        }
        for k in K_TOP
    ]


def _task(problem: RegraspProblem, instance: Instance) -> OneStepTask:
    ends = np.stack([instance.start, instance.goal])
    feasible: BoolArray = np.array([problem.feasible_grasps(T) for T in ends])
    return OneStepTask(problem.energy, problem.placement_poses, problem.workcell.bounds.array, ends, feasible)


def _generate(problem: RegraspProblem, task: OneStepTask, method: str, seed: int) -> Any:
    _, name, variant = METHODS[method]
    generator = GENERATORS[name]()
    options = CostOptions(variant=variant, h=problem.energy.model.threshold)
    lattice = problem.lattice if generator.starts == "lattice" else None
    return generate(task, generator, options, PER_PLACEMENT, np.random.default_rng([seed, 11]), lattice)


def _table(rows: list[Row], unseen: bool) -> Table:
    measured = [row for row in rows if "sv" in row]
    methods = UNSEEN_METHODS if unseen else tuple(METHODS)
    paper_columns = ("paper Usn",) if unseen else ("paper J", "paper J+", "paper J^h")
    lines = []
    for name in dict.fromkeys(row["object"] for row in measured):
        for k in K_TOP:
            here = [row for row in measured if row["object"] == name and row["k_top"] == k]
            printed = ONE_STEP[PAPER_OBJECT[name]][k] if name in PAPER_OBJECT else None
            paper = (None,) * len(paper_columns) if printed is None else printed[3:] if unseen else printed[:3]
            ours = [percent([row["sv"] for row in here if row["method"] == method]) for method in methods]
            lines.append((name, k, *ours, *paper))
    return Table(
        "S.V. on unseen grasps [%]" if unseen else "S.V. by cost and generator [%]",
        ("object", "K_top", *methods, *paper_columns),
        tuple(lines),
        "Ours ranks the lattice poses of each placement; Langevin uses our energy, the paper's optimiser, random starts "
        "and the exact grasps of both ends; the last of our columns is the paper's preset, optimiser and learned ends, "
        "trained on the same data. Paper: its Table I, on its own grasps and checker.",
    )


def _truth_table(truth: dict[str, Oracle], rows: list[Row]) -> Table:
    lines = []
    for name, oracle in truth.items():
        shares = {row["pair"]: row["grid_share"] for row in rows if row.get("object") == name and "grid_share" in row}
        times = {
            method: [row["seconds"] for row in rows if row.get("object") == name and row.get("method") == method
                     and "seconds" in row]
            for method in ("ours J", "Langevin J")
        }  # fmt: skip
        lines.append(
            (
                name,
                len(oracle.placements),
                len(oracle.feasible[0]),
                percent(list(shares.values())),
                percent([min(shares.values(), default=0.0)]),
                round(oracle.seconds, 1),
                *(round(float(np.median(t)), 2) if t else None for t in times.values()),
            )
        )
    return Table(
        "Exhaustive grid search",
        ("object", "poses", "grasps", "valid poses [%]", "least valid [%]", "grid [CPU s]", "ours [s]", "Langevin [s]"),
        tuple(lines),
        "Grid poses that are valid intermediate poses, mean and least over the pairs; processor time of the grid, which "
        "is computed once and kept; median time to generate all poses of one pair.",
    )


def _figure(problem: RegraspProblem, instance: Instance, oracle: Oracle) -> go.Figure:
    """Return the valid grid poses beside the poses of each cost, seen from above, as in Fig. 6."""
    problem = resident(problem)
    task = _task(problem, instance)
    figure = make_subplots(
        rows=1, cols=1 + len(_PICTURED), subplot_titles=["ground truth", *_PICTURED], shared_yaxes=True
    )
    mask = oracle.one_step(task.feasible[0], task.feasible[1])
    thin = np.flatnonzero(mask)[:: max(1, int(mask.sum()) // 400)]
    figure.add_trace(_arrows(oracle.xi[thin], oracle.placements[thin]), row=1, col=1)
    for column, method in enumerate(_PICTURED, start=2):
        found = _generate(problem, task, method, 0).take(slice(0, 200))
        figure.add_trace(_arrows(found.xi[:, 0], found.placements[:, 0]), row=1, col=column)
    low, high = problem.workcell.bounds.array
    figure.update_xaxes(range=[low[0], high[0]], title_text="x [m]")
    figure.update_yaxes(range=[low[1], high[1]], scaleanchor="x")
    figure.update_layout(height=360, showlegend=False, margin={"l": 50, "r": 10, "t": 40, "b": 40})
    return figure


def _arrows(xi: Any, placements: Any) -> go.Scatter:
    return go.Scatter(
        x=xi[:, 0],
        y=xi[:, 1],
        mode="markers",
        marker={
            "symbol": "arrow",
            "size": 8,
            "angle": 90 - np.degrees(xi[:, 2]),
            "color": placements,
            "colorscale": "Turbo",
        },
        text=[f"placement {p}" for p in placements],
    )
