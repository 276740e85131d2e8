"""Motions as JSON (docs/motion.md), versioned and read back with every field checked, and as CSV for controllers."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError, PlanFileError
from regrasp_opt.files import atomic_path
from regrasp_opt.motion.motion_data import MotionData, MotionStatus, Phase, Segment
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.planning.plan_file import plan_content, plan_from_content
from regrasp_opt.schemas import Section, read_json, validated

SCHEMA = 1
MOST_ROWS = 10**6
"""Rows of a CSV at most; these are some 150 MB."""
LONGEST, FASTEST, WIDEST = 1e5, 1e4, 2.0
"""What a motion file may hold: seconds of a segment, joint positions and speeds, and openings of the jaw [m].

Larger numbers are damage, and would overflow in what is made of them.
"""

Row = list[Annotated[float, Field(ge=-FASTEST, le=FASTEST)]]
Limits = list[Annotated[float, Field(gt=0)]]
_STATUSES = {status.name.lower(): status for status in MotionStatus}
_PHASES = {phase.name.lower(): phase for phase in Phase}


Motion = TypeVar("Motion", bound=MotionData)


class _Segment(Section):
    phase: str
    transition: Annotated[int, Field(ge=0)]
    grasp_id: Annotated[int, Field(ge=0)]
    jaw: Annotated[list[Annotated[float, Field(ge=0, le=WIDEST)]], Field(min_length=2, max_length=2)]
    times: Annotated[list[Annotated[float, Field(ge=0, le=LONGEST)]], Field(min_length=2)]
    positions: list[Row]
    velocities: list[Row]


class _File(Section):
    schema_: int = Field(alias="schema")
    kind: Literal["motion"]
    status: str
    reason: str
    joint_names: list[str]
    velocity_limits: Limits
    acceleration_limits: Limits
    seconds: Annotated[float, Field(ge=0)]
    segments: list[_Segment]
    plan: dict[str, Any]


def motion_content(motion: MotionData) -> dict[str, Any]:
    """Return what the file of `motion` holds."""
    return {
        "schema": SCHEMA,
        "kind": "motion",
        "status": motion.status.name.lower(),
        "reason": motion.reason,
        "joint_names": list(motion.plan.problem.workcell.arm.robot.joint_names),
        "velocity_limits": motion.velocity_limits.tolist(),
        "acceleration_limits": motion.acceleration_limits.tolist(),
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


def save_motion(motion: MotionData, path: str | os.PathLike[str]) -> None:
    """Write `motion` with its plan to `path`."""
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(motion_content(motion), allow_nan=False) + "\n", encoding="utf-8")


def load_motion(path: str | os.PathLike[str], kind: type[Motion]) -> Motion:
    """Read a motion of class `kind`; see `MotionPlan.load`."""
    path = Path(path)
    content = _parse(read_json(path, "motion"), path)
    plan = plan_from_content(content.plan, path, RegraspPlan)
    robot = plan.problem.workcell.arm.robot
    limits = [np.array(row, dtype=np.float64) for row in (content.velocity_limits, content.acceleration_limits)]
    if tuple(content.joint_names) != robot.joint_names or any(limit.shape != (robot.dof,) for limit in limits):
        raise PlanFileError(f"'{path}' is a motion of other joints than those of '{robot.name}'; plan the motion again")
    return kind(
        status=_STATUSES[content.status],
        reason=content.reason,
        plan=plan,
        segments=tuple(_segment(record, plan, path) for record in content.segments),
        velocity_limits=limits[0],
        acceleration_limits=limits[1],
        seconds=content.seconds,
    )


def _parse(raw: Any, path: Path) -> _File:
    version = raw.get("schema") if isinstance(raw, dict) else None
    if version != SCHEMA or raw.get("kind") != "motion":
        raise PlanFileError(f"'{path}' is not a motion of schema {SCHEMA}; write one with 'regrasp-opt motion'")
    content = validated(raw, _File, f"'{path}'", PlanFileError)
    if content.status not in _STATUSES:
        raise PlanFileError(f"'{path}': unknown status '{content.status}'; known: {', '.join(_STATUSES)}")
    if bool(content.segments) != (_STATUSES[content.status] is MotionStatus.SOLVED):
        raise PlanFileError(f"'{path}': a motion has segments if it is solved, and only then; plan the motion again")
    return content


def _segment(record: _Segment, plan: RegraspPlan, path: Path) -> Segment:
    count, dof = len(record.times), plan.problem.workcell.arm.robot.dof
    rows = [*record.positions, *record.velocities]
    if record.phase not in _PHASES:
        raise PlanFileError(f"'{path}': unknown phase '{record.phase}'; known: {', '.join(_PHASES)}")
    if {len(record.positions), len(record.velocities)} != {count} or any(len(row) != dof for row in rows):
        raise PlanFileError(f"'{path}': the rows of a segment do not fit its times; plan the motion again")
    if record.times[0] != 0 or (np.diff(record.times) <= 0).any():
        raise PlanFileError(f"'{path}': the times of a segment do not ascend from 0; plan the motion again")
    if record.transition >= len(plan.transitions) or record.grasp_id >= len(plan.problem.grasps):
        raise PlanFileError(f"'{path}': a segment names an unknown transition or grasp; plan the motion again")
    trajectory = Trajectory(
        *(np.array(x, dtype=np.float64) for x in (record.times, record.positions, record.velocities))
    )
    jaw = (record.jaw[0], record.jaw[1])
    return Segment(_PHASES[record.phase], record.transition, record.grasp_id, trajectory, jaw)


def save_motion_csv(motion: MotionData, path: str | os.PathLike[str], step: float) -> None:
    """Write `motion` as one row for every `step` seconds, and one for its end.

    Columns are ``time`` [s], ``phase``, ``jaw`` [m], the joints' positions under their names and their velocities
    under ``NAME_velocity``.

    Raises
    ------
    OptionError
        If `step` is not a positive number of seconds, or gives more than `MOST_ROWS` rows.
    PlanFileError
        If the motion is not solved.
    """
    check_step(step)
    if not motion.solved:
        raise PlanFileError(f"there is no motion to write: {motion.reason}")
    if motion.duration > step * MOST_ROWS:
        raise OptionError(
            f"step is {step}, which makes more than {MOST_ROWS:,} rows of {motion.duration:.0f} s; give a larger one"
        )
    names = motion.plan.problem.workcell.arm.robot.joint_names
    times = np.append(np.arange(0.0, motion.duration - step / 2, step), motion.duration)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "phase", "jaw", *names, *(f"{name}_velocity" for name in names)])
        for t in times.tolist():
            segment, q, v, jaw = state_at(motion, t)
            numbers = [f"{x:.9g}" for x in (jaw, *q, *v)]
            writer.writerow([f"{t:.9g}", segment.phase.name.lower(), *numbers])


def check_step(step: float) -> None:
    """Raise an `OptionError` if `step` cannot be the time between rows of a CSV."""
    if not 0 < step < np.inf:
        raise OptionError(f"step is {step}; give a positive number of seconds")


def state_at(motion: MotionData, t: float) -> tuple[Segment, FloatArray, FloatArray, float]:
    """Return the segment, joint positions and velocities (dof,) and jaw opening [m] at time `t` [s] of `motion`.

    The jaw moves evenly over a segment.
    """
    starts = motion.starts
    number = int(np.clip(np.searchsorted(starts, t, side="right") - 1, 0, len(starts) - 1))
    segment = motion.segments[number]
    local = float(np.clip(t - starts[number], 0.0, segment.trajectory.duration))
    part = local / segment.trajectory.duration
    jaw = segment.jaw[0] + part * (segment.jaw[1] - segment.jaw[0])
    return segment, segment.trajectory.at(local), segment.trajectory.velocity_at(local), jaw
