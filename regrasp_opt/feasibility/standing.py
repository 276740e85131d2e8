"""Whether an object stands on a support: not in it, not over its edge, and, at rest, not about to tip over."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from regrasp_opt.conventions import RESTING_TOLERANCE, FloatArray
from regrasp_opt.scene import Support


def standing_problem(vertices: FloatArray, support: Support) -> str | None:
    """Return what keeps an object with `vertices` (V, 3), in the world, from being there, or None.

    It may be above the support, but neither in it by more than `RESTING_TOLERANCE` nor, where it stands on it, over
    the edge.
    """
    gap = float(vertices[:, 2].min()) - support.height
    if gap < -RESTING_TOLERANCE:
        return f"sinks {-gap * 1e3:.1f} mm into the {support.name}"
    touching = _touching(vertices, support)
    if len(touching) and (np.abs(touching - support.center) > support.size / 2).any():
        return f"stands over the edge of the {support.name}"
    return None


def resting_problem(vertices: FloatArray, center_of_mass: FloatArray, support: Support) -> str | None:
    """Return what keeps an object with `vertices` (V, 3) and `center_of_mass` (3,) from resting there, or None."""
    problem = standing_problem(vertices, support)
    if problem is not None:
        return problem
    gap = float(vertices[:, 2].min()) - support.height
    if gap > RESTING_TOLERANCE:
        return f"floats {gap * 1e3:.1f} mm above the {support.name}"
    if not _inside_hull(center_of_mass[:2], _touching(vertices, support)):
        return "would tip over"
    return None


def _touching(vertices: FloatArray, support: Support) -> FloatArray:
    """Return the points (S, 2) where the object touches a support."""
    return vertices[vertices[:, 2] - support.height <= RESTING_TOLERANCE, :2]


def _inside_hull(point: FloatArray, points: FloatArray) -> bool:
    """Return whether `point` (2,) lies in the convex hull of `points` (S, 2); never, where that has no area."""
    if len(points) < 3:
        return False
    try:
        hull = ConvexHull(points)
    except QhullError:
        return False
    return bool((hull.equations[:, :2] @ point + hull.equations[:, 2] <= 0).all())
