"""What a motion file may hold (docs/motion.md): all that can be checked of it without the plan."""

from __future__ import annotations

from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from regrasp_opt.errors import PlanFileError
from regrasp_opt.motion.motion_data import MotionStatus, Phase
from regrasp_opt.schemas import Section, read_json, validated

SCHEMA = 2
"""Version of what is written; those of version 1 know neither jerk limits nor commands to the jaw."""

LONGEST, FASTEST, WIDEST = 1e5, 1e4, 2.0
"""What a motion file may hold: seconds of a segment, joint positions and speeds, and openings of the jaw [m].

Larger numbers are damage, and would overflow in what is made of them.
"""

LEAST_STEP = 2e-9
"""Least time between two knots [s]: in whole nanoseconds, as ROS has them, both may be rounded towards each other."""


def _member_of(kind: type[Enum]) -> BeforeValidator:
    """Return what makes a member of `kind` of its name in small letters."""
    known = {member.name.lower(): member for member in kind}

    def member(name: Any) -> Enum:
        if str(name) not in known:
            raise ValueError(f"should be one of {', '.join(known)}")
        return known[str(name)]

    return BeforeValidator(member)


Row = list[Annotated[float, Field(ge=-FASTEST, le=FASTEST)]]
Limits = list[Annotated[float, Field(gt=0)]]
Opening = Annotated[float, Field(ge=0, le=WIDEST)]


class SegmentSection(Section):
    """One segment."""

    phase: Annotated[Phase, _member_of(Phase)]
    transition: Annotated[int, Field(ge=0)]
    grasp_id: Annotated[int, Field(ge=0)]
    jaw: tuple[Opening, Opening]
    times: Annotated[list[Annotated[float, Field(ge=0, le=LONGEST)]], Field(min_length=2)]
    positions: list[Row]
    velocities: list[Row]

    @model_validator(mode="after")
    def _fits_its_times(self) -> SegmentSection:
        if self.times[0] != 0 or (np.diff(self.times) < LEAST_STEP).any():
            raise ValueError("the times of a segment do not ascend from 0 in steps of 2 ns; plan the motion again")
        if not len(self.positions) == len(self.velocities) == len(self.times):
            raise ValueError("the rows of a segment do not fit its times; plan the motion again")
        return self


class SqueezeSection(Section):
    """How the jaw is told to hold."""

    below_contact: Opening = 0.0
    force: Annotated[float, Field(gt=0)] | None = None


class JawEventSection(Section):
    """One command to the jaw."""

    time: float
    duration: float
    width_from: float
    width_to: float
    command: float
    force: float | None
    holds: bool


class MotionFile(Section):
    """The whole file."""

    schema_: Literal[1, 2] = Field(alias="schema")
    kind: Literal["motion"]
    status: Annotated[MotionStatus, _member_of(MotionStatus)]
    reason: str
    joint_names: list[str]
    velocity_limits: Limits
    acceleration_limits: Limits
    jerk_limits: Limits | None = None
    squeeze: SqueezeSection = Field(default_factory=SqueezeSection)
    jaw_events: list[JawEventSection] | None = None
    seconds: Annotated[float, Field(ge=0)]
    segments: list[SegmentSection]
    plan: dict[str, Any]

    @model_validator(mode="after")
    def _is_whole(self) -> MotionFile:
        if bool(self.segments) != (self.status is MotionStatus.SOLVED):
            raise ValueError("a motion has segments if it is solved, and only then; plan the motion again")
        if self.schema_ == SCHEMA and self.jaw_events is None:
            raise ValueError("there are no jaw events; plan the motion again")
        rows = [row for segment in self.segments for row in (*segment.positions, *segment.velocities)]
        limits = (self.velocity_limits, self.acceleration_limits, self.jerk_limits or self.velocity_limits)
        if {len(row) for row in (*limits, *rows)} != {len(self.joint_names)}:
            raise ValueError("a row has not as many numbers as there are joints; plan the motion again")
        return self


def read_motion(path: Path) -> MotionFile:
    """Return what the file `path` holds.

    Raises
    ------
    PlanFileError
        If it is missing or malformed.
    """
    raw = read_json(path, "motion")
    if not isinstance(raw, dict) or raw.get("schema") not in (1, SCHEMA) or raw.get("kind") != "motion":
        raise PlanFileError(f"'{path}' is not a motion of schema 1 or {SCHEMA}; write one with 'regrasp-opt motion'")
    return validated(raw, MotionFile, f"'{path}'", PlanFileError)
