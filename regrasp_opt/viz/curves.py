"""Curves with matplotlib (extra ``viz``): how candidates converge, how costs vary along a sweep, how soon plans come.

Lines differ in colour and in dash or marker, so that nobody needs to tell hues apart.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from regrasp_opt.errors import OptionError
from regrasp_opt.viz.candidates import RANGE, CandidateTrace

INKS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#e69f00", "#56b4e9")
"""Colours that colour-blind people tell apart (Okabe and Ito)."""
DASHES = ("-", "--", ":", "-.")
COSTS = {"J": "J_seq", "J+": "J+_seq", "Jh": "J^h_seq"}


def pyplot() -> Any:
    """Return matplotlib's pyplot.

    Raises
    ------
    OptionError
        If matplotlib is not installed.
    """
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise OptionError("plots need matplotlib; install 'regrasp-opt[viz]'") from error
    return plt


def plot_cost_traces(trace: CandidateTrace) -> Any:
    """Return a matplotlib figure of `J_seq` (Eq. 5) of the candidates against the iteration.

    The line that ends in a star became the plan. Costs far above the least are cut off at the top.
    """
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(5.4, 3.4), layout="constrained")
    frames, count = trace.cost.shape
    for b in range(count):
        picked = b == trace.accepted
        style = {"color": INKS[1], "linewidth": 2.2, "zorder": 3} if picked else {"color": INKS[0], "alpha": 0.5}
        ax.plot(range(frames), trace.cost[:, b], **style)
        if picked:
            ax.plot(frames - 1, trace.cost[-1, b], "*", color=INKS[1], markersize=14, zorder=4, label="the plan")
            ax.legend()
    low, high = float(trace.cost.min()), float(trace.cost.max())
    ax.set_ylim(low - 0.05 * min(high - low, RANGE) - 0.01, min(high, low + 2 * RANGE) + 0.01)
    ax.set_xlabel("iteration")
    ax.set_ylabel("J_seq")
    ax.set_title(f"{trace.refiner}: {count} candidates, {trace.xi.shape[2]} intermediate pose(s)")
    return figure


def plot_cost_sweep(rows: Sequence[Mapping[str, Any]], title: str) -> Any:
    """Return a matplotlib figure of the costs along a sweep, after the paper's Fig. 5.

    Parameters
    ----------
    rows : sequence of mappings
        Those of one pair in ``rows.csv`` of ``bench cost-sweep``: ``step``, ``grasps``, the costs ``J``, ``J+`` and
        ``Jh``, and the exact numbers of shared grasps ``shared_start``, ``shared_goal`` and ``shared_all``.
    title : str

    Raises
    ------
    OptionError
        If there are no rows, or matplotlib is not installed.
    """
    plt = pyplot()
    if not rows:
        raise OptionError("there is no sweep to plot; run 'regrasp-opt bench cost-sweep'")
    counts = sorted({int(row["grasps"]) for row in rows})
    figure, axes = plt.subplots(1, 4, figsize=(13.0, 3.2), layout="constrained")
    for ax, (variant, name) in zip(axes, COSTS.items(), strict=False):
        for (ink, dash), count in zip(_styles(), counts, strict=False):
            ax.plot(*_column(rows, count, variant), dash, color=ink, label=f"{count} grasps")
        ax.set_title(name)
        ax.set_ylabel("cost")
    for (ink, dash), key in zip(_styles(), ("shared_start", "shared_goal", "shared_all"), strict=False):
        axes[-1].plot(*_column(rows, counts[-1], key), dash, color=ink, label=key.replace("shared_", "with "))
    axes[-1].set_title(f"shared grasps (exact), of {counts[-1]}")
    axes[-1].set_ylabel("grasps")
    for ax in axes:
        ax.set_xlabel("step, from goal to start")
    axes[0].legend(fontsize="small")
    axes[-1].legend(fontsize="small")
    figure.suptitle(title)
    return figure


def plot_anytime(times: Mapping[str, Sequence[float | None]], title: str, limit: float | None = None) -> Any:
    """Return a matplotlib figure of the share of pairs with a verified plan over time.

    Parameters
    ----------
    times : mapping
        For each curve, by name, the seconds to the first verified plan of every pair; None where none was found.
    title : str
    limit : float, optional
        Seconds after which planners gave up; the curves run to there.

    Raises
    ------
    OptionError
        If there is nothing to plot, or matplotlib is not installed.
    """
    plt = pyplot()
    found = {name: sorted(t for t in all_ if t is not None) for name, all_ in times.items()}
    if not any(found.values()):
        raise OptionError("no pair was solved, so there is no curve to plot")
    figure, ax = plt.subplots(figsize=(6.4, 3.8), layout="constrained")
    end = max(limit or 0.0, *(solved[-1] for solved in found.values() if solved))
    begin = 0.8 * min(solved[0] for solved in found.values() if solved)
    for (ink, dash), (name, solved) in zip(_styles(), found.items(), strict=False):
        share = 100 * np.arange(len(solved) + 1) / max(1, len(times[name]))
        ax.step([begin, *solved, end], [*share, share[-1]], dash, where="post", color=ink, label=name)
    ax.set_xscale("log")
    ax.set_xlim(begin, end)
    ax.set_ylim(0, 102)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("pairs with a verified plan [%]")
    ax.set_title(title)
    ax.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def _styles() -> Any:
    """Yield pairs of colour and dash; the first 28 differ."""
    return zip(itertools.cycle(INKS), itertools.cycle(DASHES), strict=False)


def _column(rows: Sequence[Mapping[str, Any]], count: int, key: str) -> tuple[list[int], list[float]]:
    here = sorted((int(row["step"]), float(row[key])) for row in rows if int(row["grasps"]) == count)
    return [step for step, _ in here], [value for _, value in here]
