"""What the joint problem improves: travel of the joints, least clearance, manipulability, and the cost of the poses.

A plan lists all grasps that its transitions share; a robot executes one of each. A `JointChoice` says which, and in
which configurations. The first grasp listed by each transition is the choice that a plan stands for.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import OptionError
from regrasp_opt.planning import RegraspPlan, RegraspProblem
from regrasp_opt.robots import Robot
from regrasp_opt.robots.casadi_kinematics import flange_jacobian

ROUNDING = 1e-6
"""How far a measure may be from its bound [its unit]."""

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


@dataclass(frozen=True)
class MeasureBounds:
    """What to keep to: the most `travel` [rad] and `cost`, the least `clearance` [m] and `manipulability`.

    Raises
    ------
    OptionError
        If one of them is not a number.
    """

    travel: float = math.inf
    clearance: float = 0.0
    manipulability: float = 0.0
    cost: float = math.inf

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, (int, float, np.number)) or math.isnan(value):
                raise OptionError(f"the bound on the {name} is {value}; give a number")

    def tightened(self, measures: JointMeasures, names: Iterable[Measure]) -> MeasureBounds:
        """Return these bounds, those of `names` no looser than `measures`."""
        values = {
            name: (min if name == "travel" else max)(getattr(self, name), getattr(measures, name)) for name in names
        }
        return replace(self, **values)

    def shortfall(self, measures: JointMeasures) -> str:
        """Return the first bound that `measures` break and by how much, in words; empty where all hold."""
        for name, unit, sign in (
            ("travel", " rad", 1),
            ("clearance", " m", -1),
            ("manipulability", "", -1),
            ("cost", "", 1),
        ):
            value, bound = getattr(measures, name), getattr(self, name)
            excess = sign * (value - bound)
            if excess > ROUNDING:
                limit = f"at {'most' if sign > 0 else 'least'} {bound:.4g}{unit}"
                return f"the {name} is {value:.4g}{unit}, which misses the bound of {limit} by {excess:.2g}{unit}"
        return ""


def first_choice(plan: RegraspPlan) -> JointChoice:
    """Return the choice that `plan` stands for: the first grasp of each transition."""
    q = [np.stack([t.q_pick[0], t.q_place[0]]) for t in plan.transitions]
    return JointChoice(np.array([t.grasp_ids[0] for t in plan.transitions], dtype=np.int64), np.array(q))


def measure_choice(
    problem: RegraspProblem, poses: FloatArray, choice: JointChoice, home: FloatArray | None, cost: float
) -> JointMeasures:
    """Return the measures of `choice` at `poses` (N+2, 4, 4), whose ``J_seq`` is `cost`; `home` same as in `travel`."""
    least = clearances(problem, poses, choice).min()
    q = choice.q.reshape(-1, problem.workcell.arm.robot.dof)
    least_manipulability = manipulability(problem.workcell.arm.robot, q).min()
    return JointMeasures(travel(q, home), float(least), float(least_manipulability), float(cost))


def clearances(problem: RegraspProblem, poses: FloatArray, choice: JointChoice) -> FloatArray:
    """Return the clearances (N+1, 2) of `choice` at pick and place [m], `poses` being (N+2, 4, 4)."""
    values = [
        problem.checker.clearance(poses[i + side], int(choice.grasp_ids[i]), choice.q[i, side])
        for i, side in np.ndindex(choice.q.shape[:2])
    ]
    return np.array(values, dtype=np.float64).reshape(-1, 2)


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
