"""The page `docs/performance.md`, written from what `benchmarks.speed` measured and from nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from regrasp_opt.benchmarks.harness.report import markdown
from regrasp_opt.benchmarks.harness.runner import Row

PARTS = {
    "ends": ("exact feasibility at start and goal", "one exact check of every grasp at two poses"),
    "starts": ("lattice chains", "reading the lattice's likelihoods once"),
    "refine": ("Ipopt, energies included", "three passes of the network over the grasps, for each iteration"),
    "verify": ("verification of candidates (inverse kinematics, collision)", "one feasible branch for each transition"),
    "transitions": ("all shared grasps, configurations, clearances", "every branch of every shared grasp"),
}
"""Parts of a plan: what they are, and what bounds their time from below."""


def table(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a Markdown table."""
    return "\n".join(markdown(header, rows))


def performance_page(result: dict[str, Any], environment: dict[str, Any], command: str) -> str:
    """Return the page as Markdown."""
    machine = environment["machine"]
    sections = [
        "# Performance",
        f"Made by `{command}` at revision {environment['revision']}, on {machine['cores']} cores "
        f"({machine['processor']}), Python {environment['versions']['python']}. Times on a shared machine are noisy: "
        "trust the ratios, which come from one run.",
        "## Verified plans in a warm process",
        _plans(result["plans"]),
        _chosen(result["plans"]),
        "## Where the time of one plan goes",
        _breakdown(result["plans"]),
        "## Derivatives",
        _derivatives(result["derivatives"]),
        "## Cost of one Ipopt iteration",
        _curves(result),
        "## Exact checks",
        _checks(result["checks"]),
        "## Whole processes",
        _processes(result["processes"]),
        f"The process that measured all this had {result['peak_mb']:.0f} MB at its peak.",
    ]
    return "\n\n".join(sections) + "\n"


def _all_grasps(row: Row) -> bool:
    return row["refiner"] == "ipopt" and not row["thin"]


def _chosen(rows: list[Row]) -> str:
    """Return how the tasks were chosen."""
    names = dict.fromkeys(row["object"] for row in rows)
    drawn = max((sum(_all_grasps(row) for row in rows if row["object"] == name) for name in names), default=0)
    few = ", ".join(str(count) for count in sorted({row["grasps"] for row in rows if row["thin"]}))
    return (
        f"All grasps: {drawn} random pairs of resting poses of each object in the empty cell `nova2-w`, with feasible "
        "grasps at both ends and none in common; every pair that was drawn is in the table, by the N of its plan. "
        f"Few grasps ({few}): of random pairs for random subsets of the grasps, those for which the same planner had "
        "found a plan with two or three regrasps before; others are left out, so these rows say how long, not how "
        "often. Langevin: the first of the pairs with one regrasp, at the paper's setting (B = 1000, 20 iterations), "
        "with the same exact checks and random starts, to which most of the ratio is due: from the starts of ours it "
        "is as fast ([](benchmarks.md#refiners-and-baselines)). Each pair was planned once before it was timed: "
        "lattice and solvers, which the first plan of a process builds, are not counted."
    )


def _plans(rows: list[Row]) -> str:
    groups: list[tuple[str, Callable[[Row], bool]]] = [
        ("all grasps, N = 1", lambda r: _all_grasps(r) and r["N"] == 1),
        ("all grasps, N = 2", lambda r: _all_grasps(r) and r["N"] == 2),
        ("all grasps, N >= 3", lambda r: _all_grasps(r) and (r["N"] or 0) >= 3),
        ("all grasps, no plan", lambda r: _all_grasps(r) and not r["solved"]),
        ("few grasps, N = 2", lambda r: r["thin"] and r["N"] == 2),
        ("few grasps, N >= 3", lambda r: r["thin"] and (r["N"] or 0) >= 3),
        ("few grasps, no plan", lambda r: r["thin"] and not r["solved"]),
        ("all grasps, N = 1, Langevin", lambda r: r["refiner"] == "langevin"),
    ]
    lines = []
    for name in dict.fromkeys(row["object"] for row in rows):
        own = [row for row in rows if row["object"] == name]
        compared = sum(row["refiner"] == "langevin" for row in own)
        for label, wanted in groups:
            chosen = [row for row in own if wanted(row)]
            if not chosen:
                continue
            seconds = np.array([row["seconds"] for row in chosen])
            spread = [f"{np.median(seconds):.3f}", f"{np.percentile(seconds, 95):.3f}"]
            ratio = ""
            if label.endswith("Langevin"):
                ours = [r["seconds"] for r in own if _all_grasps(r) and r["N"] == 1][:compared]
                ratio = f"{np.median(seconds) / np.median(ours):.0f}x"
            lines.append([name, label, len(chosen), sum(row["solved"] for row in chosen), *spread, ratio])
    header = ["object", "task", "plans", "solved", "median [s]", "p95 [s]", "Langevin / ours"]
    return table(header, lines)


