"""What the joint problem improves: travel of the joints, least clearance, manipulability, and the cost of the poses."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.robots import Robot

ROUNDING = 1e-6
"""How far a measure may be from its bound [its unit]."""

Measure = Literal["travel", "clearance", "manipulability"]
MEASURES: tuple[Measure, ...] = ("travel", "clearance", "manipulability")


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
        tighter = {name: min if name == "travel" else max for name in names}
        return replace(self, **{n: pick(getattr(self, n), getattr(measures, n)) for n, pick in tighter.items()})

    def shortfall(self, measures: JointMeasures) -> str:
        """Return the first bound that `measures` break and by how much, in words; empty where all hold."""
        signs = ("travel", " rad", 1), ("clearance", " m", -1), ("manipulability", "", -1), ("cost", "", 1)
        for name, unit, sign in signs:
            value, bound = getattr(measures, name), getattr(self, name)
            excess = sign * (value - bound)
            if excess > ROUNDING:
                limit = f"at {'most' if sign > 0 else 'least'} {bound:.4g}{unit}"
                return f"the {name} is {value:.4g}{unit}, which misses the bound of {limit} by {excess:.2g}{unit}"
        return ""


def travel(q: FloatArray, home: FloatArray | None = None) -> float:
    """Return the length of the path through `q` (M, dof), from and back to `home` (dof,) where it is given [rad]."""
    if home is not None:
        q = np.vstack([home, q, home])
    return float(np.linalg.norm(np.diff(q, axis=0), axis=1).sum())


def manipulability(robot: Robot, q: FloatArray) -> FloatArray:
    """Return ``sqrt(det(J J'))`` (M,) of configurations `q` (M, dof)."""
    model, data, tip = robot.model, robot.model.createData(), robot.model.getFrameId(robot.tip_frame)
    jacobians = [pin.computeFrameJacobian(model, data, x, tip) for x in q]
    J = np.array(jacobians).reshape(-1, 6, robot.dof)
    return np.sqrt(np.maximum(np.linalg.det(J @ np.swapaxes(J, 1, 2)), 0.0))
