"""Sampling a grasp set: candidates in rounds until there is a choice, then those that lie farthest apart.

A grasp is worth something where the table leaves room for the gripper, so candidates without room in every stable
placement are taken only if there are not enough others: such a grasp needs the table's edge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.distance import cdist

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, pose_distance
from regrasp_opt.end_effectors import END_EFFECTOR_NAMES, EndEffector, load_end_effector
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.grasps.antipodal import antipodal_candidates, contact_pairs
from regrasp_opt.grasps.candidates import NONE, GraspCandidates
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.grasps.suction import suction_candidates
from regrasp_opt.grasps.surface import make_surface
from regrasp_opt.grasps.table import TableRoom
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene import Clearance

POINTS = 100
"""Surface points of one round."""

ROUNDS = 30
"""Most rounds of sampling."""

FIRST_ROUNDS = 10
"""Rounds after which a placement that still has few candidates is left as it is, and an object that has none."""

GRADED_ROUNDS = 3
"""Rounds after which candidates of all grades are enough."""

CHOICE = {"parallel": 8, "suction": 4}
"""Rounds stop when there are this many candidates for each grasp asked for; of cups, more of them fit."""

FAIR = 0.5
"""Share of a set that goes to the placements in equal parts, where they have as many candidates."""

SAME_POSITION, SAME_ANGLE = 1e-3, 0.02
"""Grasps closer than this in both [m] and [rad] count as the same."""

DIRECTION_WEIGHT = 0.25
"""Weight of a unit change of direction when grasps are spread, as a share of the object's mean extent."""


def sample_grasps(
    model: ObjectModel,
    end_effector: EndEffector,
    count: int = 200,
    *,
    seed: int = 0,
    exclude: GraspSet | None = None,
    clearance: float = Clearance().gripper,
) -> GraspSet:
    """Return up to `count` grasps of the object, spread over its surface and over approach directions.

    Grasps at which the gripper stays above the table, by the `clearance` of the workcell [m], in some stable placement
    come first, and each placement gets its share of them. A grasp and its mirror image (half a turn about the approach)
    are different grasps to an arm, and both may occur. The same arguments give the same set, which is disjoint from
    `exclude`; fewer than `count` come back where sampling finds no more.

    The gripper open to ``width + 2 * pre_opening``, or closed to ``width + 2 * CONTACT_TOLERANCE``, is clear of the
    object.

    Raises
    ------
    GraspError, OptionError
        If no grasp of the end-effector fits the object, or `count` is less than 1.
    """
    if count < 1:
        raise OptionError(f"count is {count}; ask for at least one grasp")
    rng, room = np.random.default_rng(seed), TableRoom.of(model, end_effector, clearance)
    surface, gripper = make_surface(model.mesh), GripperClearance(model.vertices, model.faces, end_effector)
    candidates = antipodal_candidates if end_effector.kind == "parallel" else suction_candidates
    widest = end_effector.max_opening - 2 * end_effector.pre_opening
    scale = DIRECTION_WEIGHT * float(np.ptp(model.vertices, axis=0).mean())

    def draw(wanted: TableRoom | None) -> GraspCandidates:
        drawn = candidates(surface, end_effector, gripper, wanted, POINTS, rng)
        return drawn.where(_unseen(drawn.T_object_tcp, exclude))

    found = NONE
    for wanted in (room, None) if model.placements else (None,):
        if len(found.width) < count:
            pool = _pool(draw, wanted, CHOICE[end_effector.kind] * count)
            usable = np.zeros((len(pool.width), 0), dtype=bool) if wanted is None else wanted.free(*pool[:2])
            found = _spread(pool, found, usable, count, scale, lambda T, width: gripper.fitting(T, width, widest))
    if len(found.width) == 0:
        why = _why_none(model, end_effector)
        raise GraspError(f"no grasp of end-effector '{end_effector.name}' fits object '{model.name}': {why}")
    return GraspSet(found.T_object_tcp, found.width, end_effector.kind)


