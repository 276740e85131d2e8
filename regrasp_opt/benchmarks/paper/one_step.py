"""One intermediate pose (Table I, Fig. 6): the share of generated poses that an exact check confirms.

For pairs of poses that share no grasp and that the grid oracle solves with one regrasp, every generator ranks its
poses by cost; S.V. is the share of the K_top cheapest that share a grasp with both ends. Grasps that training never saw
go through the same code.
"""

from __future__ import annotations

import time
from dataclasses import replace
from statistics import median
from typing import Literal

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from regrasp_opt.benchmarks.harness.generation import GENERATORS, OneStepTask, distinct, generate, verdicts
from regrasp_opt.benchmarks.harness.instances import Instance, choose_instances, instances_hash
from regrasp_opt.benchmarks.harness.oracle import Oracle
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, error_rows, usable
from regrasp_opt.benchmarks.harness.subjects import planning_key, problem_key, resident
from regrasp_opt.benchmarks.paper.published import ONE_STEP, PAPER_OBJECT
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.costs import CostVariant
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.files import content_hash
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
    subjects = session.subjects()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    truth: dict[str, Oracle] = {}
    for name, problem in usable(subjects):
        oracle = session.oracle(name, problem)
        rng = session.rng(10)
        chosen = choose_instances(session.pool(problem), oracle, {"1": PAIRS[session.quick]}, rng, name)
        if unseen:
            problem = _with_unseen_grasps(problem)
            oracle = session.oracle(f"{name}, unseen grasps", problem, session.coarse_grid)
        truth[name], hashes[name] = oracle, instances_hash(chosen)
        methods = UNSEEN_METHODS if unseen else tuple(METHODS)
        for instance in chosen:
            items += _items(name, problem, instance, oracle, session.seed, methods, instance is chosen[0])
    experiment = "unseen" if unseen else "one-step"
    results = session.execute(experiment, items)
    rows = results.rows + error_rows(subjects)
    return Report(
        experiment,
        "One intermediate pose, unseen grasps" if unseen else "One intermediate pose",
        TEXT,
        (_table(rows, unseen), _truth_table(truth, rows)),
        rows,
        tuple(Figure(f"Intermediate poses for one pair: {name}", _figure(name, rows)) for name in truth),
        hashes,
        results.revisions,
        {"quick": session.quick, "seed": session.seed, "starts per placement": PER_PLACEMENT},
    )


def _with_unseen_grasps(problem: RegraspProblem) -> RegraspProblem:
    unseen = sample_grasps(
        problem.object,
        problem.workcell.arm.end_effector,
        len(problem.grasps),
        seed=UNSEEN_SEED,
        exclude=problem.grasps,
    )
    return RegraspProblem.load(problem.object, problem.workcell, grasps=unseen, model=problem.model_folder)


