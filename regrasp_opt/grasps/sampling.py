"""Sampling a grasp set: candidates in rounds until there is a choice, then those that lie farthest apart."""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, pose_distance
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.grasps.antipodal import antipodal_candidates
from regrasp_opt.grasps.candidates import GraspCandidates
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.grasps.suction import suction_candidates
from regrasp_opt.grasps.surface import make_surface
from regrasp_opt.objects import ObjectModel

ROUNDS = 10
"""Most rounds of sampling."""

POINTS = 300
"""Surface points of one round."""

CHOICE = 4
"""Rounds stop when there are this many candidates for each grasp asked for."""

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
) -> GraspSet:
    """Return up to `count` grasps of the object, spread over its surface and over approach directions.

    A grasp and its mirror image (half a turn about the approach) are different grasps to an arm, and both may
    occur. The same arguments give the same set. Fewer than `count` come back where sampling finds no more.

    Parameters
    ----------
    model : ObjectModel
        The object.
    end_effector : EndEffector
        Decides between antipodal and suction sampling.
    count : int
        Number of grasps asked for, at least 1.
    seed : int
        Seed of the sampling.
    exclude : GraspSet, optional
        Grasps that must not come again; the result is disjoint from them.

    Returns
    -------
    GraspSet
        TCP poses in the object frame: the gripper open to ``width + 2 * pre_opening``, or closed to
        ``width + 2 * CONTACT_TOLERANCE``, is clear of the object.

    Raises
    ------
    GraspError
        If no grasp of the end-effector fits the object.
    OptionError
        If `count` is less than 1.
    """
    if count < 1:
        raise OptionError(f"count is {count}; ask for at least one grasp")
    pool = _candidates(model, end_effector, count, np.random.default_rng(seed), exclude)
    if len(pool.width) == 0:
        raise GraspError(
            f"no grasp of end-effector '{end_effector.name}' fits object '{model.name}'; "
            "use a wider gripper, a smaller cup or check the object's scale"
        )
    T, width = pool.T_object_tcp, pool.width
    scale = DIRECTION_WEIGHT * float(np.ptp(model.vertices, axis=0).mean())
    chosen = _farthest_points(np.hstack([T[:, :3, 3], scale * T[:, :3, 1], scale * T[:, :3, 2]]), count)
    return GraspSet(T[chosen], width[chosen], end_effector.kind)


def _candidates(
    model: ObjectModel,
    end_effector: EndEffector,
    count: int,
    rng: np.random.Generator,
    exclude: GraspSet | None,
) -> GraspCandidates:
    """Return the candidates of the best grades that together are enough for `count`, else of all grades."""
    surface = make_surface(model.mesh)
    clearance = GripperClearance(model.vertices, model.faces, end_effector)
    draw = antipodal_candidates if end_effector.kind == "parallel" else suction_candidates
    rounds: list[GraspCandidates] = []
    while len(rounds) < ROUNDS and sum(len(drawn.width) for drawn in rounds) < CHOICE * count:
        drawn = draw(surface, end_effector, clearance, POINTS, rng)
        rounds.append(drawn.where(_unseen(drawn.T_object_tcp, exclude)))
    pool = GraspCandidates(*(np.concatenate(parts) for parts in zip(*rounds, strict=True)))
    for grade in np.unique(pool.grade):
        good = pool.grade <= grade
        if good.sum() >= CHOICE * count:
            return pool.where(good)
    return pool


def _unseen(T: FloatArray, exclude: GraspSet | None) -> BoolArray:
    """Return which poses (N, 4, 4) are none of the excluded ones (N,)."""
    seen = np.zeros(len(T), dtype=bool)
    for other in [] if exclude is None else exclude.T_object_tcp:
        distance, angle = pose_distance(T, other)
        seen |= (distance < SAME_POSITION) & (angle < SAME_ANGLE)
    return ~seen


def _farthest_points(features: FloatArray, count: int) -> IntArray:
    """Return up to `count` rows that lie far apart: each next one is farthest from all before it.

    It starts at the row nearest to the mean, and stops early when only repetitions are left.
    """
    start = int(np.argmin(np.linalg.norm(features - features.mean(axis=0), axis=1)))
    chosen, distance = [start], np.linalg.norm(features - features[start], axis=1)
    while len(chosen) < count and distance.max() > SAME_POSITION:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return np.array(chosen, dtype=np.int64)
