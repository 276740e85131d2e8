"""The refiner comparison: every planner on the same instances, with the same grasps and the same checker."""

from __future__ import annotations

from dataclasses import replace
from statistics import median

import numpy as np
import plotly.graph_objects as go

from regrasp_opt.benchmarks.harness.instances import Instance, choose_instances, instances_hash
from regrasp_opt.benchmarks.harness.planners import PLANNERS, graph_row, plan_row
from regrasp_opt.benchmarks.harness.report import Cell, Figure, Report, Table, mean, percent
from regrasp_opt.benchmarks.harness.runner import Item, Row
from regrasp_opt.benchmarks.harness.session import Session, error_rows, usable
from regrasp_opt.benchmarks.harness.subjects import planning_key
from regrasp_opt.benchmarks.paper.hard_tiers import Condition, hard_instances
from regrasp_opt.files import content_hash
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.model_store import read_report

TEXT = (
    "Every planner on the same start-goal pairs: pairs with all grasps that need a regrasp, and pairs of the hard "
    "tiers that the oracle solves. All plans are proved by the same exact checker; the time ends with the proof. The "
    "regrasp graph is the discrete baseline: exact feasibility on the grid, then a shortest path."
)
GRAPH = "regrasp graph"
LANGEVIN = "Langevin"
FROM_LATTICE = (
    "ipopt from lattice", "ipopt L-BFGS from lattice", "sqpmethod from lattice", "Langevin from lattice", "lattice",
)  # fmt: skip
UNPREPARED = ("random poses",)
"""Planners that need no model."""
PAIRS = {True: 2, False: 5}
"""Pairs an object with all grasps, in quick and in full runs."""
HARD = {True: {"2": 1, "3+": 1}, False: {"2": 3, "3+": 3}}
"""Pairs of the hard tiers an object, in quick and in full runs."""
TIME_LIMIT = {True: 20.0, False: 30.0}
"""Seconds after which a planner gives up."""


def run_refiners(session: Session) -> Report:
    """Measure success, quality and time of every planner."""
    subjects = session.subjects()
    items: list[Item] = []
    hashes: dict[str, str] = {}
    for name, problem in usable(subjects):
        pairs = _instances(session, name, problem)
        hashes[name] = instances_hash([instance for _, instance in pairs])
        for condition, instance in pairs:
            items += _items(session, name, condition, instance)
    results = session.execute("refiners", items)
    rows = results.rows + error_rows(subjects)
    return Report(
        "refiners",
        "Refiners and baselines",
        TEXT,
        (_success_table(rows), _quality_table(rows)),
        rows,
        (Figure("Share of pairs with a proved plan over time", _figure(rows)),),
        hashes,
        results.revisions,
        {
            "quick": session.quick,
            "seed": session.seed,
            "oracle": str(session.grid),
            "time limit [s]": TIME_LIMIT[session.quick],
        },
        _conclusion(rows),
    )


def _instances(session: Session, name: str, problem: RegraspProblem) -> list[tuple[Condition, Instance]]:
    oracle = session.oracle(name, problem)
    easy = choose_instances(session.pool(problem), oracle, {"any": PAIRS[session.quick]}, session.rng(40), name)
    every = Condition("all grasps", problem, session.grid, np.arange(len(problem.grasps)))
    pairs = [(every, instance) for instance in easy]
    hard = hard_instances(session, name, problem)
    for tier, count in HARD[session.quick].items():
        pairs += [pair for pair in hard if pair[1].tier == tier][:count]
    return pairs


