"""An arm whose joint axes are exactly parallel, or meet exactly, where those of a given arm nearly are and do.

Analytic inverse kinematics needs such axes. A calibrated arm, or one whose URDF gives angles to a few digits, has
them only nearly; the arm next to it that has them says where the branches are, to a few times the difference.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray

NEARLY_PARALLEL = 5e-3
"""Sine of the angle between two axes up to which they are meant to be parallel."""
NEARLY_MEETING = 5e-3
"""Distance between two axes up to which they are meant to meet [m]."""


def parallel_runs(axes: FloatArray, tolerance: float = NEARLY_PARALLEL) -> list[list[int]]:
    """Return the indices of `axes` (N, 3) in runs of neighbours that are parallel, or opposite, to `tolerance`."""
    runs = [[0]]
    for i in range(1, len(axes)):
        if np.linalg.norm(np.cross(axes[i - 1], axes[i])) <= tolerance:
            runs[-1].append(i)
        else:
            runs.append([i])
    return runs


def senses(axes: FloatArray) -> FloatArray:
    """Return 1 or -1 for each of `axes` (N, 3), so that those of a parallel run times these point the same way."""
    out = np.ones(len(axes))
    for run in parallel_runs(axes):
        out[run] = np.where(axes[run] @ axes[run[0]] < 0, -1.0, 1.0)
    return out


def aligned(axes: FloatArray, points: FloatArray, meet_from: int) -> tuple[FloatArray, FloatArray]:
    """Return axes (N, 3) and points (N, 3) on them, with nearly parallel neighbours made parallel.

    From the index `meet_from` on, neighbours that nearly meet are moved to meet, and three that nearly share a
    point to share it.
    """
    axes, points, sense = axes.copy(), points.copy(), senses(axes)
    for run in parallel_runs(axes):
        mean = (sense[run, None] * axes[run]).sum(axis=0)
        axes[run] = sense[run, None] * mean / np.linalg.norm(mean)
    shared: FloatArray | None = None  # where the two axes before this one meet
    for i in range(meet_from + 1, len(axes)):
        normal = np.cross(axes[i - 1], axes[i])
        sine = np.linalg.norm(normal)
        if shared is not None:
            away = points[i] - shared
            away -= axes[i] * (axes[i] @ away)
            if np.linalg.norm(away) <= NEARLY_MEETING:
                points[i] -= away
                continue
        shared = None
        if sine > NEARLY_PARALLEL:
            gap = (points[i] - points[i - 1]) @ normal / sine
            if abs(gap) <= NEARLY_MEETING:
                points[i] -= gap * normal / sine
                along = np.cross(points[i] - points[i - 1], axes[i]) @ normal / sine**2
                shared = points[i - 1] + along * axes[i - 1]
    return axes, points