def _breakdown(rows: list[Row]) -> str:
    chosen = [row for row in rows if _all_grasps(row) and row["N"] == 1]
    total = float(np.median([row["seconds"] for row in chosen]))
    lines, known = [], 0.0
    for part, (meaning, bound) in PARTS.items():
        seconds = float(np.median([row.get(f"t_{part}", 0.0) for row in chosen]))
        known += seconds
        lines.append([meaning, f"{1e3 * seconds:.1f}", f"{seconds / total:.0%}", bound])
    lines.append(["the rest", f"{1e3 * max(total - known, 0.0):.1f}", f"{max(1 - known / total, 0.0):.0%}", ""])
    return table(["part", "median [ms]", "share", "bounded from below by"], lines)


def _derivatives(result: dict[str, float]) -> str:
    lines = []
    for kind in ("hessian", "gradient"):
        ours, plain, blas = (result[f"{key}{kind}"] for key in ("", "plain_", "blas_"))
        lines.append(
            [kind, *(f"{1e3 * t:.2f}" for t in (ours, plain, blas)), *(f"{t / ours:.1f}x" for t in (plain, blas))]
        )
    sizes = ", ".join(f"{axis} = {result[axis]}" for axis in "NGH")
    header = [
        f"`J_seq`, {sizes}",
        "ours [ms]",
        "CasADi [ms]",
        "CasADi, all by BLAS [ms]",
        "ratio",
        "ratio, all by BLAS",
    ]
    return (
        f"{table(header, lines)}\n\nLargest difference: {result['difference']:.1e}. CasADi differentiates the plainly "
        "built cost, whose matrix products go through the same BLAS as ours. The products of its derivatives do not: "
        "CasADi gives them to its own loops, whatever is asked for. In the columns 'all by BLAS' they were made to, "
        "by derivative rules of our own for the product; what is left of the ratio there is our second-order pass. "
        "Processor time of one thread; timed in turn."
    )


def _curves(result: dict[str, Any]) -> str:
    parts = []
    for axis, rows in result["curves"].items():
        fixed = ", ".join(f"{k} = {rows[0][k]}" for k in "NGH" if k != axis)
        lines = [[f"{1e3 * row['seconds']:.2f}" for row in rows]]
        header = [f"{axis} = {row[axis]}" for row in rows]
        caption = f"{fixed}; exponent {result['exponents'][axis]:.2f}; cost, gradient and Hessian together [ms]:"
        parts.append(f"{caption}\n\n{table(header, lines)}")
    return "\n\n".join(parts)


def _checks(result: dict[str, float]) -> str:
    return (
        f"{result['per_second']:,.0f} (pose, grasp) pairs a second with {result['processes']} processes on the bottle "
        f"in `nova2-w`. A plain loop over the same {result['pairs']:,} pairs (inverse kinematics for each, then its "
        "branches until one is free), with as many processes and the same libraries, reaches "
        f"{result['plain_per_second']:,.0f}; {result['different_labels']} labels differ. Most of its time is inverse "
        "kinematics for one pose at a time."
    )


def _processes(rows: list[Row]) -> str:
    lines = []
    for what in dict.fromkeys(row["what"] for row in rows):
        chosen = [row for row in rows if row["what"] == what]
        seconds = np.median([row["seconds"] for row in chosen])
        peak = max(row["peak_mb"] for row in chosen)
        lines.append([what, len(chosen), f"{seconds:.2f}", f"{peak:.0f}", max(row["exit"] for row in chosen)])
    return table(["command", "runs", "median [s]", "peak memory [MB]", "exit"], lines)
