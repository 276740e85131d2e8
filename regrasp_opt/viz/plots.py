"""Plots of a plan's cost with matplotlib (extra ``viz``): over the poses that were possible, and by iteration.

They use the colours of the page: cost runs from dark to light, and no two things are told apart by hue alone.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from regrasp_opt.connectivity.objective import exact_energy
from regrasp_opt.errors import OptionError
from regrasp_opt.files import atomic_path
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.solvers.lattice import YAWS
from regrasp_opt.viz.candidates import RANGE, CandidateTrace
from regrasp_opt.viz.fields import cost_field, has_energy

COLOURS = "viridis"

START, HERE, GOAL = "#0072b2", "#d55e00", "#009e73"
"""Colours that colour-blind people tell apart (Okabe and Ito)."""


def pyplot() -> Any:
    """Return matplotlib's pyplot; an `OptionError` says if matplotlib is not installed."""
    try:
        import matplotlib.pyplot as plt
    except ImportError as error:
        raise OptionError("plots need matplotlib; install 'regrasp-opt[viz]'") from error
    return plt


def write_plan_plots(plan: RegraspPlan, trace: CandidateTrace | None, folder: Path) -> list[Path]:
    """Write the cost over the table for each intermediate pose, over all lattice poses, and by iteration.

    Raises an `OptionError` if matplotlib or the energy is missing, or the plan has no intermediate pose.
    """
    if not has_energy(plan):
        raise OptionError("the plots show the cost, which needs an energy; run 'regrasp-opt prepare WORKCELL' first")
    if plan.num_regrasps == 0 and trace is None:
        raise OptionError("the plan has no intermediate pose whose cost could be plotted")
    plt = pyplot()
    plt.switch_backend("agg")
    figures = {f"landscape-{i}": plot_cost_landscape(plan, i) for i in range(1, plan.num_regrasps + 1)}
    if plan.num_regrasps == 1:
        figures["poses"] = plot_pose_distribution(plan)
    if trace is not None:
        figures["candidates"] = plot_cost_traces(trace)
    folder.mkdir(parents=True, exist_ok=True)
    paths = {folder / f"{name}.png": figure for name, figure in figures.items()}
    for path, figure in paths.items():
        with atomic_path(path) as temporary:
            figure.savefig(temporary, dpi=120, format="png")
        plt.close(figure)
    return list(paths)


def plot_cost_landscape(plan: RegraspPlan, number: int = 1, turns: int = 4) -> Any:
    """Return a matplotlib figure of `J_seq` (Eq. 5) where intermediate pose `number` is moved and turned.

    Parameters
    ----------
    plan : RegraspPlan
        With at least one regrasp.
    number : int
        Which intermediate pose, 1 to N; the others stay.
    turns : int
        Panels, each with the pose turned further by ``2 pi / turns``; the first shows it as it is.

    Raises
    ------
    OptionError
        If the plan has no such pose, or matplotlib is not installed.
    """
    plt = pyplot()
    if not 1 <= number <= plan.num_regrasps:
        raise OptionError(f"there is no intermediate pose {number}; the plan has {plan.num_regrasps}")
    angles = 2 * np.pi * np.arange(turns) / turns
    panels = [cost_field(plan, number, angle) for angle in angles]
    low = min(float(p.cost.min()) for p in panels)
    figure, axes = plt.subplots(1, turns, figsize=(3.2 * turns, 2.7), layout="constrained", sharey=True, squeeze=False)
    for ax, panel, angle in zip(axes[0], panels, angles, strict=True):
        image = ax.pcolormesh(panel.x, panel.y, panel.cost, vmin=low, vmax=low + RANGE, cmap=COLOURS, shading="nearest")
        _mark_ends(ax, plan)
        if angle == 0:
            ax.plot(*panel.here, "*", color=HERE, markeredgecolor="white", markersize=15, label="plan")
        ax.set_title(f"turned by {np.degrees(angle):.0f}°")
    _label(figure, axes, image)
    where = f"placement {plan.problem.rests[plan.placements[number - 1]].label}"
    figure.suptitle(f"{plan.problem.object.name}: cost of intermediate pose {number} on {where}")
    return figure


