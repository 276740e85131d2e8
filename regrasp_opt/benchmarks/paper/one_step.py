"""One intermediate pose (Table I, Fig. 6): the share of generated poses that an exact check confirms.

For pairs of poses that share no grasp and that the grid oracle solves with one regrasp, every generator ranks its
poses by cost; S.V. is the share of the K_top cheapest that share a grasp with both ends. Grasps that training never saw
go through the same code.
"""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Literal

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.generation import GENERATORS, NO_GRASP, OneStepTask, distinct, generate
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash
from regrasp_opt.benchmarks.harness.oracle import Oracle
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.benchmarks.paper.published import ONE_STEP, PAPER_OBJECT
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.costs import CostVariant
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.planning import RegraspProblem

TEXT = (
    "Start-goal pairs that share no grasp and that an exact grid search solves with one regrasp. S.V. is the share of"
    " the K_top cheapest generated intermediate poses that, by inverse kinematics and collision checks, share a grasp"
    " with both ends."
)
K_TOP = (200, 100, 50, 10)
PAIRS = {True: 2, False: 10}
"""Pairs an object, in quick and in full runs."""
PER_PLACEMENT = 200
"""Start points for each stable placement; with fewer than K_top, one valid placement could not fill a ranking."""
UNSEEN_SEED = 1

METHODS: dict[str, tuple[Literal["default", "paper"], str, CostVariant]] = {
    "ours J": ("default", "lattice", "J"),
    "Langevin J": ("default", "langevin", "J"),
    "Langevin J+": ("default", "langevin", "J+"),
    "Langevin J^h": ("default", "langevin", "Jh"),
    "paper's preset J": ("paper", "paper", "J"),
}
"""Name of a method: preset of the energy, generator and cost."""

UNSEEN_METHODS = ("ours J", "Langevin J", "paper's preset J")
PICTURED_POSES = 200
"""Grid poses that the picture of a pair shows, about."""


def run_one_step(session: Session) -> Report:
    """Measure S.V. with the grasps of the training."""
    return _run(session, unseen=False)


def run_unseen(session: Session) -> Report:
    """Measure S.V. with grasps that training never saw."""
    return _run(session, unseen=True)


def _run(session: Session, *, unseen: bool) -> Report:
    truth: dict[str, Oracle] = {}
    methods = UNSEEN_METHODS if unseen else tuple(METHODS)

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        oracle = session.oracle(name, problem)
        chosen = session.chosen(name, problem, oracle, {"1": PAIRS[session.quick]}, 10)
        if unseen:
            effector, count = problem.workcell.arm.end_effector, len(problem.grasps)
            grasps = sample_grasps(problem.object, effector, count, seed=UNSEEN_SEED, exclude=problem.grasps)
            problem = RegraspProblem.load(problem.object, problem.workcell, grasps=grasps, model=problem.model_folder)
            oracle = session.oracle(f"{name}, unseen grasps", problem, session.coarse_grid)
        truth[name] = oracle
        items: list[Item] = []
        for pair in chosen:
            pictured = pair is chosen[0]
            known = _grid_rows(problem, pair, oracle, pictured)
            items.append(pair_item(name, problem, pair, _as_they_are, known, label="/grid", method="grid"))
            for method in methods:
                tested = replace(problem, preset=METHODS[method][0])
                arguments = measure_pair, method, session.seed, PER_PLACEMENT, pictured
                items.append(pair_item(name, tested, pair, *arguments, label=f"/{method}", method=method))
        return items, instances_hash(chosen)

    def figures(rows: list[Row], names: list[str]) -> list[Figure]:
        return [Figure(f"Intermediate poses for one pair: {name}", _figure(name, rows)) for name in names]

    heading = ("unseen", "One intermediate pose, unseen grasps") if unseen else ("one-step", "One intermediate pose")
    made = partial(_table, unseen=unseen), partial(_truth_table, truth)
    settings = {"starts per placement": PER_PLACEMENT}
    return run_experiment(session, *heading, TEXT, work, made, figures=figures, settings=settings)


