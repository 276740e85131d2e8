"""Energy compositionality (Fig. 3) and the sweep of the cost formulations (Fig. 5).

Fig. 3: the energies at two poses and their sum, against the exact feasible and shared grasps. Fig. 5: one intermediate
pose moves in 40 steps from the goal to the start, and each cost is evaluated with 50 to 200 grasps, with the exact
numbers of shared grasps beneath.
"""

from __future__ import annotations

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots
from scipy.stats import spearmanr

from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.instances import Instance, instances_hash, planar_parameters
from regrasp_opt.benchmarks.harness.report import Figure, Report, Table
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, pair_item, run_experiment
from regrasp_opt.benchmarks.harness.subjects import resident
from regrasp_opt.connectivity import CostOptions, sequence_cost
from regrasp_opt.connectivity.costs import COST_VARIANTS
from regrasp_opt.conventions import planar_transform
from regrasp_opt.energy.calibration import average_precision, best_threshold
from regrasp_opt.planning import RegraspProblem

TEXT = (
    "Whether summed energies rank shared grasps (Fig. 3), and how the costs behave while one intermediate pose moves "
    "from the goal to the start (Fig. 5). Energies are learned at all poses, the ends included."
)
STEPS = 40
GRASP_COUNTS = (50, 100, 150, 200)
PAIRS = {True: 2, False: 10}
"""Pairs an object that are swept, in quick and in full runs."""
SUMS = {True: 10, False: 100}
"""Pairs an object whose summed energies are compared, in quick and in full runs."""
CANDIDATES = 10_000
"""Pairs that need one regrasp among which pairs of one placement are looked for."""
FLAT = 1e-9
"""A step along which a cost changes less than this gives no direction."""


def run_cost_sweep(session: Session) -> Report:
    """Measure compositionality and the sweep."""

    def work(name: str, problem: RegraspProblem) -> tuple[list[Item], str]:
        oracle = session.oracle(name, problem)
        sums = session.chosen(name, problem, oracle, {"0": SUMS[session.quick]}, 50)
        pairs = session.chosen(name, problem, oracle, {"1": CANDIDATES}, 51)
        numbers = [{planar_parameters(T, problem.placement_poses)[0] for T in pair.ends} for pair in pairs]
        swept = [pair for pair, own in zip(pairs, numbers, strict=True) if len(own) == 1][: PAIRS[session.quick]]
        items = [
            pair_item(name, problem, pair, f, label=f"/{f.__name__}", part=f.__name__, first=pair is chosen[0])
            for f, chosen in ((compare_sums, sums), (sweep, swept))
            for pair in chosen
        ]
        return items, instances_hash([*sums, *swept])

    def figures(rows: list[Row], names: list[str]) -> list[Figure]:
        sums = [Figure(f"Energies of all grasps at two poses: {n}", _sum_figure(rows, n)) for n in names]
        return sums + [Figure(f"Costs along the sweep: {n}", _sweep_figure(rows, n)) for n in names]

    made = (_sum_table, _sweep_table)
    title, settings = "Energy compositionality and cost sweep", {"steps": STEPS}
    return run_experiment(session, "cost-sweep", title, TEXT, work, made, figures=figures, settings=settings)


def compare_sums(problem: RegraspProblem, instance: Instance) -> list[Row]:
    """Return one row with the quality of the sum, and one row for each grasp."""
    problem = resident(problem)
    energy = problem.energy(instance.ends)
    feasible = np.array([problem.feasible_grasps(T) for T in instance.ends])
    total, shared = energy.sum(axis=0), feasible[0] & feasible[1]
    accepted = total <= problem.energy.model.threshold
    summary: Row = {
        "ap_start": average_precision(energy[0], feasible[0]),
        "ap_goal": average_precision(energy[1], feasible[1]),
        "ap_shared": average_precision(total, shared),
        "f1_shared": best_threshold(total, shared).f1,
        "f1_at_h": 2 * int((accepted & shared).sum()) / max(1, int(accepted.sum()) + int(shared.sum())),
        "shared": int(shared.sum()),
    }
    columns = zip(*energy.tolist(), total.tolist(), *feasible.tolist(), strict=True)
    return [summary] + [
        {"grasp": g, "E_start": a, "E_goal": b, "E_sum": s, "feasible_start": fa, "feasible_goal": fb}
        for g, (a, b, s, fa, fb) in enumerate(columns)
    ]


