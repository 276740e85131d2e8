"""`regrasp-opt bench`: the evaluation, one experiment at a time."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from regrasp_opt.benchmarks.comparisons.ablations import run_ablations
from regrasp_opt.benchmarks.comparisons.embedding import run_embedding
from regrasp_opt.benchmarks.comparisons.joint import run_joint
from regrasp_opt.benchmarks.comparisons.motion import run_motion
from regrasp_opt.benchmarks.comparisons.refiners import run_refiners
from regrasp_opt.benchmarks.comparisons.speed import run_speed
from regrasp_opt.benchmarks.harness.parallel import dask_cluster
from regrasp_opt.benchmarks.harness.report import Report, shown, write_document, write_page, write_report
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import mesh_files
from regrasp_opt.benchmarks.paper.cost_sweep import run_cost_sweep
from regrasp_opt.benchmarks.paper.cross_effector import run_cross_effector
from regrasp_opt.benchmarks.paper.hard_tiers import run_hard_tiers
from regrasp_opt.benchmarks.paper.multi_step import run_multi_step
from regrasp_opt.benchmarks.paper.one_step import run_one_step, run_unseen
from regrasp_opt.cli.output import make_console
from regrasp_opt.errors import UnknownNameError

logger = logging.getLogger(__name__)

EXPERIMENTS: dict[str, Callable[[Session], Report]] = {
    "cost-sweep": run_cost_sweep,
    "one-step": run_one_step,
    "unseen": run_unseen,
    "cross-effector": run_cross_effector,
    "multi-step": run_multi_step,
    "hard-tiers": run_hard_tiers,
    "refiners": run_refiners,
    "ablations": run_ablations,
    "joint": run_joint,
    "embedding": run_embedding,
    "motion": run_motion,
}
"""The experiments by their names on the command line."""

SPEED = "speed"
"""The experiment that times the planner itself (docs/performance.md)."""

DOCUMENT = "benchmarks.md"
"""Name of the file with the tables of all experiments in a folder."""


def run_bench(
    name: str,
    *,
    out: Path,
    quick: bool = False,
    objects: Path | None = None,
    jobs: int = -1,
    dask: str | None = None,
    seed: int = 0,
    plots: bool = False,
    as_json: bool = False,
) -> int:
    """Run one experiment, write its files below `out` and print its tables; return 0.

    Parameters
    ----------
    name : str
        One of `EXPERIMENTS`, or `SPEED`, which knows neither workers nor seeds.
    out : Path
        Folder of all experiments; a run that was interrupted there resumes.
    quick : bool
        Minutes instead of the paper's sizes.
    objects : Path, optional
        Folder of meshes to evaluate besides the built-in objects.
    jobs : int
        Workers, as joblib counts them.
    dask : str, optional
        Address of a Dask scheduler whose workers are used instead.
    plots : bool
        Write the experiment's curves as PNG files too, where it has any.
    as_json : bool
        Print the summary as one JSON object instead of the tables.

    Raises
    ------
    RegraspError
        For an unknown experiment, a folder without meshes, a scheduler that does not answer, or plots without
        matplotlib.
    """
    if name == SPEED:
        meshes = [] if objects is None else mesh_files(objects)
        measured = run_speed(out / SPEED, quick=quick, meshes=meshes, tell=_tell)
        print(json.dumps(measured) if as_json else f"written: {out / SPEED}")
        return 0
    if name not in EXPERIMENTS:
        raise UnknownNameError("experiment", name, (*EXPERIMENTS, SPEED))
    if plots:
        from regrasp_opt.viz.curves import pyplot

        pyplot()  # refused now, not after hours of measurements
    session = Session(out, quick=quick, objects=objects, jobs=jobs, seed=seed)
    with dask_cluster(dask):
        report = EXPERIMENTS[name](session)
    folder = out / report.name
    summary = write_report(report, folder)
    write_page(summary, folder / f"{report.name}.md")
    write_document(out, out / DOCUMENT)
    drawn = []
    if plots:
        from regrasp_opt.cli.plots import write_bench_plots

        drawn = write_bench_plots(report, folder)
    if as_json:
        print(json.dumps({**summary, "plots": [str(path) for path in drawn]}))
    else:
        _print(report, folder, drawn)
    return 0


def _tell(text: str) -> None:
    console = make_console(stderr=True)
    if console.is_terminal:
        console.print(text)
    else:
        logger.info("%s", text)


def _print(report: Report, folder: Path, plots: list[Path]) -> None:
    console = make_console()
    for item in report.tables:
        table = Table(title=escape(item.title), title_justify="left", box=None, header_style="bold")
        for number, heading in enumerate(item.columns):
            table.add_column(escape(heading), justify="right" if number else "left")
        for row in item.rows:
            table.add_row(*(escape(shown(cell)) for cell in row))
        console.print(table)
    for bad in report.errors:
        console.print(f"[bold red]not measured[/]: {escape(str(bad['object']))}: {escape(str(bad['error']))}")
    console.print(f"written: {folder / 'index.html'}, {folder / 'summary.json'}, {folder / 'rows.csv'}", soft_wrap=True)
    for path in plots:
        console.print(f"written: {path}", markup=False, soft_wrap=True)
