"""Why grasps are not feasible: for each (pose, grasp) pair the cause that keeps the arm from holding it there.

Causes are looked for in the order of the check (`checker`). Where the arm reaches a grasp in several configurations,
the one with the fewest colliding pairs of bodies counts, since it is the nearest to being free. `obstructions` has all
that is in the way, of every configuration: without it, the grasp is feasible.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.feasibility.checker import FeasibilityChecker
from regrasp_opt.robots import Robot

_NEARLY_ALL = 0.95
TOLD_POSES, TOLD_GRASPS = 40, 25
"""Poses, and grasps at each, that say why none is feasible anywhere."""


class Cause(Enum):
    """What makes a grasp infeasible; the value is how messages say it.

    The last three are for `regrasp_opt.planning.explanation`: a pose is refused, the grasps that would do need a wider
    jaw, and neighbouring poses have feasible grasps, but none in common.
    """

    OBJECT = "object"
    OUT_OF_REACH = "out of reach"
    GRIPPER_IN_TABLE = "gripper in table"
    JOINT_LIMIT = "joint limit of"
    NO_CONFIGURATION = "no inverse kinematics within the joint limits"
    GRIPPER_IN_OBSTACLE = "gripper in"
    ARM_IN_TABLE = "arm in table"
    ARM_IN_OBJECT = "wrist or arm in object"
    ARM_IN_OBSTACLE = "arm in"
    SELF_COLLISION = "self-collision of"
    REFUSED = "the object cannot be there"
    TOO_WIDE = "too wide for"
    NOT_SHARED = "no shared grasp"

    @property
    def advice(self) -> str:
        """What helps against it."""
        return _ADVICE[self]


_ADVICE = {
    Cause.OBJECT: "move the object away",
    Cause.OUT_OF_REACH: "move the pose or the workspace nearer to the robot",
    Cause.GRIPPER_IN_TABLE: "use a placement that stands higher, grasps from above, or a slimmer end-effector",
    Cause.JOINT_LIMIT: "turn or move the pose, or give more grasps",
    Cause.NO_CONFIGURATION: "move or turn the pose, give more grasps, or check joint limits and the tip",
    Cause.GRIPPER_IN_OBSTACLE: "move the pose or the obstacle",
    Cause.ARM_IN_TABLE: "move the pose nearer, or mount the robot higher",
    Cause.ARM_IN_OBJECT: "give other grasps, or a longer end-effector",
    Cause.ARM_IN_OBSTACLE: "move the pose or the obstacle",
    Cause.SELF_COLLISION: "move the pose away from the robot's base, or give more grasps",
    Cause.REFUSED: "choose another pose",
    Cause.TOO_WIDE: "use an end-effector that opens wider, or a suction cup",
    Cause.NOT_SHARED: "allow more regrasps, give more grasps, or move one of the poses",
}


class Reason(NamedTuple):
    """Why one grasp is infeasible at one pose.

    Attributes
    ----------
    cause : Cause
    bodies : tuple of str
        What is hit: the obstacle, or the two bodies of arm and gripper; for limits, the joints. Empty where the cause
        says it all.
    """

    cause: Cause
    bodies: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Return the cause with the names of bodies."""
        return " ".join([self.cause.value, " and ".join(self.bodies)]).strip()

    @property
    def thing(self) -> str:
        """What is in the way, whatever runs into it."""
        return _THINGS.get(self.cause, str(self)) if self.cause not in OBSTACLES else self.bodies[0]


OBSTACLES = Cause.GRIPPER_IN_OBSTACLE, Cause.ARM_IN_OBSTACLE
_THINGS = {
    Cause.GRIPPER_IN_TABLE: "table",
    Cause.ARM_IN_TABLE: "table",
    Cause.ARM_IN_OBJECT: "object",
    Cause.SELF_COLLISION: "arm itself",
}


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
    limits = _limits(checker.workcell.arm.robot, checker.workcell.arm.T_base_world @ T_world_flange[rest])
    beyond = dict(zip(rest.tolist(), limits, strict=True))
    found: list[Reason | None] = []
    for k, grasp_id in enumerate(ids.tolist()):
        if not reached[k]:
            found.append(Reason(Cause.OUT_OF_REACH))
        elif in_table[k]:
            found.append(Reason(Cause.GRIPPER_IN_TABLE))
        else:
            found.append(beyond.get(k) or _collision(checker, T, grasp_id, branches.q[branches.pair == k]))
    return found


