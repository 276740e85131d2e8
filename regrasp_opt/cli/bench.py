"""`regrasp-opt bench`: the evaluation, one experiment at a time."""

from __future__ import annotations

import json
from collections.abc import Callable

from rich.markdown import Markdown

from regrasp_opt.benchmarks.comparisons.ablations import run_ablations
from regrasp_opt.benchmarks.comparisons.any import run_any
from regrasp_opt.benchmarks.comparisons.arms import run_arms
from regrasp_opt.benchmarks.comparisons.joint import run_joint
from regrasp_opt.benchmarks.comparisons.motion import run_motion
from regrasp_opt.benchmarks.comparisons.refiners import run_refiners
from regrasp_opt.benchmarks.comparisons.speed import run_speed
from regrasp_opt.benchmarks.harness.report import Report, write_document, write_report
from regrasp_opt.benchmarks.harness.runner import dask_cluster
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.paper.cost_sweep import run_cost_sweep
from regrasp_opt.benchmarks.paper.cross_effector import run_cross_effector
from regrasp_opt.benchmarks.paper.hard_tiers import run_hard_tiers
from regrasp_opt.benchmarks.paper.multi_step import run_multi_step
from regrasp_opt.benchmarks.paper.one_step import run_one_step, run_unseen
from regrasp_opt.cli.output import make_console, say_written
from regrasp_opt.errors import UnknownNameError

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
    "motion": run_motion,
    "any": run_any,
    "arms": run_arms,
    "speed": run_speed,
}
"""The experiments by their names on the command line."""


def run_bench(name: str, session: Session, dask: str | None, *, as_json: bool) -> int:
    """Run one experiment, write its files below the session's folder and print its page; return 0.

    Workers are those of the Dask scheduler at the address `dask`, if it is given. Raises a `RegraspError` for an
    unknown experiment, a folder without meshes, or a scheduler that does not answer.
    """
    if name not in EXPERIMENTS:
        raise UnknownNameError("experiment", name, EXPERIMENTS)
    with dask_cluster(dask):
        report = EXPERIMENTS[name](session)
    folder = session.folder / report.name
    summary = write_report(report, folder)
    write_document(session.folder, session.folder / "benchmarks.md")
    if as_json:
        print(json.dumps(summary))
        return 0
    make_console().print(Markdown((folder / f"{report.name}.md").read_text(encoding="utf-8")))
    say_written(folder)
    return 0