def sweep(problem: RegraspProblem, instance: Instance) -> list[Row]:
    """Return one row for each step and number of grasps, from the goal to the start along planar parameters."""
    problem = resident(problem)
    number, start = planar_parameters(instance.start, problem.placement_poses)
    _, goal = planar_parameters(instance.goal, problem.placement_poses)
    turn = (start[2] - goal[2] + np.pi) % (2 * np.pi) - np.pi
    xi = goal + np.linspace(0, 1, STEPS)[:, None] * np.array([*(start - goal)[:2], turn])
    poses = planar_transform(xi) @ problem.placement_poses[number]
    T = np.concatenate([instance.start[None], poses, instance.goal[None]])
    energies = problem.energy(T)
    feasible = np.array([problem.feasible_grasps(pose) for pose in T])
    rows: list[Row] = []
    for count in dict.fromkeys(min(count, len(problem.grasps)) for count in GRASP_COUNTS):
        chain = [np.broadcast_to(energies[i, :count], (STEPS, count)) for i in (0, -1)]
        along = np.stack([chain[0], energies[1:-1, :count], chain[1]], axis=1)
        costs = {
            v: sequence_cost(along, CostOptions(variant=v, h=problem.energy.model.threshold)) for v in COST_VARIANTS
        }
        middle = feasible[1:-1, :count]
        to_start, to_goal = (middle & feasible[i, :count] for i in (0, -1))
        through = to_start & feasible[-1, :count]
        rows += [
            {
                "step": step,
                "grasps": count,
                **{variant: float(values[step]) for variant, values in costs.items()},
                "shared_start": int(to_start[step].sum()),
                "shared_goal": int(to_goal[step].sum()),
                "shared_all": int(through[step].sum()),
            }
            for step in range(STEPS)
        ]
    return rows


def _sum_table(rows: list[Row], names: list[str]) -> Table:
    titles = ("AP start", "AP goal", "AP shared", "best F1 shared", "F1 at h")
    keys = ("ap_start", "ap_goal", "ap_shared", "f1_shared", "f1_at_h")
    return tables.summary(
        "Summed energies against exact shared grasps",
        ("object",),
        tables.by_object([row for row in rows if "ap_shared" in row], names),
        {"pairs": len, **{title: tables.average(key, 3) for title, key in zip(titles, keys, strict=True)}},
        "Average precision of ranking all grasps by energy, mean over pairs with at least one shared grasp.",
    )


COST_NAMES = {"J": "J_seq", "J+": "J+_seq", "Jh": "J^h_seq"}


def _sweep_table(rows: list[Row], names: list[str]) -> Table:
    groups = {
        (name, label): [sweep_row(sweep, variant) for sweep in _sweeps(rows, name)]
        for name in names
        for variant, label in COST_NAMES.items()
    }
    columns = {
        "sweeps": len,
        "with a valid step": tables.count("open"),
        "minimum valid [%]": tables.share("valid", of="open"),
        "flat steps [%]": tables.share("flat"),
        "rank correlation": tables.average("agreement", of="open"),
    }
    return tables.summary(
        "Costs along the sweep, all grasps",
        ("object", "cost"),
        groups,
        columns,
        "Minimum valid: the step of least cost shares a grasp with both ends, of the sweeps that have such a step. "
        "Rank correlation: of low cost with the smaller of the two exact shared counts.",
    )


def _sweeps(rows: list[Row], name: str) -> list[list[Row]]:
    """Return the rows of each sweep of an object with the most grasps."""
    here = [row for row in rows if row["object"] == name and "step" in row]
    largest = max((row["grasps"] for row in here), default=0)
    return list(tables.grouped([row for row in here if row["grasps"] == largest], "pair").values())


def sweep_row(rows: list[Row], variant: str) -> Row:
    """Return what is told of one sweep: whether it has a valid step, and what the cost `variant` makes of that."""
    values, *ends = (np.array([row[key] for row in rows], float) for key in (variant, "shared_start", "shared_goal"))
    weakest = np.minimum(*ends)
    told = np.ptp(values) >= FLAT and np.ptp(weakest) > 0
    return {
        "open": bool((weakest > 0).any()),
        "valid": bool(weakest[values.argmin()] > 0),
        "flat": float((abs(np.diff(values)) < FLAT).mean()),
        "agreement": float(spearmanr(-values, weakest).statistic) if told else 0.0,
    }


def _sum_figure(rows: list[Row], name: str) -> go.Figure:
    grasps = [row for row in rows if row["object"] == name and "grasp" in row and row["first"]]
    figure = go.Figure()
    held = ((True, True), (True, False), (False, True), (False, False))
    for label, ends in zip(("shared", "start only", "goal only", "neither"), held, strict=True):
        here = [r for r in grasps if (r["feasible_start"], r["feasible_goal"]) == ends]
        figure.add_trace(
            go.Scatter(x=[r["E_start"] for r in here], y=[r["E_goal"] for r in here], mode="markers", name=label)
        )
    return tables.labelled(figure, "E at the start", "E at the goal", 420)


def _sweep_figure(rows: list[Row], name: str) -> go.Figure:
    titles = (*COST_NAMES.values(), "shared grasps (exact)")
    figure = make_subplots(rows=2, cols=2, subplot_titles=titles)
    here = [row for row in rows if row["object"] == name and "step" in row and row["first"]]
    steps = sorted({row["step"] for row in here})
    for count in sorted({row["grasps"] for row in here}):
        curve = [row for row in here if row["grasps"] == count]
        for panel, (variant, name_of) in enumerate(COST_NAMES.items()):
            line = go.Scatter(x=steps, y=[row[variant] for row in curve], name=f"{name_of}, {count} grasps")
            figure.add_trace(line, row=1 + panel // 2, col=1 + panel % 2)
    curve = [row for row in here if row["grasps"] == max((row["grasps"] for row in here), default=0)]
    for key in ("shared_start", "shared_goal", "shared_all"):
        line = go.Scatter(x=steps, y=[row[key] for row in curve], name=key.replace("_", " with "))
        figure.add_trace(line, row=2, col=2)
    return tables.labelled(figure, "step", "", 640)
