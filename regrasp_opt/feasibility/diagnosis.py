"""Why grasps are not feasible: for each (pose, grasp) pair the cause that keeps the arm from holding it there.

Causes are looked for in the order of the check (`checker`). Where the arm reaches a grasp in several configurations,
the one with the fewest colliding pairs of bodies counts, since it is the nearest to being free.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.feasibility.checker import FeasibilityChecker

TOLD_POSES, TOLD_GRASPS = 40, 25
"""Poses, and grasps at each, that say why none is feasible anywhere."""


class Cause(Enum):
    """What makes a grasp infeasible; the value is how messages say it."""

    OBJECT = "object"
    OUT_OF_REACH = "out of reach"
    GRIPPER_IN_TABLE = "gripper in table"
    NO_CONFIGURATION = "no inverse kinematics within the joint limits"
    GRIPPER_IN_OBSTACLE = "gripper in"
    ARM_IN_TABLE = "arm in table"
    ARM_IN_OBJECT = "wrist or arm in object"
    ARM_IN_OBSTACLE = "arm in"
    SELF_COLLISION = "self-collision of"

    @property
    def advice(self) -> str:
        """What helps against it."""
        return _ADVICE[self]


_ADVICE = {
    Cause.OBJECT: "move the object away",
    Cause.OUT_OF_REACH: "move the pose or the workspace nearer to the robot",
    Cause.GRIPPER_IN_TABLE: "use a placement that stands higher, grasps from above, or a slimmer end-effector",
    Cause.NO_CONFIGURATION: "move or turn the pose, give more grasps, or check joint limits and the tip",
    Cause.GRIPPER_IN_OBSTACLE: "move the pose or the obstacle",
    Cause.ARM_IN_TABLE: "move the pose nearer, or mount the robot higher",
    Cause.ARM_IN_OBJECT: "give other grasps, or a longer end-effector",
    Cause.ARM_IN_OBSTACLE: "move the pose or the obstacle",
    Cause.SELF_COLLISION: "move the pose away from the robot's base, or give more grasps",
}


class Reason(NamedTuple):
    """Why one grasp is infeasible at one pose.

    Attributes
    ----------
    cause : Cause
    bodies : tuple of str
        What is hit: the obstacle, or the two bodies of arm and gripper; empty where the cause says it all.
    """

    cause: Cause
    bodies: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the cause with the names of bodies."""
        return " ".join([self.cause.value, " and ".join(self.bodies)]).strip()


def diagnose(checker: FeasibilityChecker, T: FloatArray, grasp_ids: IntArray | None = None) -> list[Reason | None]:
    """Return why each of the grasps is infeasible at one pose; None for those that are feasible.

    Parameters
    ----------
    checker : FeasibilityChecker
    T : (4, 4)
        T_world_object.
    grasp_ids : (K,), optional
        All G by default.
    """
    ids = np.arange(len(checker.grasps)) if grasp_ids is None else np.asarray(grasp_ids, dtype=np.int64)
    problem = checker.object_problem(T)
    if problem is not None:
        return [Reason(Cause.OBJECT, (problem,))] * len(ids)
    T_world_flange = checker.flange_poses(T, ids)
    reached = checker.in_reach(T_world_flange)
    in_table = checker.gripper_in_table(T_world_flange, ids)
    branches = checker.branches(np.broadcast_to(T, (len(ids), 4, 4)), ids)
    rest = np.setdiff1d(np.flatnonzero(reached & ~in_table), branches.pair)
    reached[rest] = checker.workcell.arm.robot.reaches(checker.workcell.arm.T_base_world @ T_world_flange[rest])
    found: list[Reason | None] = []
    for k, grasp_id in enumerate(ids.tolist()):
        if not reached[k]:
            found.append(Reason(Cause.OUT_OF_REACH))
        elif in_table[k]:
            found.append(Reason(Cause.GRIPPER_IN_TABLE))
        else:
            found.append(_collision(checker, T, grasp_id, branches.q[branches.pair == k]))
    return found


def diagnose_poses(
    checker: FeasibilityChecker, poses: Sequence[FloatArray] | FloatArray, rng: np.random.Generator
) -> list[Reason | None]:
    """Return why grasps fail at the first `TOLD_POSES` of `poses` (B, 4, 4), for `TOLD_GRASPS` at each."""
    count = len(checker.grasps)
    ids = np.sort(rng.choice(count, min(TOLD_GRASPS, count), replace=False))
    return [failure for T in poses[:TOLD_POSES] for failure in diagnose(checker, T, ids)]


def tally(failures: Iterable[Reason | None]) -> Counter[Reason]:
    """Return how often each failure occurs."""
    return Counter(failure for failure in failures if failure is not None)


def summary(failures: Iterable[Reason | None], shown: int = 6) -> str:
    """Return the counts of `failures`, the most frequent first, and what helps against that cause."""
    ordered = tally(failures).most_common()
    texts = [f"{count} {failure}" for failure, count in ordered[:shown]]
    rest = sum(count for _, count in ordered[shown:])
    texts += [f"{rest} otherwise"] if rest else []
    causes: Counter[Cause] = Counter()
    for failure, count in ordered:
        causes[failure.cause] += count
    return f"{', '.join(texts)}; {causes.most_common(1)[0][0].advice}" if texts else "all are feasible"


def _collision(checker: FeasibilityChecker, T: FloatArray, grasp_id: int, branches: FloatArray) -> Reason | None:
    """Return what the configurations (M, dof) of a grasp collide with, None if one of them is free."""
    least: list[tuple[int, int]] = []
    for q in branches:
        pairs = checker.collisions(T, grasp_id, q)
        if not pairs:
            return None
        least = pairs if not least or len(pairs) < len(least) else least
    if not least:
        return Reason(Cause.NO_CONFIGURATION)
    return min((_named(checker, pair) for pair in least), key=lambda failure: list(Cause).index(failure.cause))


def _named(checker: FeasibilityChecker, pair: tuple[int, int]) -> Reason:
    """Return the failure that a colliding pair of the scene's bodies means; the second may stand still."""
    world, (moving, other) = checker.world, pair
    is_gripper, labels = moving in world.gripper, [world.bodies[i].label for i in pair]
    if other in world.supports:
        return Reason(Cause.GRIPPER_IN_TABLE if is_gripper else Cause.ARM_IN_TABLE)
    if other == world.object:
        return Reason(Cause.ARM_IN_OBJECT)
    if other in world.surroundings:
        cause = Cause.GRIPPER_IN_OBSTACLE if is_gripper else Cause.ARM_IN_OBSTACLE
        return Reason(cause, (f"obstacle '{labels[1]}'",))
    return Reason(Cause.SELF_COLLISION, (f"'{labels[0]}'", f"'{labels[1]}'"))
