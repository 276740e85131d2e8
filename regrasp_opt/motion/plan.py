"""A motion plan: what the arm and the jaw do, one segment after the other, to carry out a regrasp plan."""

from __future__ import annotations

import os
from dataclasses import dataclass
from enum import Enum

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.trajectory import Trajectory
from regrasp_opt.planning import RegraspPlan


class Phase(Enum):
    """What a segment is for; the value says it."""

    REACH = "the arm moves, the jaw empty, to where the approach begins"
    APPROACH = "the open jaw moves along a straight line to the grasp"
    GRASP = "the jaw closes, the arm rests"
    LIFT = "the object is lifted along a straight line"
    TRANSFER = "the object is carried to above its next pose"
    LOWER = "the object is lowered along a straight line"
    RELEASE = "the jaw opens, the arm rests"
    RETREAT = "the open jaw moves back along a straight line"
    RETURN = "the arm returns home"

    @property
    def holds(self) -> bool:
        """Whether the object moves with the hand."""
        return self in (Phase.LIFT, Phase.TRANSFER, Phase.LOWER)


class MotionStatus(Enum):
    """How motion planning ended; the value is the sentence to show, and says what to try next."""

    SOLVED = "solved: every segment was proved free of collision and within the joint limits"
    NO_PLAN = "the regrasp plan is not solved, so there is nothing to move; plan again first"
    HOME_BLOCKED = "the home configuration collides; choose another home, or None"
    NO_MOTION = (
        "no shared grasp of a transition admits a motion; try plan_with_motion, more iterations, or shorter distances"
    )


@dataclass(frozen=True, eq=False)
class Segment:
    """A part of a motion; the arm rests while the jaw closes or opens.

    Attributes
    ----------
    phase : Phase
    transition : int
        Number of the plan's transition; for the way home that of the last one.
    grasp_id : int
        Number into ``problem.grasps`` of the transition's grasp.
    trajectory : Trajectory
    jaw : (float, float)
        Opening of the jaw at the beginning and at the end [m]; 0 for suction.
    """

    phase: Phase
    transition: int
    grasp_id: int
    trajectory: Trajectory
    jaw: tuple[float, float]


@dataclass(frozen=True, eq=False)
class MotionPlan:
    """What `plan_motion` returns.

    Attributes
    ----------
    status : MotionStatus
        SOLVED only if every segment was proved.
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

    status: MotionStatus
    reason: str
    plan: RegraspPlan
    segments: tuple[Segment, ...]
    velocity_limits: FloatArray
    acceleration_limits: FloatArray
    seconds: float

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is MotionStatus.SOLVED

    @property
    def duration(self) -> float:
        """How long the motion takes [s]."""
        return float(sum(segment.trajectory.duration for segment in self.segments))

    @property
    def starts(self) -> FloatArray:
        """When each segment begins (S,) [s]."""
        durations = [segment.trajectory.duration for segment in self.segments]
        return np.concatenate([[0.0], np.cumsum(durations)])[:-1] if durations else np.zeros(0)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the motion with its plan to `path` as JSON, whole or not at all (docs/motion.md)."""
        from regrasp_opt.motion.motion_file import save_motion

        save_motion(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> MotionPlan:
        """Return the motion in the file `path`, with the plan that it carries out.

        Raises
        ------
        PlanFileError
            If the file is missing, malformed, or its object or workcell has changed since.
        """
        from regrasp_opt.motion.motion_file import load_motion

        return load_motion(path)

    def save_csv(self, path: str | os.PathLike[str], step: float = 0.01) -> None:
        """Write positions and velocities of all joints at every `step` seconds to `path` as CSV, whole or not at all.

        Raises
        ------
        OptionError, PlanFileError
            If `step` is no positive number of seconds or gives more than a million rows, or there is no motion.
        """
        from regrasp_opt.motion.motion_file import save_motion_csv

        save_motion_csv(self, path, step)

    def save_scene(self, folder: str | os.PathLike[str]) -> None:
        """Write robot, gripper, table, obstacles and object as URDF, and where they stand, into `folder`."""
        from regrasp_opt.motion.scene_export import save_scene

        save_scene(self.plan, folder)
