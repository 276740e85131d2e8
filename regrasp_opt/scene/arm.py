"""An arm in a workcell: the robot, where its base stands, and the tool on its flange."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.robots import Robot


@dataclass(frozen=True, eq=False)
class Arm:
    """A robot on its base with a tool.

    Attributes
    ----------
    robot : Robot
        Joints, limits, kinematics and collision bodies; it rests at `robot.home`.
    T_world_base : (4, 4) array
        Where the robot's base stands.
    end_effector : EndEffector
        The tool; its flange frame is the robot's tip frame.
    name : str
        Its name in plans.
    """

    robot: Robot
    T_world_base: FloatArray
    end_effector: EndEffector
    name: str = "arm"

    @cached_property
    def T_base_world(self) -> FloatArray:
        """The world frame seen from the base (4, 4)."""
        return invert(self.T_world_base)

    def T_world_tcp(self, q: ArrayLike) -> FloatArray:
        """Return the pose (..., 4, 4) of the TCP at configurations `q` (..., dof)."""
        T: FloatArray = self.T_world_base @ self.robot.forward(q) @ self.end_effector.T_flange_tcp
        return T
