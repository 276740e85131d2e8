"""The page `docs/performance.md`, written from what `benchmarks.speed` measured and from nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

Row = dict[str, Any]
PARTS = {
    "ends": "exact feasibility at start and goal",
    "starts": "lattice chains",
    "refine": "Ipopt, energies included",
    "verify": "proof of candidates (inverse kinematics, collision)",
    "transitions": "all shared grasps, configurations, clearances",
}
BOUNDS = {
    "ends": "one exact check of every grasp at two poses",
    "starts": "reading the lattice's likelihoods once",
    "refine": "three passes of the network over the grasps, for each iteration",
    "verify": "one feasible branch for each transition",
    "transitions": "every branch of every shared grasp",
}


def table(header: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    """Return a Markdown table."""
    lines = ["| " + " | ".join(map(str, cells)) + " |" for cells in (header, *rows)]
    lines.insert(1, "|" + " --- |" * lines[0].count(" | ") + " --- |")
    return "\n".join(lines)


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
        "Langevin runs at the paper's setting (B = 1000, 20 iterations), with the same hard checks. Two and three "
        "regrasps are tasks with a dozen of the grasps, because with all of them nearly no task needs so many.",
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


def _plans(rows: list[Row]) -> str:
    groups: list[tuple[str, Callable[[Row], bool]]] = [
        ("one regrasp", lambda r: r["refiner"] == "ipopt" and r["N"] == 1),
        ("two or three regrasps", lambda r: r["refiner"] == "ipopt" and (r["N"] or 0) >= 2),
        ("without a plan", lambda r: r["refiner"] == "ipopt" and not r["solved"]),
        ("one regrasp, Langevin", lambda r: r["refiner"] == "langevin"),
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
            solved = sum(row["solved"] for row in chosen)
            ratio = ""
            if label.endswith("Langevin"):
                ours = [r["seconds"] for r in own if r["refiner"] == "ipopt" and r["N"] == 1][:compared]
                ratio = f"{np.median(seconds) / np.median(ours):.0f}x"
            lines.append(
                [
                    name,
                    label,
                    len(chosen),
                    f"{solved}",
                    f"{np.median(seconds):.3f}",
                    f"{np.percentile(seconds, 95):.3f}",
                    ratio,
                ]
            )
    header = ["object", "task", "plans", "solved", "median [s]", "p95 [s]", "Langevin / ours"]
    return table(header, lines)


def _breakdown(rows: list[Row]) -> str:
    chosen = [row for row in rows if row["refiner"] == "ipopt" and row["N"] == 1]
    total = float(np.median([row["seconds"] for row in chosen]))
    lines, known = [], 0.0
    for part, meaning in PARTS.items():
        seconds = float(np.median([row.get(f"t_{part}", 0.0) for row in chosen]))
        known += seconds
        lines.append([meaning, f"{1e3 * seconds:.1f}", f"{seconds / total:.0%}", BOUNDS[part]])
    lines.append(["the rest", f"{1e3 * max(total - known, 0.0):.1f}", f"{max(1 - known / total, 0.0):.0%}", ""])
    return table(["part", "median [ms]", "share", "bounded from below by"], lines)


def _derivatives(result: dict[str, float]) -> str:
    lines = []
    for kind in ("hessian", "gradient"):
        ours, plain = result[kind], result[f"plain_{kind}"]
        lines.append([kind, f"{1e3 * ours:.2f}", f"{1e3 * plain:.2f}", f"{plain / ours:.1f}x"])
    sizes = ", ".join(f"{axis} = {result[axis]}" for axis in "NGH")
    header = [f"`J_seq`, {sizes}", "ours [ms]", "CasADi on the plain expression [ms]", "ratio"]
    return f"{table(header, lines)}\n\nLargest difference: {result['difference']:.1e}."


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
        f"in `nova2-w`. A plain loop over the same {result['pairs']:,} pairs, with as many processes, reaches "
        f"{result['plain_per_second']:,.0f}; {result['different_labels']} labels differ."
    )


def _processes(rows: list[Row]) -> str:
    lines = []
    for what in dict.fromkeys(row["what"] for row in rows):
        chosen = [row for row in rows if row["what"] == what]
        seconds = np.median([row["seconds"] for row in chosen])
        peak = max(row["peak_mb"] for row in chosen)
        lines.append([what, len(chosen), f"{seconds:.2f}", f"{peak:.0f}", max(row["exit"] for row in chosen)])
    return table(["command", "runs", "median [s]", "peak memory [MB]", "exit"], lines)
