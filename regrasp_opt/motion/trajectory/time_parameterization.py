"""Paths and their fastest timing within limits of velocity, acceleration and jerk.

Along a path ``q(s)`` the square ``x = s'^2`` of the path speed makes both limits linear (Bobrow, Dubowsky and Gibson,
1985; Verscheure et al., 2009): with ``x`` piecewise linear over a grid and ``u = dx/ds / 2``,

    |dq/ds|^2 x <= v_max^2,        |d2q/ds2 x + dq/ds u| <= a_max.

Raising ``x`` anywhere makes the motion faster, so the fastest motion is the largest ``x``: a linear program. The knots
it gives are joined by cubics.

Accelerations of such a rough motion jump. What is executed is the uniform cubic B-spline whose control points it passes
at intervals of ``h``. Positions, speeds and accelerations of the spline are weighted means of those that the rough
motion has nearby, so limits that hold for that hold for the spline. Its accelerations are continuous, and zero at both
rests; it takes ``2 h`` longer. The whole is slowed down by what still exceeds a limit.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BSpline, CubicSpline
from scipy.optimize import linprog
from scipy.sparse import csr_array

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory.trajectory import MotionLimits, Trajectory, joined

LINE_GRID = 24
"""Intervals of the timing grid along a straight line of the tool."""

PATH_GRID = 40
"""Intervals of the timing grid along a path with corners."""

PIECES = 150, 100, 70, 50, 35, 25, 17, 12
"""Intervals ``h`` in a run: the first, or with a limit of jerk the one for which it ends first."""

LEAST = 25
"""Least number of them where a run is of several parts, of which some are lines of the tool that stay straight."""

SHORTEST = 1e-3
"""Least interval [s]; where a run is cut into its parts, at least half of that is cut off a cubic."""


def through(waypoints: FloatArray) -> CubicSpline:
    """Return the smooth path over s in [0, 1] through `waypoints` (W, dof), which are evenly spaced along it."""
    return CubicSpline(np.linspace(0.0, 1.0, len(waypoints)), waypoints)


def rounded(corners: FloatArray, spacing: float) -> BSpline:
    """Return a smooth path over s in [0, 1] along the polyline with `corners` (C, dof).

    It is the cubic B-spline whose control points stand at most `spacing` apart on the polyline: it begins and ends
    with it, follows its straight parts, and cuts a corner within `spacing` of it.
    """
    parts = [
        np.linspace(a, b, max(2, int(np.ceil(np.linalg.norm(b - a) / spacing))), endpoint=False)
        for a, b in itertools.pairwise(corners)
    ]
    control = np.concatenate([*parts, corners[-1:]])
    if len(control) < 4:
        control = np.linspace(corners[0], corners[-1], 4)
    knots = np.concatenate([np.zeros(3), np.linspace(0.0, 1.0, len(control) - 2), np.ones(3)])
    return BSpline(knots, control, 3)


def smoothed(parts: Sequence[Trajectory], limits: MotionLimits) -> list[Trajectory]:
    """Return a run from rest to rest, of `parts` whose accelerations may jump, with continuous ones within `limits`.

    Each part begins where the one before it ends, and as fast.
    """
    rough = joined(list(parts))
    marks = np.cumsum([part.duration for part in parts])[:-1]
    found = list[tuple[Trajectory, FloatArray]]()
    counts = PIECES if np.isfinite(limits.jerk).any() else PIECES[:1]
    for pieces in counts if len(parts) == 1 else [count for count in counts if count >= LEAST]:
        step = max(rough.duration / pieces, SHORTEST)
        spline = _spline_along(rough, step)
        slow = spline.within(limits)
        knots = np.floor(marks / step) * step
        cuts = step + knots + np.clip(marks - knots, SHORTEST / 2, step - SHORTEST / 2)
        found.append((slow, cuts * (slow.duration / spline.duration)))
    best, cuts = min(found, key=lambda each: each[0].duration)
    return best.split(cuts)


def _spline_along(rough: Trajectory, step: float) -> Trajectory:
    """Return the uniform cubic B-spline whose control points `rough` passes every `step` seconds."""
    count = int(np.ceil(rough.duration / step - 1e-9))
    c = rough.at(step * np.arange(-2, count + 3))
    c[:3], c[-3:] = rough.positions[0], rough.positions[-1]  # exactly, so that it rests at both ends
    positions: FloatArray = (c[:-2] + 4 * c[1:-1] + c[2:]) / 6
    positions[[0, -1]] = rough.positions[[0, -1]]
    return Trajectory(step * np.arange(count + 3.0), positions, (c[2:] - c[:-2]) / (2 * step))


def rest_to_rest(start: FloatArray, end: FloatArray, limits: MotionLimits) -> Trajectory:
    """Return the fastest straight motion between two configurations (dof,): speed up, cruise, slow down."""
    change = end - start
    size = np.abs(change)
    cruise = float((limits.velocity / np.maximum(size, 1e-12)).min())  # of the path [1/s, 1/s^2]
    rise = float((limits.acceleration / np.maximum(size, 1e-12)).min())
    ramp = min(cruise / rise, 1 / np.sqrt(rise))
    speed = rise * ramp
    middle = max(0.0, (1 - ramp * speed) / speed)
    times = np.array([0.0, ramp, ramp + middle, 2 * ramp + middle])
    part = np.array([0.0, ramp * speed / 2, 1 - ramp * speed / 2, 1.0])
    keep = np.concatenate([[True], np.diff(times) > 1e-9 * times[-1]])
    speeds = np.array([0.0, speed, speed, 0.0])[keep, None]
    positions = start + part[keep, None] * change
    positions[-1] = end
    return smoothed([Trajectory(times[keep], positions, speeds * change)], limits)[0]


def fastest(path: BSpline | CubicSpline, limits: MotionLimits, grid: int) -> Trajectory:
    """Return the fastest motion from rest to rest along `path` over s in [0, 1], timed on a `grid` of it."""
    s = np.linspace(0.0, 1.0, grid + 1)
    first, second = path(s, 1), path(s, 2)
    x = _path_speeds(first, second, limits.velocity, limits.acceleration)
    root = np.sqrt(x)
    times = np.concatenate([[0.0], np.cumsum(2 / grid / (root[1:] + root[:-1]))])
    return smoothed([Trajectory(times, path(s), first * root[:, None])], limits)[0]


def _path_speeds(first: FloatArray, second: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the largest squared path speeds at the grid points, zero at both ends."""
    count, dof = first.shape
    with np.errstate(divide="ignore"):
        upper = ((velocity / np.abs(first)) ** 2).min(axis=1)
        upper = np.minimum(upper, (acceleration / np.abs(second)).min(axis=1))
    upper[[0, -1]] = 0.0
    # Rows: at both ends of every interval and for each joint, second x + first (x_next - x_this) / (2 ds).
    k, slope = np.arange(count - 1), first * (count - 1) / 2
    rows = np.zeros((2, count - 1, dof, count))
    rows[0, k, :, k], rows[0, k, :, k + 1] = second[:-1] - slope[:-1], slope[:-1]
    rows[1, k, :, k], rows[1, k, :, k + 1] = -slope[1:], second[1:] + slope[1:]
    A = (rows / acceleration[:, None]).reshape(-1, count)
    top = float(np.max(upper[np.isfinite(upper)], initial=1.0))
    bounds = np.column_stack([np.zeros(count), np.minimum(upper, top)])
    solution = linprog(-np.ones(count), A_ub=csr_array(np.vstack([A, -A])), b_ub=np.ones(2 * len(A)), bounds=bounds)
    return np.maximum(solution.x, 0.0)