def _why_none(model: ObjectModel, end_effector: EndEffector) -> str:
    """Return why nothing fits an object, and what to do: what is opposed on it, if anything, and how far apart."""
    if end_effector.kind == "suction":
        radius = f"{1e3 * end_effector.cup_radius:.0f} mm"
        return f"nowhere is there room for a cup of radius {radius} to seal; use a smaller cup or a gripper"
    widest = end_effector.max_opening - 2 * end_effector.pre_opening
    extent = float(np.linalg.norm(np.ptp(model.vertices, axis=0)))
    any_jaw = replace(end_effector, max_opening=extent + 2 * end_effector.pre_opening)
    surface, rng = make_surface(model.mesh), np.random.default_rng(0)
    widths = contact_pairs(surface, any_jaw, ROUNDS * POINTS, rng)[2]
    if not len(widths):
        return "it has no two faces opposite each other; use a suction cup, or check the mesh"
    if widths.min() <= widest:
        return "its opposite sides cannot be reached with the gripper clear of it; use a slimmer one or a suction cup"
    tools = [load_end_effector(name) for name in END_EFFECTOR_NAMES]
    wide = [tool.name for tool in tools if tool.max_opening - 2 * tool.pre_opening > widths.min()]
    use = f"use one that opens wider ({', '.join(wide)})" if wide else "use a suction cup"
    return (
        f"it is too wide: opposite sides are at least {1e3 * widths.min():.0f} mm apart, and the gripper takes "
        f"{1e3 * widest:.0f} mm; {use}, or check the object's scale"
    )


def _pool(draw: Callable[[TableRoom | None], GraspCandidates], room: TableRoom | None, enough: int) -> GraspCandidates:
    """Return the candidates of the best grades that together are `enough`, else of all grades."""
    pool = NONE
    for number in range(ROUNDS):
        wanted = room
        if number >= FIRST_ROUNDS and len(pool.width) == 0:
            break
        if len(pool.width) >= enough and (number >= GRADED_ROUNDS or (pool.grade == 0).sum() >= enough):
            if room is None or number >= FIRST_ROUNDS:
                break
            few = room.free(*pool[:2]).sum(axis=0) < FAIR * enough / len(room.up)
            if not few.any():
                break
            wanted = room.among(few)
        pool = pool.extended(draw(wanted))
    for grade in np.unique(pool.grade):
        good = pool.grade <= grade
        if good.sum() >= enough:
            return pool.where(good)
    return pool


def _spread(
    pool: GraspCandidates,
    found: GraspCandidates,
    usable: BoolArray,
    count: int,
    scale: float,
    fitting: Callable[[FloatArray, FloatArray], FloatArray],
) -> GraspCandidates:
    """Return `found` with some of `pool` (N) up to `count`: each next one lies farthest from all before it and fits.

    Those `usable` (N, S) in a placement come first, in equal parts up to a share of `FAIR`, the rarest placement first.
    It stops early when only repetitions are left. The exact test `fitting` is made of no more than it takes.
    """
    features = _features(pool.T_object_tcp, scale)
    distance = cdist(features, _features(found.T_object_tcp, scale)).min(axis=1, initial=np.inf)
    share = int(FAIR * count / max(usable.shape[1], 1))
    steps = [(usable[:, k], share) for k in np.argsort(usable.sum(axis=0))]
    steps.append((np.ones(len(features), dtype=bool), count - len(found.width)))
    left, width = np.ones(len(features), dtype=bool), pool.width.copy()
    chosen = np.zeros(0, dtype=np.int64)
    for among, number in steps:
        while len(rows := _farthest(features, distance, left & among, number - int(among[chosen].sum()))):
            left[rows] = False
            width[rows] = fitting(pool.T_object_tcp[rows], pool.width[rows])
            rows = rows[np.isfinite(width[rows])]
            chosen = np.concatenate([chosen, rows])
            distance = np.minimum(distance, cdist(features, features[rows]).min(axis=1, initial=np.inf))
    return found.extended(GraspCandidates(pool.T_object_tcp[chosen], width[chosen], pool.grade[chosen]))


def _features(T: FloatArray, scale: float) -> FloatArray:
    return np.hstack([T[:, :3, 3], scale * T[:, :3, 1], scale * T[:, :3, 2]])


def _farthest(features: FloatArray, distance: FloatArray, among: BoolArray, count: int) -> IntArray:
    """Return up to `count` rows of `features` (N, F) far from each other and, by `distance` (N,), from those before."""
    rows = np.flatnonzero(among)
    features, distance = features[rows], distance[rows]
    chosen: list[int] = []
    while len(chosen) < count and distance.max(initial=0.0) > SAME_POSITION:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return rows[chosen]


def _unseen(T: FloatArray, exclude: GraspSet | None) -> BoolArray:
    """Return which poses (N, 4, 4) are none of the excluded ones (N,)."""
    seen = np.zeros(len(T), dtype=bool)
    for other in [] if exclude is None else exclude.T_object_tcp:
        distance, angle = pose_distance(T, other)
        seen |= (distance < SAME_POSITION) & (angle < SAME_ANGLE)
    return ~seen
