"""A motion plan: what the arm and the jaw do to carry out a regrasp plan, with its files."""

from __future__ import annotations

import os
from dataclasses import dataclass

from regrasp_opt.motion.motion_data import MotionData
from regrasp_opt.motion.trajectory.motion_file import load_motion, save_motion, save_motion_csv
from regrasp_opt.motion.trajectory.scene_export import save_scene


@dataclass(frozen=True, eq=False)
class MotionPlan(MotionData):
    """What `plan_motion` returns.

    Attributes
    ----------
    status : MotionStatus
        SOLVED only if every segment was verified.
    reason : str
        What failed, in one sentence; empty if solved.
    plan : RegraspPlan
        The poses and grasps that are carried out.
    segments : tuple of Segment
        In order, each beginning where the one before it ends, and as fast; empty unless solved.
    velocity_limits, acceleration_limits : (dof,) float64
        What the motion was planned for [rad/s, rad/s^2].
    seconds : float
        How long planning the motion took.
    """

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the motion with its plan to `path` as JSON, atomically (docs/motion.md)."""
        save_motion(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> MotionPlan:
        """Return the motion in the file `path`, with the plan that it carries out.

        Raises
        ------
        PlanFileError
            If the file is missing, malformed, or its object or workcell has changed since.
        """
        return load_motion(path, MotionPlan)

    def save_csv(self, path: str | os.PathLike[str], step: float = 0.01) -> None:
        """Write positions and velocities of all joints at every `step` seconds to `path` as CSV, atomically.

        Raises
        ------
        OptionError, PlanFileError
            If `step` is not a positive number of seconds or gives more than a million rows, or there is no motion.
        """
        save_motion_csv(self, path, step)

    def save_scene(self, folder: str | os.PathLike[str]) -> None:
        """Write robot, gripper, table, obstacles and object as URDF, and where they stand, into `folder`."""
        save_scene(self.plan, folder)
