"""`regrasp-opt bench speed`: how long plans take, against Langevin at the paper's setting, and where the time goes.

Plans are timed in a warm process, one after the other on whatever else the machine is doing; what is claimed is the
ratio within one run. Whole processes and peak memory are those of child processes.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from regrasp_opt.benchmarks.comparisons import kernels
from regrasp_opt.benchmarks.comparisons.speed_page import performance_page
from regrasp_opt.benchmarks.harness.environment import environment
from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.files import atomic_path
from regrasp_opt.objects import OBJECT_NAMES
from regrasp_opt.planning import Recipe, RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.planning.tasks import Task, random_task
from regrasp_opt.solvers import NlpRefiner

THIN_GRASPS = 12
"""Grasps of the problems with few of them: with all, few tasks need two regrasps, and nearly none three."""


@dataclass(frozen=True)
class SpeedSizes:
    """How much is measured, all of these being numbers.

    Of each object `plans` tasks with all grasps; of the first with one regrasp `langevin` by Langevin at the paper's
    setting too; `thin` plans with two or three regrasps, with few grasps. Each derivative and each point of a curve is
    timed in `repeats` turns, `checks` pairs are checked exactly, `regrasp-opt --help` and `regrasp-opt plan` are run
    `runs` times, and the model of each mesh is trained on `samples` feasible pairs.
    """

    plans: int
    thin: int
    langevin: int
    repeats: int
    checks: int
    runs: int
    samples: int


QUICK = SpeedSizes(12, 6, 1, 5, 10_000, 3, 2_000)
FULL = SpeedSizes(200, 40, 30, 25, 100_000, 7, 20_000)


def plan_rows(name: str, sizes: SpeedSizes, tell: Callable[[str], None]) -> list[Row]:
    """Return one row for each timed plan of a built-in object: with all grasps, by Langevin, with few grasps."""
    problem = RegraspProblem.load(name, "nova2-w")
    rng = np.random.default_rng(0)
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(sizes.plans)]
    for task in tasks:  # builds the lattice, and each solver once
        solve_sequence(problem, task.start, task.goal)
    rows = [_timed(problem, task, "ipopt", seed) for seed, task in enumerate(tasks)]
    tell(f"{name}: Langevin at the paper's setting")
    chosen = [i for i, row in enumerate(rows) if row["N"] == 1][: sizes.langevin]
    rows += [_timed(problem, tasks[i], "langevin", i) for i in chosen]
    tell(f"{name}: few grasps")
    return rows + _thin_rows(problem, sizes.thin, rng)


def _thin_rows(problem: RegraspProblem, count: int, rng: np.random.Generator) -> list[Row]:
    """Return rows of plans with two or three regrasps, on problems with `THIN_GRASPS` grasps."""
    rows: list[Row] = []
    finder = Recipe(NlpRefiner(), fallback=0)
    for attempt in range(30):
        ids = rng.choice(len(problem.grasps), THIN_GRASPS, replace=False)
        thin = RegraspProblem.load(problem.object, problem.workcell, grasps=problem.grasps.subset(ids))
        tasks = [random_task(thin, rng, needs_regrasp=True) for _ in range(25)]
        plans = [solve_sequence(thin, task.start, task.goal, finder, max_regrasps=3) for task in tasks]
        deep = [task for task, plan in zip(tasks, plans, strict=True) if plan.solved and plan.num_regrasps >= 2]
        rows += [_timed(thin, task, "ipopt", 100 * attempt + k) | {"thin": True} for k, task in enumerate(deep)]
        if len(rows) >= count:
            break
    return rows


def _timed(problem: RegraspProblem, task: Task, refiner: str, seed: int) -> Row:
    began = time.perf_counter()
    plan: RegraspPlan = solve_sequence(problem, task.start, task.goal, refiner, seed=seed)
    seconds = time.perf_counter() - began
    parts = {f"t_{name}": value for name, value in plan.timings.items() if name != "total"}
    return {
        "object": problem.object.name,
        "grasps": len(problem.grasps),
        "thin": False,
        "refiner": refiner,
        "solved": plan.solved,
        "N": plan.num_regrasps if plan.solved else None,
        "seconds": seconds,
        **parts,
    }


# A small process in between: the peak memory of a child counts that of the process it was forked from.
_WATCH = """
import json, resource, subprocess, sys
child = subprocess.run(sys.argv[1:], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
print(json.dumps([child.returncode, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss]))
"""


def process_row(label: str, arguments: list[str], environment: dict[str, str] | None = None) -> Row:
    """Run the command line in a child process; return its wall time [s], peak memory [MB] and exit code."""
    command = [sys.executable, "-c", "from regrasp_opt.cli import main; main()", *arguments]
    began = time.perf_counter()
    watched = subprocess.run(
        [sys.executable, "-c", _WATCH, *command],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, **(environment or {})},
    )
    seconds = time.perf_counter() - began
    code, peak = json.loads(watched.stdout)
    return {"what": label, "seconds": seconds, "peak_mb": _megabytes(peak), "exit": code}


def _megabytes(peak: int) -> float:
    """Return the peak memory `peak` of `getrusage` in MB; macOS counts bytes, others kilobytes."""
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def process_rows(meshes: list[Path], repeats: int, samples: int, tell: Callable[[str], None]) -> list[Row]:
    """Return rows of whole processes: help, a plan from a stored model, and prepare and plan for each mesh."""
    tell("whole processes")
    rows = [process_row("regrasp-opt --help", ["--help"]) for _ in range(repeats)]
    rows += [process_row("regrasp-opt plan", ["plan"]) for _ in range(repeats)]
    for mesh in meshes:
        tell(f"prepare and plan {mesh.name}")
        with tempfile.TemporaryDirectory() as home:
            fresh = {"REGRASP_OPT_HOME": home}
            prepared = process_row(f"prepare {mesh.name}", ["prepare", str(mesh), "--samples", str(samples)], fresh)
            planned = process_row(f"plan {mesh.name}", ["plan", "--object", str(mesh)], fresh)
        both = {"what": f"prepare + plan {mesh.name}", "seconds": prepared["seconds"] + planned["seconds"]}
        both |= {"peak_mb": max(prepared["peak_mb"], planned["peak_mb"])}
        rows += [prepared, planned, {**both, "exit": max(prepared["exit"], planned["exit"])}]
    return rows


def measure(*, quick: bool, meshes: list[Path], tell: Callable[[str], None]) -> dict[str, Any]:
    """Measure everything; `quick` takes fewer plans, pairs and repetitions.

    Returns
    -------
    dict
        ``plans`` and ``processes`` (rows), ``derivatives``, ``curves`` with ``exponents``, ``checks``, ``peak_mb``.
    """
    sizes = QUICK if quick else FULL
    plans: list[Row] = []
    for name in OBJECT_NAMES:
        tell(f"{name}: all grasps")
        plans += plan_rows(name, sizes, tell)
    tell("derivatives and scaling")
    derivatives = kernels.derivative_speed(sizes.repeats)
    curves = {axis: kernels.iteration_curve(axis, sizes.repeats) for axis in kernels.SIZES}
    tell("exact checks")
    checks = kernels.check_speed(RegraspProblem.load("bottle", "nova2-w"), sizes.checks)
    processes = process_rows(meshes, sizes.runs, sizes.samples, tell)
    return {
        "plans": plans,
        "derivatives": derivatives,
        "curves": curves,
        "exponents": {axis: kernels.exponent(rows, axis) for axis, rows in curves.items()},
        "checks": checks,
        "processes": processes,
        "peak_mb": _megabytes(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss),
    }


def run_speed(out: Path, *, quick: bool, meshes: list[Path], tell: Callable[[str], None]) -> dict[str, Any]:
    """Measure, write ``speed.json`` and ``performance.md`` to the folder `out`, and return what was measured."""
    result = measure(quick=quick, meshes=meshes, tell=tell)
    described = environment()
    content = json.dumps({"environment": described, **result}, indent=1) + "\n"
    page = performance_page(result, described, "regrasp-opt bench speed" + (" --quick" if quick else ""))
    for name, text in (("speed.json", content), ("performance.md", page)):
        with atomic_path(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return result
