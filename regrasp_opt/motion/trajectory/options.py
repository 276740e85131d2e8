"""What can be chosen about motions, checked once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray, as_seed
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.errors import OptionError
from regrasp_opt.motion.trajectory.jaw_events import Squeeze
from regrasp_opt.motion.trajectory.trajectory import MotionLimits
from regrasp_opt.robots import Robot

ACCELERATION = 5.0
"""Largest joint acceleration when none is given [rad/s^2, m/s^2]; URDF files do not state one."""

LEAST_VELOCITY = 0.001
"""Smallest fraction of the velocity limits: slower is hardly intended."""
LEAST_SPEED = 1e-6
"""Least speed of a joint [rad/s, m/s]; exported URDF files often have limits of 0, and no motion ends with these."""
ACCELERATION_RANGE = 0.001, 1000.0
"""Joint accelerations that are believed [rad/s^2, m/s^2]."""
JERK_RANGE = 0.1, 1e5
"""Joint jerks that are believed [rad/s^3, m/s^3]."""


@dataclass(frozen=True, eq=False)
class MotionOptions:
    """Options of `plan_motion`.

    Attributes
    ----------
    home : (dof,) array_like, "robot" or None
        Configuration at which the motion begins and ends [rad]: the robot's home by default; with None it begins before
        the first approach and ends after the last retreat.
    velocity : float
        Fraction of the joints' velocity limits that is used, from 0.001 to 1.
    acceleration : float or (dof,) array_like
        Largest joint accelerations [rad/s^2], from 0.001 to 1000; for prismatic joints [m/s^2].
    jerk : float or (dof,) array_like, optional
        Largest joint jerks [rad/s^3], from 0.1 to 100,000; for prismatic joints [m/s^3]. Accelerations are continuous
        without it, too.
    distances : tuple of float
        Lengths of the straight approach, lift, lowering and retreat that are tried, in that order [m].
    candidates : int
        Shared grasps of a transition that are tried at most.
    iterations : int
        Steps of the sampling planner for one connection.
    jaw_time : float
        Time in which the jaw closes or opens while the arm rests, from 0.001 to 100 [s].
    squeeze : float
        How far below the grasp's width the jaw is told to close, from 0 to 0.05 [m]: a jaw that goes where it is told
        presses on the object by what is in its way.
    force : float, optional
        With which force the jaw is told to close, from 0.1 to 1000 [N]; for grippers that take one.
    optimise : bool
        Whether stops between the phases are taken out, where what results is verified.
    seed : int
        The same seed gives the same motion.

    Raises
    ------
    OptionError
        If a value is out of its range.
    """

    home: ArrayLike | str | None = "robot"
    velocity: float = 1.0
    acceleration: float | ArrayLike = ACCELERATION
    jerk: float | ArrayLike | None = None
    distances: tuple[float, ...] = (0.10, 0.06, 0.03)
    candidates: int = 40
    iterations: int = 400
    jaw_time: float = 0.5
    squeeze: float = 0.004
    force: float | None = None
    optimise: bool = True
    seed: int = 0

    def __post_init__(self) -> None:
        if not LEAST_VELOCITY <= self.velocity <= 1:
            raise OptionError(f"velocity is {self.velocity}; give a fraction from {LEAST_VELOCITY} to 1")
        if not self.distances or not all(0.005 <= d <= 1 for d in self.distances):
            raise OptionError(f"distances are {self.distances}; give lengths from 0.005 to 1 m")
        if not 0.001 <= self.jaw_time <= 100:
            raise OptionError(f"jaw_time is {self.jaw_time}; give a number of seconds from 0.001 to 100")
        if not 0 <= self.squeeze <= 0.05:
            raise OptionError(f"squeeze is {self.squeeze}; give a length from 0 to 0.05 m")
        if self.force is not None and not 0.1 <= self.force <= 1000:
            raise OptionError(f"force is {self.force}; give a number from 0.1 to 1000 N, or None")
        for name in ("candidates", "iterations"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
                raise OptionError(f"{name} is {value}; give a whole number from 1")
        as_seed(self.seed)

    def limits(self, robot: Robot) -> MotionLimits:
        """Return the limits of velocity, acceleration and jerk for `robot`; the last is infinite if none was given.

        Raises
        ------
        OptionError
            If accelerations or jerks are out of range or of another number than its joints, or a joint can hardly move.
        """
        acceleration = _each("acceleration", self.acceleration, ACCELERATION_RANGE, robot.dof)
        jerk = np.full(robot.dof, np.inf) if self.jerk is None else _each("jerk", self.jerk, JERK_RANGE, robot.dof)
        velocity = self.velocity * robot.velocity_limits
        slow = np.flatnonzero(~(velocity >= LEAST_SPEED))
        if len(slow):
            raise OptionError(
                f"joint '{robot.joint_names[slow[0]]}' may move at only {velocity[slow[0]]:g} rad/s or m/s; give it "
                "a velocity limit in the URDF, or a larger fraction"
            )
        return MotionLimits(velocity, acceleration, jerk)

    def squeeze_of(self, effector: EndEffector) -> Squeeze:
        """Return how the jaw of `effector` is told to hold; a suction cup squeezes nothing."""
        return Squeeze(self.squeeze, self.force) if effector.kind == "parallel" else Squeeze()

    def home_of(self, robot: Robot) -> FloatArray | None:
        """Return the configuration (dof,) at which the motion begins and ends, or None.

        Raises
        ------
        OptionError
            If it is not a configuration within the limits of `robot`.
        """
        if self.home is None:
            return None
        if isinstance(self.home, str):
            if self.home != "robot":
                raise OptionError(f"home is '{self.home}'; give joint positions, 'robot' or None")
            return robot.home
        return robot.configuration(self.home, "home")


def _each(name: str, value: ArrayLike, limits: tuple[float, float], dof: int) -> FloatArray:
    """Return `value`, one for all joints or one for each, for all joints (dof,)."""
    try:
        values = np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (dof,)))
    except (TypeError, ValueError) as error:
        raise OptionError(f"{name} must be one number or {dof} of them") from error
    least, most = limits
    if not ((values >= least) & (values <= most)).all():
        raise OptionError(f"{name} is {value!r}; give numbers from {least:g} to {most:g}")
    return values
