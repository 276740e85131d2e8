"""What the joint problem improves: travel of the joints, least clearance, manipulability, and the cost of the poses.

A plan lists all grasps that its transitions share; a robot executes one of each. A `JointChoice` says which, and in
which configurations. The first grasp listed by each transition is the choice that a plan stands for.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.robots import Robot
from regrasp_opt.robots.casadi_kinematics import flange_jacobian

Measure = Literal["travel", "clearance", "manipulability"]
MEASURES: tuple[Measure, ...] = ("travel", "clearance", "manipulability")


@dataclass(frozen=True, eq=False)
class JointChoice:
    """One grasp for each of the N+1 transitions and its configurations.

    Attributes
    ----------
    grasp_ids : (N+1,)
        Numbers into ``problem.grasps``.
    q : (N+1, 2, dof)
        Configurations at pick and place [rad, m].
    """

    grasp_ids: IntArray
    q: FloatArray


@dataclass(frozen=True)
class JointMeasures:
    """How good a sequence of configurations is.

    Attributes
    ----------
    travel : float
        Length of the path through all configurations in joint space, straight from one to the next, Euclidean norm
        [rad]; from and back to the home configuration where one is given.
    clearance : float
        Least distance of arm and gripper to table and obstacles, and of the arm to the object [m].
    manipulability : float
        Least ``sqrt(det(J J'))`` of the flange's Jacobian (Yoshikawa, "Manipulability of robotic mechanisms", 1985).
    cost : float
        ``J_seq`` of the poses (Eq. 5).
    """

    travel: float
    clearance: float
    manipulability: float
    cost: float

    def loss(self, measure: Measure) -> float:
        """Return the measure such that less is better."""
        value = float(getattr(self, measure))
        return value if measure == "travel" else -value


def first_choice(plan: RegraspPlan) -> JointChoice:
    """Return the choice that `plan` stands for: the first grasp of each transition."""
    q = [np.stack([t.q_pick[0], t.q_place[0]]) for t in plan.transitions]
    return JointChoice(np.array([t.grasp_ids[0] for t in plan.transitions], dtype=np.int64), np.array(q))


def measure_choice(
    plan: RegraspPlan, choice: JointChoice, home: FloatArray | None = None, cost: float | None = None
) -> JointMeasures:
    """Return the measures of `choice` at the poses of `plan`.

    Parameters
    ----------
    home : (dof,), optional
        Where the arm starts and ends [rad, m].
    cost : float, optional
        ``J_seq`` of the poses, where it is not that of `plan`.
    """
    checker, robot = plan.problem.checker, plan.problem.workcell.robot
    clearances = [
        checker.clearance(plan.poses[i + side], grasp_id, choice.q[i, side])
        for i, grasp_id in enumerate(choice.grasp_ids.tolist())
        for side in (0, 1)
    ]
    q = choice.q.reshape(-1, robot.dof)
    least = min(clearances), manipulability(robot, q).min()
    return JointMeasures(travel(q, home), float(least[0]), float(least[1]), plan.cost if cost is None else cost)


def travel(q: FloatArray, home: FloatArray | None = None) -> float:
    """Return the length of the path through `q` (M, dof), from and back to `home` (dof,) where it is given [rad]."""
    if home is not None:
        q = np.vstack([home, q, home])
    return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())


def manipulability(robot: Robot, q: FloatArray) -> FloatArray:
    """Return ``sqrt(det(J J'))`` (M,) of configurations `q` (M, dof)."""
    J = np.array(_jacobian(robot).map(len(q))(q.T)).reshape(6, len(q), -1).transpose(1, 0, 2)
    return np.sqrt(np.maximum(np.linalg.det(J @ np.swapaxes(J, 1, 2)), 0.0))


@lru_cache(maxsize=8)
def _jacobian(robot: Robot) -> Any:
    return flange_jacobian(robot)
