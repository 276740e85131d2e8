"""How long plans take, against Langevin at the paper's setting, and where the time goes.

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
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from regrasp_opt.benchmarks.comparisons import kernels
from regrasp_opt.benchmarks.harness import tables
from regrasp_opt.benchmarks.harness.report import Report, Table
from regrasp_opt.benchmarks.harness.runner import Row, git_revision, progress
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.benchmarks.harness.subjects import DEFAULT_WORKCELL, mesh_files
from regrasp_opt.planning import Recipe, RegraspProblem, solve_sequence
from regrasp_opt.planning.tasks import Task, random_task
from regrasp_opt.solvers import NlpRefiner

TEXT = (
    "Verified plans in a warm process, what their time is spent on, and whole processes. Times on a shared machine are "
    "noisy: trust the ratios, which come from one run."
)
THIN_GRASPS = 12
"""Grasps of the problems with few of them: with all, few tasks need two regrasps, and nearly none three."""


@dataclass(frozen=True)
class SpeedSizes:
    """How much is measured, all of these being numbers; by default in full runs.

    Of each object `plans` tasks with all grasps; of the first with one regrasp `langevin` by Langevin at the paper's
    setting too; `thin` plans with two or three regrasps, with few grasps. Each derivative and each point of a curve is
    timed in `repeats` turns, `checks` pairs are checked exactly, `regrasp-opt --help` and `regrasp-opt plan` are run
    `runs` times, and the model of each mesh is trained on `samples` feasible pairs.
    """

    plans: int = 200
    thin: int = 40
    langevin: int = 30
    repeats: int = 25
    checks: int = 100_000
    runs: int = 7
    samples: int = 20_000


QUICK = SpeedSizes(12, 6, 1, 5, 10_000, 3, 2_000)

PARTS = {
    "ends": ("exact feasibility at start and goal", "one exact check of every grasp at two poses"),
    "starts": ("lattice chains, warmed up by a short Langevin run", "reading the lattice's likelihoods once"),
    "refine": ("Ipopt, energies included", "three passes of the network over the grasps, for each iteration"),
    "verify": ("verification of candidates (inverse kinematics, collision)", "one feasible branch for each transition"),
}
"""Parts of a plan: what they are, and what bounds their time from below."""


def run_speed(session: Session) -> Report:
    """Measure plans, what they are made of, and whole processes, all one after the other."""
    sizes = QUICK if session.quick else SpeedSizes()
    meshes = [] if session.objects is None else mesh_files(session.objects)
    work = [
        *(partial(plan_rows, name, sizes) for name in session.names),
        partial(kernels.derivative_rows, sizes.repeats),
        *(partial(kernels.iteration_rows, axis, sizes.repeats) for axis in kernels.SIZES),
        partial(kernels.check_rows, sizes.checks),
        partial(process_rows, meshes, sizes),
    ]
    rows: list[Row] = []
    with progress(session.quiet) as show:
        for done, measure in enumerate(work):
            show("measurements", done, len(work))
            rows += measure()
    made = tuple(table(rows) for table in (_plans, _parts, _derivatives, _iterations, _checks, _processes)), rows
    told = {"quick": session.quick}
    return Report("speed", "Performance", TEXT, *made, revisions=(git_revision(),), settings=told)


def plan_rows(name: str, sizes: SpeedSizes) -> list[Row]:
    """Return one row for each timed plan of a built-in object: with all grasps, by Langevin, with few grasps."""
    problem = RegraspProblem.load(name, "nova2-w")
    rng = np.random.default_rng(0)
    tasks = [random_task(problem, rng, needs_regrasp=True) for _ in range(sizes.plans)]
    for task in tasks:  # builds the lattice, and each solver once
        solve_sequence(problem, task.start, task.goal)
    rows = [_timed(problem, task, "ipopt", seed) for seed, task in enumerate(tasks)]
    chosen = [i for i, row in enumerate(rows) if row["N"] == 1][: sizes.langevin]
    rows += [_timed(problem, tasks[i], "langevin", i) for i in chosen]
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
        rows += [_timed(thin, task, "ipopt", 100 * attempt + k) for k, task in enumerate(deep)]
        if len(rows) >= count:
            break
    return rows


def _timed(problem: RegraspProblem, task: Task, refiner: str, seed: int) -> Row:
    began = time.perf_counter()
    plan = solve_sequence(problem, task.start, task.goal, refiner, seed=seed)
    seconds = time.perf_counter() - began
    return {
        "object": problem.object.name,
        "grasps": len(problem.grasps),
        "thin": len(problem.grasps) == THIN_GRASPS,
        "refiner": refiner,
        "seed": seed,
        "solved": plan.solved,
        "N": plan.num_regrasps if plan.solved else None,
        "seconds": seconds,
        **{f"t_{name}": value for name, value in plan.timings.items() if name != "total"},
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
    command, variables = [sys.executable, "-c", _WATCH, *command], {**os.environ, **(environment or {})}
    began = time.perf_counter()
    watched = subprocess.run(command, capture_output=True, text=True, check=True, env=variables)
    seconds = time.perf_counter() - began
    code, peak = json.loads(watched.stdout)
    return {"process": label, "seconds": seconds, "peak_mb": _megabytes(peak), "exit": code}


def _megabytes(peak: int) -> float:
    """Return the peak memory `peak` of `getrusage` in MB; macOS counts bytes, others kilobytes."""
    return peak / (1e6 if sys.platform == "darwin" else 1e3)


def process_rows(meshes: list[Path], sizes: SpeedSizes) -> list[Row]:
    """Return rows of whole processes: help, a plan from a stored model, prepare and plan for each mesh, and ours."""
    rows = [process_row(f"regrasp-opt {word}", [word]) for word in ("--help", "plan") for _ in range(sizes.runs)]
    for mesh in meshes:
        with tempfile.TemporaryDirectory() as home:
            fresh = {"REGRASP_OPT_HOME": home}
            words = ["prepare", DEFAULT_WORKCELL, "--object", str(mesh), "--samples", str(sizes.samples)]
            prepared = process_row(f"prepare {mesh.name}", words, fresh)
            planned = process_row(f"plan {mesh.name}", ["plan", "--object", str(mesh)], fresh)
        both = {"process": f"prepare + plan {mesh.name}", "seconds": prepared["seconds"] + planned["seconds"]}
        both |= {key: max(prepared[key], planned[key]) for key in ("peak_mb", "exit")}
        rows += [prepared, planned, both]
    peak = _megabytes(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
    return [*rows, {"process": "this measurement", "peak_mb": peak}]


def _all_grasps(row: Row) -> bool:
    return row.get("refiner") == "ipopt" and not row["thin"]


def _task(row: Row) -> str:
    if row["refiner"] == "langevin":
        return "all grasps, N = 1, Langevin"
    found = "no plan" if not row["solved"] else f"N = {row['N']}" if row["N"] < 3 else "N >= 3"
    return f"{'few' if row['thin'] else 'all'} grasps, {found}"


def _plans(rows: list[Row]) -> Table:
    plans = [{**row, "task": _task(row)} for row in rows if "refiner" in row]
    groups = tables.grouped(plans, "object", "task")
    ours = {(row["object"], row["seed"]): row["seconds"] for row in plans if _all_grasps(row)}

    def ratio(here: list[Row]) -> float | None:
        if here[0]["refiner"] != "langevin":
            return None
        same = [ours[row["object"], row["seed"]] for row in here]
        return round(float(np.median(tables.values(here, "seconds")) / np.median(same)), 1)

    columns: dict[str, tables.Column] = {
        "plans": len,
        "solved": tables.count("solved"),
        "median [s]": tables.middle("seconds"),
        "p95 [s]": tables.late("seconds"),
        "Langevin / ours": ratio,
    }
    note = (
        "All grasps: random pairs of resting poses of each object in the empty cell `nova2-w`, with feasible "
        "grasps at both ends and none in common; every pair that was drawn is in the table, by the N of its plan. "
        f"Few grasps ({THIN_GRASPS}): of random pairs for random subsets of the grasps, those for which the same "
        "planner had found a plan with two or three regrasps before; others are left out, so these rows say how long, "
        "not how often. Langevin: the first of the pairs with one regrasp, at the paper's setting (B = 1000, 20 "
        "iterations), with the same exact checks and random starts, to which most of the ratio is due: from the starts "
        "of ours it is as fast. Each pair was planned once before it was timed: lattice and solvers, which the first "
        "plan of a process builds, are not counted."
    )
    return tables.summary(
        "Verified plans in a warm process", ("object", "task"), dict(sorted(groups.items())), columns, note
    )


def _parts(rows: list[Row]) -> Table:
    chosen = [row for row in rows if _all_grasps(row) and row["N"] == 1]
    total = float(np.median([row["seconds"] for row in chosen]))
    medians = {part: float(np.median([row.get(f"t_{part}", 0.0) for row in chosen])) for part in PARTS}
    parts = [(*PARTS[part], seconds) for part, seconds in medians.items()]
    parts.append(("the rest", "", max(total - sum(medians.values()), 0.0)))
    lines = [(what, round(1e3 * t, 1), round(100 * t / total), bound) for what, bound, t in parts]
    header = ("part", "median [ms]", "share [%]", "bounded from below by")
    return Table("Where the time of one plan goes", header, tuple(lines), "Plans with all grasps and one regrasp.")


def _milliseconds(key: str) -> tables.Value:
    return lambda row: round(1e3 * row[key], 2)


def _derivatives(rows: list[Row]) -> Table:
    here = [row for row in rows if "derivative" in row]
    columns: dict[str, tables.Value] = {
        "of `J_seq`": "derivative",
        "ours [ms]": _milliseconds("ours"),
        "CasADi [ms]": _milliseconds("plain"),
        "CasADi, all by BLAS [ms]": _milliseconds("blas"),
        "ratio": lambda row: round(row["plain"] / row["ours"], 1),
        "ratio, all by BLAS": lambda row: round(row["blas"] / row["ours"], 1),
    }
    sizes = ", ".join(f"{axis} = {here[0][axis]}" for axis in "NGH")
    note = (
        f"{sizes}. Largest difference: {max(row['difference'] for row in here):.1e}. CasADi differentiates the plainly "
        "built cost, whose matrix products go through the same BLAS as ours. The products of its derivatives do not: "
        "CasADi gives them to its own loops, whatever is asked for. In the columns 'all by BLAS' they were made to, "
        "by derivative rules of our own for the product; what is left of the ratio there is our second-order pass. "
        "Processor time of one thread; timed in turn."
    )
    return tables.listing("Derivatives", here, columns, note)


def _iterations(rows: list[Row]) -> Table:
    here = [row for row in rows if "along" in row]
    columns = {"N": "N", "G": "G", "H": "H", "time [ms]": _milliseconds("iteration")}
    curves = tables.grouped(here, "along").items()
    note = ", ".join(f"{axis} {kernels.exponent(along, axis):.2f}" for (axis,), along in curves)
    note = f"Cost, gradient and Hessian together. Exponents of the time in each size: {note}."
    return tables.listing("Cost of one Ipopt iteration", here, columns, note)


def _checks(rows: list[Row]) -> Table:
    columns: dict[str, tables.Value] = {
        "(pose, grasp) pairs": "pairs",
        "processes": "processes",
        "ours [1/s]": lambda row: round(row["per_second"]),
        "plain loop [1/s]": lambda row: round(row["plain_per_second"]),
        "labels that differ": "different_labels",
    }
    note = (
        "On the bottle in `nova2-w`. The plain loop checks the same pairs (inverse kinematics for each, then its "
        "branches until one is free), with as many processes and the same libraries. Most of its time is inverse "
        "kinematics for one pose at a time."
    )
    return tables.listing("Exact checks", [row for row in rows if "pairs" in row], columns, note)


def _processes(rows: list[Row]) -> Table:
    columns = {
        "runs": len,
        "median [s]": tables.middle("seconds", 2),
        "peak memory [MB]": lambda here: round(max(row["peak_mb"] for row in here)),
        "exit": lambda here: max(tables.values(here, "exit"), default=None),
    }
    return tables.summary("Whole processes", ("command",), tables.grouped(rows, "process"), columns)
