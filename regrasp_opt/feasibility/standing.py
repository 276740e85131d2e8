"""Whether an object stands on a support: not in it, not over its edge, and, at rest, not about to tip over."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from regrasp_opt.conventions import PLACEMENT_TOLERANCE, RESTING_TOLERANCE, BoolArray, FloatArray, invert
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene import Fixture, Support, Workcell


def standing_problem(vertices: FloatArray, support: Support) -> str | None:
    """Return what keeps an object with `vertices` (V, 3), in the world, from being there, or None.

    It may be above the support, but neither in it by more than `RESTING_TOLERANCE` nor, where it stands on it, over
    the edge.
    """
    gap, touching = _contact(vertices, support)
    if gap < -RESTING_TOLERANCE:
        return f"sinks {-gap * 1e3:.1f} mm into the {support.name}"
    if len(touching) and _beyond(touching, support).any():
        return f"stands over the edge of the {support.name}"
    return None


def stands_on(vertices: FloatArray, support: Support) -> bool:
    """Return whether an object with `vertices` (V, 3), in the world, touches a support from above."""
    gap, touching = _contact(vertices, support)
    return abs(gap) <= RESTING_TOLERANCE and not _beyond(touching, support).all()


def is_above(vertices: FloatArray, support: Support) -> bool:
    """Return whether all `vertices` (V, 3), in the world, are above the plane of a support; they may be beside it."""
    return _contact(vertices, support)[0] >= -RESTING_TOLERANCE


def resting_problem(vertices: FloatArray, center_of_mass: FloatArray, support: Support) -> str | None:
    """Return what keeps an object with `vertices` (V, 3) and `center_of_mass` (3,) from resting there, or None."""
    problem = standing_problem(vertices, support)
    if problem is not None:
        return problem
    gap, touching = _contact(vertices, support)
    if gap > RESTING_TOLERANCE:
        return f"floats {gap * 1e3:.1f} mm above the {support.name}"
    center, down = support.seen(center_of_mass), -support.T_world_support[2, :3]  # gravity in the support's frame
    if not _inside_hull(center[:2] - center[2] / down[2] * down[:2], touching):
        return "would tip over"
    return None


def beside_a_board(vertices: FloatArray, cell: Workcell) -> str | None:
    """Return what is wrong where an object with `vertices` (V, 3) that no board carries is level with one, or None."""
    level = (board for board in cell.boards if abs(_contact(vertices, board)[0]) <= RESTING_TOLERANCE)
    return next((f"stands over the edge of the {board.name}" for board in level), None)


def support_of(T: FloatArray, body: ObjectModel, cell: Workcell) -> int | None:
    """Return the number of the support in which, or on which, the object is at `T` (4, 4), or None.

    A fixture that holds it comes before boards that it touches, and of these the one that it touches most closely.
    """
    corners, gaps = body.corners @ T[:3, :3].T + T[:3, 3], dict[int, float]()
    for number, support in enumerate(cell.supports):
        if isinstance(support, Fixture):
            held = support.holding(T, PLACEMENT_TOLERANCE)
            if held is not None and held.object in (None, body.name):
                return number
        else:
            gaps[number] = abs(_contact(corners, support)[0])
    for number in sorted((k for k, gap in gaps.items() if gap <= RESTING_TOLERANCE), key=gaps.__getitem__):
        support = cell.supports[number]
        if isinstance(support, Support) and stands_on(body.vertices @ T[:3, :3].T + T[:3, 3], support):
            return number
    return None


def nearest_board(T: FloatArray, body: ObjectModel, cell: Workcell) -> Support:
    """Return the board that the object at `T` (4, 4) is nearest to, of those below or above its centre if there are."""
    vertices, center = body.vertices @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ body.center_of_mass + T[:3, 3]
    aside = [bool(_beyond(board.seen(center)[None, :2], board).any()) for board in cell.boards]
    gaps = [abs(_contact(vertices, board)[0]) for board in cell.boards]
    return cell.boards[min(range(len(gaps)), key=lambda k: (aside[k], gaps[k]))]


def rest_problem(T: FloatArray, body: ObjectModel, cell: Workcell) -> str | None:
    """Return what keeps the object from resting on any support at `T` (4, 4), or None.

    Where it touches none, the nearest board is named.
    """
    vertices, center = body.vertices @ T[:3, :3].T + T[:3, 3], T[:3, :3] @ body.center_of_mass + T[:3, 3]
    number = support_of(T, body, cell)
    support = nearest_board(T, body, cell) if number is None else cell.supports[number]
    if isinstance(support, Fixture):
        return None
    problem = resting_problem(vertices, center, support)
    rolls = problem is None and body.rolls(invert(support.T_world_support) @ T)
    return "would roll" if rolls else problem


def _contact(vertices: FloatArray, support: Support) -> tuple[float, FloatArray]:
    """Return the height of the lowest of `vertices` (V, 3) above the plane of a support, and where they touch it."""
    seen = support.seen(vertices)
    return float(seen[:, 2].min()), seen[seen[:, 2] <= RESTING_TOLERANCE, :2]


def _beyond(points: FloatArray, support: Support) -> BoolArray:
    """Return which `points` (S, 2) in the plane of a support are beyond its edges."""
    return np.asarray((np.abs(points - support.center) > support.size / 2).any(axis=1))


def _inside_hull(point: FloatArray, points: FloatArray) -> bool:
    """Return whether `point` (2,) lies in the convex hull of `points` (S, 2); never, where that has no area."""
    if len(points) < 3:
        return False
    try:
        hull = ConvexHull(points)
    except QhullError:
        return False
    return bool((hull.equations[:, :2] @ point + hull.equations[:, 2] <= 0).all())
