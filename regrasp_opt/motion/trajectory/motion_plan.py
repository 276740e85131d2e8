"""A motion plan: what the arm and the jaw do to carry out a regrasp plan, with its files."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError, PlanFileError
from regrasp_opt.files import atomic_path
from regrasp_opt.motion.motion_data import MotionStatus, Segment
from regrasp_opt.motion.trajectory.jaw_events import JawEvent, Squeeze, jaw_events
from regrasp_opt.motion.trajectory.motion_file import SCHEMA, read_motion
from regrasp_opt.motion.trajectory.scene_export import save_scene
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.notebook import PageInNotebook
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.planning.plan_file import plan_content, plan_from_content
from regrasp_opt.robots import Robot

MOST_ROWS = 10**6
"""Rows of a CSV at most; these are some 150 MB."""

JUMP = 1e-6
"""Largest jump between segments that counts as none [rad, rad/s; prismatic joints and the jaw: m, m/s]."""

ROUNDING = 1e-6
"""By which share a speed may be above its limit."""


@dataclass(frozen=True, eq=False)
class MotionPlan(PageInNotebook):
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
    jerk_limits : (dof,) float64 or None
        Same as those above, where they were given [rad/s^3].
    squeeze : Squeeze
        How the jaw is told to hold the object.
    """

    status: MotionStatus
    reason: str
    plan: RegraspPlan
    segments: tuple[Segment, ...]
    velocity_limits: FloatArray
    acceleration_limits: FloatArray
    seconds: float
    jerk_limits: FloatArray | None = None
    squeeze: Squeeze = field(default_factory=Squeeze)

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
        return np.cumsum([0.0, *durations])[: len(durations)]

    @property
    def jaw_events(self) -> tuple[JawEvent, ...]:
        """What the jaw is told, in order; the first event says how it must stand as the motion begins."""
        return jaw_events(self.segments, self.squeeze)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the motion with its plan to `path` as JSON, atomically (docs/motion.md)."""
        with atomic_path(path) as temporary:
            temporary.write_text(json.dumps(motion_content(self), allow_nan=False) + "\n", encoding="utf-8")

    @staticmethod
    def load(path: str | os.PathLike[str]) -> MotionPlan:
        """Return the motion in the file `path`, with the plan that it carries out.

        Raises
        ------
        PlanFileError
            If the file is missing, malformed, or its object or workcell has changed since, or a segment leaves the
            joint limits, is too fast, or does not begin where and as the one before it ends.
        """
        path = Path(path)
        content = read_motion(path)
        plan = plan_from_content(content.plan, path, RegraspPlan)
        robot = plan.problem.workcell.arm.robot
        if tuple(content.joint_names) != robot.joint_names:
            raise PlanFileError(
                f"'{path}' is a motion of other joints than those of '{robot.name}'; plan the motion again"
            )
        segments = []
        for s in content.segments:
            if s.transition >= len(plan.transitions) or s.grasp_id >= len(plan.problem.grasps):
                raise PlanFileError(f"'{path}': a segment names an unknown transition or grasp; plan the motion again")
            trajectory = Trajectory(np.array(s.times), np.array(s.positions), np.array(s.velocities))
            segments.append(Segment(s.phase, s.transition, s.grasp_id, trajectory, s.jaw))
        _check_segments(segments, robot, np.array(content.velocity_limits), path)
        motion = MotionPlan(
            content.status,
            content.reason,
            plan,
            tuple(segments),
            np.array(content.velocity_limits),
            np.array(content.acceleration_limits),
            content.seconds,
            None if content.jerk_limits is None else np.array(content.jerk_limits),
            Squeeze(content.squeeze.below_contact, content.squeeze.force),
        )
        events = None if content.jaw_events is None else [event.model_dump() for event in content.jaw_events]
        if events not in (None, [asdict(event) for event in motion.jaw_events]):
            raise PlanFileError(f"'{path}': its jaw events are not those of its segments; plan the motion again")
        return motion

    def save_csv(self, path: str | os.PathLike[str], step: float = 0.01) -> None:
        """Write the motion of joints and jaw at every `step` seconds to `path` as CSV, atomically.

        Columns are ``time`` [s], ``phase``, ``arm`` and ``gripper`` (the names of robot and tool), ``jaw`` (its opening
        [m]), the joints' positions under their names, their velocities and accelerations under ``NAME_velocity`` and
        ``NAME_acceleration``, then what the jaw is told: ``jaw_command`` [m], ``jaw_force`` [N], empty without one, and
        ``holds``, 1 from the command to close to that to open. The last row is the end. The jaw moves evenly over a
        segment.

        Raises
        ------
        OptionError, PlanFileError
            If `step` is not a positive number of seconds or gives more than a million rows, or there is no motion.
        """
        check_step(step)
        if not self.solved:
            raise PlanFileError(f"there is no motion to write: {self.reason}")
        if self.duration > step * MOST_ROWS:
            raise OptionError(
                f"step is {step}, which makes more than {MOST_ROWS:,} rows of {self.duration:.0f} s; give a larger one"
            )
        arm = self.plan.problem.workcell.arm
        names, who = arm.robot.joint_names, (arm.robot.name, arm.end_effector.name)
        times = np.append(np.arange(0.0, self.duration - step / 2, step), self.duration)
        numbers = np.searchsorted(self.starts, times, side="right") - 1
        columns = [f"{name}{what}" for what in ("", "_velocity", "_acceleration") for name in names]
        events = self.jaw_events
        told = np.searchsorted([event.time for event in events], times, side="right") - 1
        with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["time", "phase", "arm", "gripper", "jaw", *columns, "jaw_command", "jaw_force", "holds"])
            for number, (segment, start) in enumerate(zip(self.segments, self.starts, strict=True)):
                trajectory = segment.trajectory
                t, mine = times[numbers == number], told[numbers == number]
                local = np.clip(t - start, 0.0, trajectory.duration)
                jaw = np.interp(local, [0.0, trajectory.duration], segment.jaw)
                rows = trajectory.at(local), trajectory.velocity_at(local), trajectory.acceleration_at(local)
                for event, state in zip(mine, np.column_stack([t, jaw, *rows]).tolist(), strict=True):
                    moment, *row = [f"{x:.9g}" for x in state]
                    writer.writerow([moment, segment.phase.name.lower(), *who, *row, *_told(events[event])])

    def save_scene(self, folder: str | os.PathLike[str]) -> None:
        """Write robot, gripper, table, obstacles and object as URDF, and where they stand, into `folder`."""
        save_scene(self.plan, folder)


def _check_segments(segments: Sequence[Segment], robot: Robot, limits: FloatArray, path: Path) -> None:
    """Raise a `PlanFileError` if `segments` cannot be a motion of `robot` within its velocity `limits` (dof,)."""
    before: Segment | None = None
    for number, segment in enumerate(segments):
        trajectory, wrong = segment.trajectory, ""
        if not all(robot.within_limits(q) for q in trajectory.position_range()):
            wrong = "goes beyond the joint limits"
        elif (trajectory.peak_velocity() > limits * (1 + ROUNDING)).any():
            wrong = "is faster than its limits"
        elif before is not None and np.abs(_state(before, -1) - _state(segment, 0)).max() > JUMP:
            wrong = "does not begin where, and as fast as, the one before it ends"
        if wrong:
            phase = segment.phase.name.lower()
            raise PlanFileError(f"'{path}': segment {number} ({phase}) {wrong}; plan the motion again")
        before = segment


def _state(segment: Segment, end: int) -> FloatArray:
    """Return positions, velocities and jaw at the beginning of a segment, 0, or its end, -1."""
    trajectory = segment.trajectory
    return np.concatenate([trajectory.positions[end], trajectory.velocities[end], [segment.jaw[end]]])


def _told(event: JawEvent) -> tuple[str, str, int]:
    """Return what a row of a CSV says of the last command to the jaw."""
    return f"{event.command:.9g}", "" if event.force is None else f"{event.force:.9g}", int(event.holds)


def check_step(step: float) -> None:
    """Raise an `OptionError` if `step` cannot be the time between rows of a CSV."""
    if not 0 < step < np.inf:
        raise OptionError(f"step is {step}; give a positive number of seconds")


def motion_content(motion: MotionPlan) -> dict[str, Any]:
    """Return what the file of `motion` holds."""
    return {
        "schema": SCHEMA,
        "kind": "motion",
        "status": motion.status.name.lower(),
        "reason": motion.reason,
        "joint_names": list(motion.plan.problem.workcell.arm.robot.joint_names),
        "velocity_limits": motion.velocity_limits.tolist(),
        "acceleration_limits": motion.acceleration_limits.tolist(),
        "jerk_limits": None if motion.jerk_limits is None else motion.jerk_limits.tolist(),
        "squeeze": asdict(motion.squeeze),
        "jaw_events": [asdict(event) for event in motion.jaw_events],
        "seconds": motion.seconds,
        "segments": [
            {
                "phase": segment.phase.name.lower(),
                "transition": segment.transition,
                "grasp_id": segment.grasp_id,
                "jaw": list(segment.jaw),
                "times": segment.trajectory.times.tolist(),
                "positions": segment.trajectory.positions.tolist(),
                "velocities": segment.trajectory.velocities.tolist(),
            }
            for segment in motion.segments
        ],
        "plan": plan_content(motion.plan),
    }
