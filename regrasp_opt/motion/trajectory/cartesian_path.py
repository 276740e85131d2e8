"""Straight lines of the tool: joint waypoints that move it along a vector without turning it.

Newton's method on the pose error, from waypoint to waypoint, so that the arm stays on one branch of its inverse
kinematics (Siciliano et al., Robotics, section 3.7). It works for every arm, with and without analytic solutions.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.robots import Robot

SPACING = 0.005
"""Distance between waypoints of a line [m]."""

_CONVERGED = 1e-9
"""Pose error at which a waypoint counts as reached [m, rad]."""

_LARGEST_STEP = 0.15
"""Joint change between neighbouring waypoints beyond which the arm is too near to a singularity [rad, m]."""

_ITERATIONS = 12


def line(robot: Robot, q: FloatArray, direction: FloatArray, length: float) -> FloatArray | None:
    """Return waypoints (W, dof) that move the tip from where it is at `q` (dof,) along a straight line.

    Parameters
    ----------
    direction : (3,)
        Unit vector in the base frame.
    length : float
        [m]

    Returns
    -------
    (W, dof) array or None
        The first waypoint is `q`; None if joint limits, reach or a singularity are in the way.
    """
    model, data = robot.model, robot.model.createData()
    frame = model.getFrameId(robot.tip_frame)
    pin.framesForwardKinematics(model, data, q)
    start = data.oMf[frame].copy()
    count = max(2, int(np.ceil(length / SPACING)))
    points = [np.asarray(q, dtype=np.float64)]
    for i in range(1, count + 1):
        target = pin.SE3(start.rotation, start.translation + direction * (length * i / count))
        guess = points[-1] if i == 1 else 2 * points[-1] - points[-2]
        found = _solve(robot, data, frame, guess, target)
        if found is None or np.abs(found - points[-1]).max() > _LARGEST_STEP or not robot.within_limits(found):
            return None
        points.append(found)
    return np.array(points)


def _solve(robot: Robot, data: pin.Data, frame: int, q: FloatArray, target: pin.SE3) -> FloatArray | None:
    for _ in range(_ITERATIONS):
        pin.computeJointJacobians(robot.model, data, q)
        error = pin.log6(pin.updateFramePlacement(robot.model, data, frame).actInv(target)).vector
        if np.abs(error).max() < _CONVERGED:
            return q
        jacobian = pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL)
        step = np.linalg.lstsq(jacobian, error, rcond=1e-6)[0]
        if np.abs(step).max() > 1.0:
            return None
        q = q + step
    return None
