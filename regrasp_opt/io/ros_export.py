"""A motion as goals for ROS 2: joint trajectories and gripper commands, in YAML, in the order in which they are sent.

The arm moves in runs; between two of them it rests while the jaw closes or opens. Each run is one
``trajectory_msgs/msg/JointTrajectory`` whose points are the knots of the motion. Cubic splines through positions and
velocities are the verified motion; where its accelerations are continuous they are written too, and the quintic splines
through all three are the same curve.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import yaml

from regrasp_opt.conventions import FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.errors import PlanFileError
from regrasp_opt.files import atomic_path
from regrasp_opt.motion import JawEvent, MotionPlan, Phase, Segment, Trajectory

GRIP_FORCE = 40.0
"""Largest force of the jaw where the motion states none [N]."""

JUMP = 0.01
"""Largest jump of an acceleration, as a share of its limit, that counts as none."""

NANOSECONDS = 10**9


def save_ros(motion: MotionPlan, path: str | os.PathLike[str]) -> None:
    """Write the goals of `motion` to `path` as YAML, atomically (docs/other-programs.md).

    Raises
    ------
    PlanFileError
        If there is no motion.
    """
    write_yaml([ros_goals(motion)], path)


def ros_goals(motion: MotionPlan) -> dict[str, Any]:
    """Return what the file holds.

    Raises
    ------
    PlanFileError
        If there is no motion.
    """
    check_solved(motion)
    arm = motion.plan.problem.workcell.arm
    events = iter(motion.jaw_events)
    goals = [_jaw_goal(next(events), arm.end_effector)]
    for run in runs(motion):
        if run[0].phase in (Phase.GRASP, Phase.RELEASE):
            goals.append(_jaw_goal(next(events), arm.end_effector))
            continue
        trajectory, starts = joined_run(run)
        message = _joint_trajectory(motion, trajectory)
        phases = [segment.phase.name.lower() for segment in run]
        goals.append({"type": "trajectory_msgs/msg/JointTrajectory", "phases": phases, "message": message})
        for segment, start in zip(run, starts.tolist(), strict=True):
            if segment.jaw[0] != segment.jaw[1]:
                goals.append({**_jaw_goal(next(events), arm.end_effector), "during": start})
    return {"arm": arm.robot.name, "gripper": arm.end_effector.name, "goals": goals}


def runs(motion: MotionPlan) -> Iterator[list[Segment]]:
    """Yield the segments of `motion` from rest to rest: those of a run together, jaw moves alone."""
    rests = (Phase.GRASP, Phase.RELEASE)
    for _, group in itertools.groupby(motion.segments, lambda segment: segment.phase in rests):
        yield list(group)


def joined_run(run: list[Segment]) -> tuple[Trajectory, FloatArray]:
    """Return the segments of `run` as one trajectory, and when each of them begins (S,) [s]."""
    parts = [segment.trajectory for segment in run]
    starts = np.cumsum([0.0, *(part.duration for part in parts[:-1])])
    times = [part.times[k > 0 :] + start for k, (part, start) in enumerate(zip(parts, starts, strict=True))]
    positions = np.concatenate([part.positions[k > 0 :] for k, part in enumerate(parts)])
    velocities = np.concatenate([part.velocities[k > 0 :] for k, part in enumerate(parts)])
    return Trajectory(np.concatenate(times), positions, velocities), starts


def check_solved(motion: MotionPlan) -> None:
    """Raise a `PlanFileError` if there is no motion."""
    if not motion.solved:
        raise PlanFileError(f"there is no motion to write: {motion.reason}")


def stamp(seconds: float) -> dict[str, int]:
    """Return a time or duration [s] as the fields of a message, to the nanosecond."""
    return dict(zip(("sec", "nanosec"), divmod(round(seconds * NANOSECONDS), NANOSECONDS), strict=True))


def write_yaml(documents: Iterable[Any], path: str | os.PathLike[str]) -> None:
    """Write `documents` to `path` as YAML, atomically."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8") as file:
        yaml.dump_all(documents, file, Dumper=yaml.SafeDumper, sort_keys=False, default_flow_style=None, width=120)


def _joint_trajectory(motion: MotionPlan, trajectory: Trajectory) -> dict[str, Any]:
    accelerations = _accelerations(trajectory, motion.acceleration_limits)
    rows = [trajectory.positions, trajectory.velocities, *([] if accelerations is None else [accelerations])]
    names = ("positions", "velocities", "accelerations")
    points = [
        {**{name: row[k].tolist() for name, row in zip(names, rows, strict=False)}, "time_from_start": stamp(time)}
        for k, time in enumerate(trajectory.times.tolist())
    ]
    return {"joint_names": list(motion.plan.problem.workcell.arm.robot.joint_names), "points": points}


def _accelerations(trajectory: Trajectory, limits: FloatArray) -> FloatArray | None:
    """Return the accelerations at the knots (M, dof), or None where they jump by more than `JUMP` of `limits`."""
    _, _, c2, c3 = trajectory.coefficients
    squared = np.diff(trajectory.times)[:, None] ** 2
    after, before = 2 * c2 / squared, (2 * c2 + 6 * c3) / squared  # of each piece at its start and at its end
    if (np.abs(after[1:] - before[:-1]) > JUMP * limits).any():
        return None
    return np.concatenate([after[:1], (after[1:] + before[:-1]) / 2, before[-1:]])


def _jaw_goal(event: JawEvent, effector: EndEffector) -> dict[str, Any]:
    if effector.kind == "suction":
        return {"type": "std_msgs/msg/Bool", "message": {"data": event.holds}}
    message = {"position": event.command, "max_effort": GRIP_FORCE if event.force is None else event.force}
    return {"type": "control_msgs/msg/GripperCommand", "message": message}