def _items(session: Session, name: str, condition: Condition, instance: Instance) -> list[Item]:
    reduced, limit = condition.reduced, TIME_LIMIT[session.quick]
    depends = content_hash(planning_key(reduced), instances_hash([instance]), session.seed, limit, str(condition.grid))
    bare, whole = replace(reduced), replace(condition.problem)
    columns: Row = {"object": name, "pair": instance.name, "condition": condition.label}
    prepared = sum(read_report(reduced.model_folder)["times"].values()) if reduced.model_folder else None
    graph = Item(
        f"{instance.name}/{GRAPH}",
        depends,
        graph_row,
        (bare, whole, condition.ids, condition.grid, instance),
        {**columns, "planner": GRAPH},
    )
    return [graph] + [
        Item(
            f"{instance.name}/{planner}",
            depends,
            plan_row,
            (bare, instance, planner, session.seed, limit),
            {**columns, "planner": planner, "before": None if planner in UNPREPARED else prepared},
        )
        for planner in PLANNERS
    ]


def _by_planner(rows: list[Row]) -> dict[str, list[Row]]:
    measured = [row for row in rows if "solved" in row]
    names = (GRAPH, *PLANNERS)
    return {name: [row for row in measured if row["planner"] == name] for name in names}


def _success_table(rows: list[Row]) -> Table:
    lines: list[tuple[Cell, ...]] = []
    for planner, here in _by_planner(rows).items():
        solvable = [row for row in here if row["minimum"] is not None]
        good = [row for row in solvable if row["solved"]]
        tiers = [[row["solved"] for row in solvable if row["tier"] == tier] for tier in ("1", "2", "3+")]
        times = sorted(row["first_proof"] for row in here if row["solved"])
        lines.append(
            (
                planner,
                len(here),
                percent([row["solved"] for row in solvable]),
                *(percent(tier) for tier in tiers),
                percent([row["num_regrasps"] <= row["minimum"] for row in good]),
                round(median(times), 3) if times else None,
                round(times[int(0.9 * (len(times) - 1))], 3) if times else None,
                mean([row["seconds"] for row in here], 3),
                mean([row["before"] for row in here if row.get("before") is not None], 1),
            )
        )
    return Table(
        "Success and time to the first proved plan",
        ("planner", "pairs", "proved [%]", "N=1", "N=2", "N>=3", "N no more than oracle [%]", "median [s]",
         "90 % [s]", "mean, all [s]", "before [s]"),
        tuple(lines),
        "Proved: of the pairs that the oracle solves. Mean, all: time spent on every pair, solved or not. Before: "
        "what is made once for an object, workcell and grasp set: the exact grid (processor time), or grasps, labels "
        "and trained energies (by the clock).",
    )  # fmt: skip


def _quality_table(rows: list[Row]) -> Table:
    by_planner = _by_planner(rows)
    solved_by_all = set.intersection(
        *({row["pair"] for row in here if row["solved"]} for planner, here in by_planner.items() if planner != GRAPH)
    )
    lines: list[tuple[Cell, ...]] = []
    for planner, here in by_planner.items():
        good = [row for row in here if row["solved"] and row["pair"] in solved_by_all]
        solves = sum(row.get("solves", 0) for row in here)
        lines.append(
            (
                planner,
                len(good),
                mean([row["num_regrasps"] for row in good]),
                mean([row["cost"] for row in good if row.get("cost") is not None]),
                mean([row["bottleneck"] for row in good], 1),
                mean([row["clearance_mm"] for row in good if row.get("clearance_mm") is not None], 1),
                mean([row["iterations"] for row in good if "iterations" in row], 1),
                mean([row["evaluations"] for row in good if "evaluations" in row], 0),
                percent([1.0] * sum(row.get("converged", 0) for row in here) + [0.0] * _unconverged(here))
                if solves
                else None,
            )
        )
    return Table(
        "Plans for the pairs that every refiner solved",
        (
            "planner",
            "pairs",
            "N",
            "J_seq",
            "bottleneck [grasps]",
            "clearance [mm]",
            "iterations",
            "evaluations",
            "converged [%]",
        ),
        tuple(lines),
        "Bottleneck: fewest shared grasps of a transition. Clearance: of the clearest grasp of the tightest "
        "transition. Evaluations: of J_seq and its derivatives by the refiner; a lattice's energies are made before. "
        "Converged: share of all nonlinear solves.",
    )