def _grid_rows(problem: RegraspProblem, instance: Instance, oracle: Oracle, pictured: bool) -> list[Row]:
    """Return what the grid says about a pair: the share of its poses that are valid, and some of these."""
    valid = oracle.one_step(*(problem.feasible_grasps(T) for T in instance.ends))
    shown = np.flatnonzero(valid & pictured)[:: max(1, int(valid.sum()) // PICTURED_POSES)]
    poses = _pose_rows(oracle.placements[shown], oracle.xi[shown], valid[shown])
    return [{"share": float(valid.mean())}, *poses]


def _as_they_are(problem: RegraspProblem, instance: Instance, rows: list[Row]) -> list[Row]:
    return rows


def measure_pair(
    problem: RegraspProblem, instance: Instance, method: str, seed: int, starts: int, pictured: bool
) -> list[Row]:
    """Return one row for each K_top: S.V., distinct poses among the K_top, and the time of the generation.

    The `method` of `METHODS` has as many `starts` for each placement; `pictured` asks for a row for each of the
    cheapest poses as well.
    """
    problem = resident(problem)
    task = OneStepTask(problem, problem.energy, instance.ends)
    if not task.possible:
        return [{"skipped": NO_GRASP}]
    _, name, variant = METHODS[method]
    generator = GENERATORS[name]
    options = CostOptions(variant=variant, h=problem.energy.model.threshold)
    if generator.starts == "lattice":
        _ = task.lattice  # it is made once for a problem, and not timed
    began = time.perf_counter()
    found = generate(task, generator, options, starts, np.random.default_rng([seed, 11]))
    seconds = round(time.perf_counter() - began, 3)
    placements, xi = found.placements[: max(K_TOP), 0], found.xi[: max(K_TOP), 0]
    valid = task.verdicts(placements, xi)
    once = {"direct": bool(task.feasible.all(axis=0).any()), "seconds": seconds}
    rows: list[Row] = [
        {"k_top": k, "sv": float(valid[:k].mean()), "distinct": distinct(placements[:k], xi[:k]), **once} for k in K_TOP
    ]
    return rows + (_pose_rows(placements, xi, valid) if pictured else [])


def _pose_rows(placements: IntArray, xi: FloatArray, valid: BoolArray) -> list[Row]:
    return [
        {"placement": int(p), "x": float(x), "y": float(y), "yaw": float(yaw), "valid": bool(v)}
        for p, (x, y, yaw), v in zip(placements, xi, valid, strict=True)
    ]


def _table(rows: list[Row], names: list[str], unseen: bool) -> Table:
    measured = [row for row in rows if "sv" in row]
    solvable = {row["pair"] for row in rows if row.get("share", 0.0) > 0}
    methods = UNSEEN_METHODS if unseen else tuple(METHODS)
    paper_columns = ("paper Usn",) if unseen else ("paper J", "paper J+", "paper J^h")
    lines = []
    for (name, k), here in tables.grouped(measured, "object", "k_top").items():
        counted = [row for row in here if row["pair"] in solvable]
        ours = [percent([row["sv"] for row in counted if row["method"] == method]) for method in methods]
        printed = ONE_STEP.get(PAPER_OBJECT.get(name, ""), {}).get(k, (None,) * 4)
        lines.append((name, k, *ours, *(printed[3:] if unseen else printed[:3])))
    return Table(
        "S.V. on unseen grasps [%]" if unseen else "S.V. by cost and generator [%]",
        ("object", "K_top", *methods, *paper_columns),
        tuple(lines),
        "Ours ranks the lattice poses of each placement; Langevin uses our energy, the paper's optimiser, random "
        "starts and the exact grasps of both ends; the last of our columns is the paper's preset, optimiser and "
        "learned ends, trained on the same data. What exact ends and the exact table rule reach by themselves, with "
        "an energy that knows nothing, is the row 'constant' of the experiment across end-effectors. Paper: its Table "
        "I, on its own grasps and checker. Pairs that the grid cannot solve with one regrasp and these grasps are "
        "left out.",
    )


def _truth_table(truth: dict[str, Oracle], rows: list[Row], names: list[str]) -> Table:
    def least(here: list[Row]) -> float | None:
        return percent(sorted(tables.values(here, "share"))[:1])

    by_name = tables.by_object(rows, truth)
    groups = {(n, *o.feasible.shape): [{"grid": o.seconds}, *by_name[n]] for n, o in truth.items()}
    columns: dict[str, tables.Column] = {
        "pairs": tables.count(lambda row: "share" in row),
        "solvable": tables.count(lambda row: row.get("share", 0) > 0),
        "valid poses [%]": tables.share("share"),
        "least valid [%]": least,
        "grid [CPU s]": tables.average("grid", 1),
    }
    for method in ("ours J", "Langevin J"):
        columns[f"{method[:-2]} [s]"] = tables.middle("seconds", 2, of=lambda row, m=method: row.get("method") == m)
    return tables.summary(
        "Exhaustive grid search",
        ("object", "poses", "grasps"),
        groups,
        columns,
        "Grid poses that are valid intermediate poses, mean and least over the pairs; processor time of the grid, "
        "which is computed once and kept; median time to generate all poses of one pair.",
    )


def _figure(name: str, rows: list[Row]) -> go.Figure:
    """Return the valid grid poses beside the cheapest poses of each method, seen from above, as in Fig. 6."""
    methods = ("grid", *METHODS)
    figure = make_subplots(rows=1, cols=len(methods), subplot_titles=methods, shared_yaxes=True)
    for column, method in enumerate(methods, start=1):
        poses = [r for r in rows if r.get("object") == name and r.get("method") == method and "x" in r]
        for valid, colour in ((True, "#0072b2"), (False, "#d55e00")):
            here = [r for r in poses if r["valid"] is valid]
            angles = [90 - np.degrees(r["yaw"]) for r in here]
            arrows = go.Scatter(
                x=[r["x"] for r in here],
                y=[r["y"] for r in here],
                mode="markers",
                marker={"symbol": "arrow", "size": 8, "angle": angles, "color": colour},
                text=[f"placement {r['placement']}" for r in here],
                hoverinfo="text",
            )
            figure.add_trace(arrows, row=1, col=column)
    figure.update_yaxes(scaleanchor="x")
    figure.update_layout(showlegend=False)
    return tables.labelled(figure, "x [m]", "", 360)