def plot_pose_distribution(plan: RegraspPlan) -> Any:
    """Return a matplotlib figure of `J_seq` of single intermediate poses of the lattice, after the paper's Fig. 6.

    Each arrow is a pose between the plan's start and goal: it begins at (x, y), points along the yaw that is best
    there, and is coloured by cost; there is one panel for each stable placement.

    Parameters
    ----------
    plan : RegraspPlan

    Raises
    ------
    OptionError
        If matplotlib is not installed.
    """
    plt = pyplot()
    problem, lattice = plan.problem, plan.problem.lattice
    start, goal = (exact_energy(problem.feasible_grasps(plan.poses[i])) for i in (0, -1))
    objective = problem.objective(start, goal)
    movable = ~np.isfinite(problem.rests.planar.high[lattice.placements, 2])  # not in a fixture
    numbers, at = lattice.placements[movable, None], lattice.xi[movable, None]
    cost = objective.cost(numbers, at, np.float32).reshape(-1, YAWS)
    best = np.flatnonzero(movable)[np.arange(len(cost)) * YAWS + cost.argmin(axis=1)]
    placements, xi, cost = lattice.placements[best], lattice.xi[best], cost.min(axis=1)
    low = float(cost.min())
    shown = np.unique(placements)
    count = len(shown)
    figure, axes = plt.subplots(1, count, figsize=(3.0 * count, 2.5), layout="constrained", sharey=True, squeeze=False)
    for number, ax in zip(shown, axes[0], strict=True):
        here = placements == number
        x, y, yaw = xi[here].T
        arrows = ax.quiver(
            x, y, np.cos(yaw), np.sin(yaw), cost[here],
            cmap=COLOURS, clim=(low, low + RANGE), angles="xy", scale=17, width=0.009,
        )  # fmt: skip
        _mark_ends(ax, plan)
        ax.set_title(f"placement {problem.rests[number].label}: best {cost[here].min():.1f}")
    _label(figure, axes, arrows)
    figure.suptitle(f"{problem.object.name}: cost of one intermediate pose, by stable placement")
    return figure


def plot_cost_traces(trace: CandidateTrace) -> Any:
    """Return a matplotlib figure of `J_seq` (Eq. 5) of the candidates against the iteration.

    The line that ends in a star became the plan. Costs far above the least are cut off at the top.
    """
    plt = pyplot()
    figure, ax = plt.subplots(figsize=(5.4, 3.4), layout="constrained")
    frames, count = trace.cost.shape
    for b in range(count):
        picked = b == trace.accepted
        style = {"color": HERE, "linewidth": 2.2, "zorder": 3} if picked else {"color": START, "alpha": 0.5}
        ax.plot(range(frames), trace.cost[:, b], **style)
        if picked:
            ax.plot(frames - 1, trace.cost[-1, b], "*", color=HERE, markersize=14, zorder=4, label="the plan")
            ax.legend()
    low, high = float(trace.cost.min()), float(trace.cost.max())
    ax.set_ylim(low - 0.05 * min(high - low, RANGE) - 0.01, min(high, low + 2 * RANGE) + 0.01)
    ax.set_xlabel("iteration")
    ax.set_ylabel("J_seq")
    ax.set_title(f"{trace.refiner}: {count} candidates, {trace.xi.shape[2]} intermediate pose(s)")
    return figure


def _label(figure: Any, axes: Any, coloured: Any) -> None:
    """Name the axes of a row of panels of the table, seen from above, what is marked, and the colours."""
    for ax in axes[0]:
        ax.set_xlabel("x [m]")
        ax.set_aspect("equal")
    axes[0, 0].set_ylabel("y [m]")
    axes[0, 0].legend(loc="lower center", ncols=3, fontsize="small")
    figure.colorbar(coloured, ax=axes, label="J_seq", extend="max")


def _mark_ends(ax: Any, plan: RegraspPlan) -> None:
    center = np.append(plan.problem.object.center_of_mass, 1.0)
    for T, name, marker, colour in ((plan.poses[0], "start", "s", START), (plan.poses[-1], "goal", "o", GOAL)):
        x, y = (T @ center)[:2]
        ax.plot(x, y, marker, color=colour, markeredgecolor="white", markersize=9, label=name, linestyle="none")