def obstructions(
    checker: FeasibilityChecker, T: FloatArray, grasp_ids: IntArray | None = None
) -> list[list[frozenset[Reason]]]:
    """Return for each grasp all that is in its way at one pose, for each configuration that would reach it.

    Limits are among the reasons of arms of up to six joints with an analytic solver. A set that is empty
    means that the grasp is feasible, and no set that it is out of reach. Of sets that hold others, these are kept.

    Parameters
    ----------
    checker, T, grasp_ids
        Same as in `diagnose`.
    """
    ids = np.arange(len(checker.grasps)) if grasp_ids is None else np.asarray(grasp_ids, dtype=np.int64)
    arm, problem = checker.workcell.arm, checker.object_problem(T)
    common = frozenset() if problem is None else frozenset([Reason(Cause.OBJECT, (problem,))])
    T_world_flange = checker.flange_poses(T, ids)
    in_table = checker.gripper_in_table(T_world_flange, ids)
    targets = arm.T_base_world @ T_world_flange
    known = arm.robot.solve_without_limits(targets) if arm.robot.dof <= 6 else None  # else too many
    solutions = arm.robot.solve_ik(targets) if known is None else known
    found: list[list[frozenset[Reason]]] = [[] for _ in ids]
    beyond = arm.robot.beyond_limits(solutions.q)
    for q, k, outside in zip(solutions.q, solutions.pose_index.tolist(), beyond, strict=True):
        reasons = {_named(checker, pair) for pair in checker.collisions(T, int(ids[k]), q)}
        reasons |= {Reason(Cause.GRIPPER_IN_TABLE)} if in_table[k] else set()
        reasons |= {_limit(arm.robot, outside)} if outside.any() else set()
        found[k].append(common | reasons)
    return [[each for each in dict.fromkeys(sets) if not any(other < each for other in sets)] for sets in found]


def diagnose_poses(
    checker: FeasibilityChecker, poses: Sequence[FloatArray] | FloatArray, rng: np.random.Generator
) -> list[Reason | None]:
    """Return why grasps of `checker` fail at the first `TOLD_POSES` of `poses` (B, 4, 4), for `TOLD_GRASPS` at each.

    These grasps are drawn by `rng`.
    """
    count = len(checker.grasps)
    ids = np.sort(rng.choice(count, min(TOLD_GRASPS, count), replace=False))
    return [failure for T in poses[:TOLD_POSES] for failure in diagnose(checker, T, ids)]


def tally(failures: Iterable[Reason | None]) -> Counter[Reason]:
    """Return how often each of the `failures` occurs."""
    return Counter(failure for failure in failures if failure is not None)


def summary(failures: Iterable[Reason | None], shown: int = 6) -> str:
    """Return the counts of `failures`, the `shown` most frequent first, and what helps against the most frequent cause.

    The gripper in the table is not asked unless nearly all fail so: these grasps fail wherever the object is moved.
    """
    ordered = tally(failures).most_common()
    texts = [f"{count} {failure}" for failure, count in ordered[:shown]]
    rest = sum(count for _, count in ordered[shown:])
    texts += [f"{rest} otherwise"] if rest else []
    causes: Counter[Cause] = Counter()
    for failure, count in ordered:
        causes[failure.cause] += count
    if causes[Cause.GRIPPER_IN_TABLE] < _NEARLY_ALL * causes.total():
        del causes[Cause.GRIPPER_IN_TABLE]
    return f"{', '.join(texts)}; {causes.most_common(1)[0][0].advice}" if texts else "all are feasible"


def _limits(robot: Robot, T_base_tip: FloatArray) -> list[Reason]:
    """Return why poses (B, 4, 4) are not reached within the limits: the joints of the configuration with the fewest."""
    solutions = robot.solve_without_limits(T_base_tip)
    if solutions is None:
        return [Reason(Cause.NO_CONFIGURATION)] * len(T_base_tip)
    found = [Reason(Cause.NO_CONFIGURATION if near else Cause.OUT_OF_REACH) for near in robot.reaches(T_base_tip)]
    beyond = robot.beyond_limits(solutions.q)
    for k in np.argsort(-beyond.sum(axis=1), kind="stable"):  # the fewest last
        found[solutions.pose_index[k]] = _limit(robot, beyond[k])
    return found


def _limit(robot: Robot, beyond: BoolArray) -> Reason:
    names = [f"'{name}'" for name, outside in zip(robot.joint_names, beyond, strict=True) if outside]
    return Reason(Cause.JOINT_LIMIT if names else Cause.NO_CONFIGURATION, tuple(names))


def _collision(checker: FeasibilityChecker, T: FloatArray, grasp_id: int, branches: FloatArray) -> Reason | None:
    """Return what the configurations (M, dof) of a grasp collide with, None if one of them is free."""
    least: list[tuple[int, int]] = []
    for q in branches:
        pairs = checker.collisions(T, grasp_id, q)
        if not pairs:
            return None
        least = pairs if not least or len(pairs) < len(least) else least
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