def _unconverged(here: list[Row]) -> int:
    return sum(row.get("solves", 0) - row.get("converged", 0) for row in here)


def _conclusion(rows: list[Row]) -> str:
    """Return two paragraphs: who wins on success and time and why, and what the default adds to that."""
    groups = {name: [r for r in here if r["minimum"] is not None] for name, here in _by_planner(rows).items()}
    solved = {name: [r for r in here if r["solved"]] for name, here in groups.items()}
    if not all(solved.get(name) for name in (*FROM_LATTICE, GRAPH, LANGEVIN)):
        return ""
    proved = {name: 100 * len(good) / len(groups[name]) for name, good in solved.items() if good}
    extra = {name: sum(r["num_regrasps"] - r["minimum"] for r in solved[name]) for name in proved}
    time = {name: median(r["first_proof"] for r in solved[name]) for name in proved}
    winner = min(proved, key=lambda name: (-proved[name], extra[name], time[name]))
    first = (
        f"'{winner}' wins on success and time: it proves {proved[winner]:.1f} % of the pairs that the oracle solves, "
        f"no planner does so with fewer regrasps, and half of its first proofs come within {time[winner]:.3f} s. The "
        f"regrasp graph proves {proved[GRAPH]:.1f} % with a median of {time[GRAPH]:.3f} s, once its exact grid is "
        f"there, which takes {mean([r['before'] for r in groups[GRAPH]], 0):.0f} s of processor time; Langevin from "
        f"random poses, as in the paper but with exact proofs, {proved[LANGEVIN]:.1f} % with {time[LANGEVIN]:.3f} s."
    )
    if winner in FROM_LATTICE:
        first += (
            " The reason is the ranking, not the descent: the energies of all lattice poses are there before start and "
            "goal are known, so all chains of one pose are scored by two products of a matrix and a vector, and what "
            "comes out on top nearly always holds. Where a number of regrasps cannot work the same scores say so, and "
            "nothing is refined or proved in vain."
        )
    default, *_ = FROM_LATTICE
    both = {r["pair"]: r["cost"] for r in solved["lattice"]}
    gains = [both[r["pair"]] - r["cost"] for r in solved[default] if r["pair"] in both]
    more = proved[default] - proved["lattice"]
    success = (
        f"It proves {more:.1f} % more pairs than the lattice alone."
        if more > 0
        else "It adds no success here: a lattice pose on top of the ranking holds as it is."
    )
    second = (
        f"'{default}' is the default. Its median is {time[default]:.3f} s: refining costs "
        f"{1e3 * (time[default] - time['lattice']):.0f} ms over the lattice alone, and lowers J_seq by {mean(gains)} "
        f"in the mean and by {max(gains):.2f} at most. {success} It is the default because its poses are minima "
        "of the cost, and of whatever a user adds to it. Among the refiners exact second derivatives pay: a solve "
        f"takes {_evaluations(groups[default])} evaluations of the cost and its derivatives, with L-BFGS "
        f"{_evaluations(groups[FROM_LATTICE[1]])}, with sqpmethod {_evaluations(groups[FROM_LATTICE[2]])}."
    )
    return f"{first}\n\n{second}"


def _evaluations(here: list[Row]) -> str:
    return f"{sum(row['evaluations'] for row in here) / max(1, sum(row['solves'] for row in here)):.0f}"


def _figure(rows: list[Row]) -> go.Figure:
    figure = go.Figure()
    for planner, here in _by_planner(rows).items():
        times = sorted(row["first_proof"] for row in here if row["solved"])
        share = [100 * (i + 1) / len(here) for i in range(len(times))]
        figure.add_trace(go.Scatter(x=times, y=share, mode="lines", line={"shape": "hv"}, name=planner))
    figure.update_xaxes(type="log", title_text="seconds")
    figure.update_yaxes(title_text="pairs with a proved plan [%]", range=[0, 101])
    figure.update_layout(height=420, margin={"l": 60, "r": 10, "t": 10, "b": 50})
    return figure