def _items(
    name: str,
    problem: RegraspProblem,
    instance: Instance,
    oracle: Oracle,
    seed: int,
    methods: tuple[str, ...],
    pictured: bool,
) -> list[Item]:
    """Return the work on one pair: what the grid says about it, and every method."""
    columns: Row = {"object": name, "pair": instance.name}
    start, goal = (problem.feasible_grasps(T) for T in (instance.start, instance.goal))
    valid = oracle.one_step(start, goal)
    shown = np.flatnonzero(valid & pictured)[:: max(1, int(valid.sum()) // PICTURED_POSES)]
    poses = _pose_rows(oracle.placements[shown], oracle.xi[shown], valid[shown])
    grid_rows: list[Row] = [{"share": float(valid.mean())}, *poses]
    key = content_hash(problem_key(problem), instances_hash([instance]), oracle.xi, pictured)
    items = [Item(f"{instance.name}/grid", key, _as_they_are, (grid_rows,), {**columns, "method": "grid"})]
    for method in methods:
        tested = replace(problem, preset=METHODS[method][0])
        key = content_hash(planning_key(tested), instances_hash([instance]), seed, PER_PLACEMENT, pictured)
        arguments = (replace(tested), instance, method, seed, PER_PLACEMENT, pictured)
        items.append(Item(f"{instance.name}/{method}", key, measure_pair, arguments, {**columns, "method": method}))
    return items


def _as_they_are(rows: list[Row]) -> list[Row]:
    return rows


def measure_pair(
    problem: RegraspProblem, instance: Instance, method: str, seed: int, starts: int, pictured: bool
) -> list[Row]:
    """Return one row for each K_top: S.V., distinct poses among the K_top, and the time of the generation.

    Parameters
    ----------
    method : str
        One of `METHODS`.
    starts : int
        Start points for each placement.
    pictured : bool
        Return a row for each of the cheapest poses as well.
    """
    problem = resident(problem)
    task = OneStepTask.between(problem, problem.energy, instance.ends)
    if not task.possible:
        return [{"skipped": "no grasp of this set is feasible at one of the ends"}]
    _, name, variant = METHODS[method]
    generator = GENERATORS[name]()
    options = CostOptions(variant=variant, h=problem.energy.model.threshold)
    lattice = problem.lattice if generator.starts == "lattice" else None
    began = time.perf_counter()
    found = generate(task, generator, options, starts, np.random.default_rng([seed, 11]), lattice)
    seconds = round(time.perf_counter() - began, 3)
    placements, xi = found.placements[: max(K_TOP), 0], found.xi[: max(K_TOP), 0]
    valid = verdicts(problem.checker, task.poses(placements, xi), task.feasible)
    direct = bool(task.feasible.all(axis=0).any())
    rows: list[Row] = [
        {
            "k_top": k,
            "sv": float(valid[:k].mean()),
            "distinct": distinct(placements[:k], xi[:k]),
            "direct": direct,
            "seconds": seconds,
        }
        for k in K_TOP
    ]
    return rows + (_pose_rows(placements, xi, valid) if pictured else [])


def _pose_rows(placements: IntArray, xi: FloatArray, valid: BoolArray) -> list[Row]:
    return [
        {"placement": int(p), "x": float(x), "y": float(y), "yaw": float(yaw), "valid": bool(v)}
        for p, (x, y, yaw), v in zip(placements, xi, valid, strict=True)
    ]


def _table(rows: list[Row], unseen: bool) -> Table:
    measured = [row for row in rows if "sv" in row]
    solvable = {row["pair"] for row in rows if row.get("share", 0.0) > 0}
    methods = UNSEEN_METHODS if unseen else tuple(METHODS)
    paper_columns = ("paper Usn",) if unseen else ("paper J", "paper J+", "paper J^h")
    lines = []
    for name in dict.fromkeys(row["object"] for row in measured):
        for k in K_TOP:
            here = [row for row in measured if row["object"] == name and row["k_top"] == k and row["pair"] in solvable]
            printed = ONE_STEP[PAPER_OBJECT[name]][k] if name in PAPER_OBJECT else None
            paper = (None,) * len(paper_columns) if printed is None else printed[3:] if unseen else printed[:3]
            ours = [percent([row["sv"] for row in here if row["method"] == method]) for method in methods]
            lines.append((name, k, *ours, *paper))
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


def _truth_table(truth: dict[str, Oracle], rows: list[Row]) -> Table:
    lines = []
    for name, oracle in truth.items():
        here = [row for row in rows if row.get("object") == name]
        shares = [row["share"] for row in here if "share" in row]
        times = [
            [row["seconds"] for row in here if row.get("method") == method and "seconds" in row]
            for method in ("ours J", "Langevin J")
        ]
        lines.append(
            (
                name,
                *oracle.feasible.shape,
                len(shares),
                sum(share > 0 for share in shares),
                percent(shares),
                percent(sorted(shares)[:1]),
                round(oracle.seconds, 1),
                *(round(median(t), 2) if t else None for t in times),
            )
        )
    return Table(
        "Exhaustive grid search",
        (
            "object",
            "poses",
            "grasps",
            "pairs",
            "solvable",
            "valid poses [%]",
            "least valid [%]",
            "grid [CPU s]",
            "ours [s]",
            "Langevin [s]",
        ),
        tuple(lines),
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
            figure.add_trace(_arrows([r for r in poses if r["valid"] is valid], colour), row=1, col=column)
    figure.update_xaxes(title_text="x [m]")
    figure.update_yaxes(scaleanchor="x")
    figure.update_layout(height=360, showlegend=False, margin={"l": 50, "r": 10, "t": 40, "b": 40})
    return figure


def _arrows(poses: list[Row], colour: str) -> go.Scatter:
    return go.Scatter(
        x=[r["x"] for r in poses],
        y=[r["y"] for r in poses],
        mode="markers",
        marker={"symbol": "arrow", "size": 8, "angle": [90 - np.degrees(r["yaw"]) for r in poses], "color": colour},
        text=[f"placement {r['placement']}" for r in poses],
        hoverinfo="text",
    )
