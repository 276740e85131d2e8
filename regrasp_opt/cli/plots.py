"""The plots that `show --plots` and `bench --plots` write, as PNG files (extra ``viz``)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from regrasp_opt.benchmarks.harness.report import Report
from regrasp_opt.errors import OptionError
from regrasp_opt.files import atomic_path
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.viz import CandidateTrace
from regrasp_opt.viz.curves import plot_anytime, plot_cost_sweep, plot_cost_traces, pyplot
from regrasp_opt.viz.fields import has_energy
from regrasp_opt.viz.plots import plot_cost_landscape, plot_pose_distribution

SWEPT, COMPARED, OURS = "cost-sweep", "refiners", "multi-step"
"""Experiments that have plots."""


def write_plan_plots(plan: RegraspPlan, trace: CandidateTrace | None, folder: Path) -> list[Path]:
    """Write the cost over the table for each intermediate pose, over all lattice poses, and by iteration.

    Raises
    ------
    OptionError
        If matplotlib or the energy is missing, or the plan has no intermediate pose.
    """
    if not has_energy(plan):
        raise OptionError("the plots show the cost, which needs an energy; run 'regrasp-opt prepare WORKCELL' first")
    if plan.num_regrasps == 0 and trace is None:
        raise OptionError("the plan has no intermediate pose whose cost could be plotted")
    return _write(_of_plan(plan, trace), folder)


def _of_plan(plan: RegraspPlan, trace: CandidateTrace | None) -> Iterator[tuple[str, Any]]:
    for i in range(1, plan.num_regrasps + 1):
        yield f"landscape-{i}", plot_cost_landscape(plan, i)
    if plan.num_regrasps == 1:
        yield "poses", plot_pose_distribution(plan)
    if trace is not None:
        yield "candidates", plot_cost_traces(trace)


def write_bench_plots(report: Report, folder: Path) -> list[Path]:
    """Write the curves of an experiment; nothing for one that has none, or that solved no pair."""
    limit = report.settings.get("time limit [s]")
    measured = [row for row in report.rows if "solved" in row]
    if report.name == SWEPT:
        return _write(_sweeps(report), folder)
    if report.name in (COMPARED, OURS):
        key = "planner" if report.name == COMPARED else "object"
        times: dict[str, list[float | None]] = {}
        for row in measured:
            if report.name == COMPARED or row["planner"] == "ours":
                times.setdefault(row[key], []).append(row["first_verified"] if row["solved"] else None)
        if not any(row["solved"] for row in measured):
            return []
        return _write([("anytime", plot_anytime(times, f"{report.title}: pairs verified over time", limit))], folder)
    return []


def _sweeps(report: Report) -> Iterator[tuple[str, Any]]:
    rows = [row for row in report.rows if "step" in row and row["first"]]
    for name in dict.fromkeys(row["object"] for row in rows):
        here = [row for row in rows if row["object"] == name]
        yield f"sweep-{name}", plot_cost_sweep(here, f"{name}: costs while the intermediate pose moves")


def _write(figures: Iterable[tuple[str, Any]], folder: Path) -> list[Path]:
    plt = pyplot()
    plt.switch_backend("agg")
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, figure in figures:
        path = folder / f"{name}.png"
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=120, format="png")
        plt.close(figure)
        paths.append(path)
    return paths
