"""Poses as users type them: ``[SUPPORT/]PLACEMENT:x,y,yaw_deg``, ``FIXTURE/POSE``, or JSON, also in a file."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

from regrasp_opt.conventions import FloatArray, as_pose
from regrasp_opt.errors import PoseError, UnknownNameError
from regrasp_opt.planning.problem_data import REST_TOLERANCE, ProblemData
from regrasp_opt.scene import Fixture

_PLANAR = re.compile(r"(?:([^/:]+)/)?(-?\d{1,9}):([^,]+),([^,]+),([^,]+)")


def parse_pose(text: str, name: str, problem: ProblemData) -> FloatArray:
    """Return the pose (4, 4) T_world_object that `text` stands for.

    Parameters
    ----------
    name : str
        Start or goal, for messages.

    Raises
    ------
    PoseError
        If `text` is none of the forms, names a support or placement that does not exist, or its file cannot be read.
    """
    held = _in_fixture(text.strip(), name, problem)
    match = _PLANAR.fullmatch(text.strip())
    if held is not None or match is None:
        return _from_json(text, name) if held is None else held
    try:
        x, y, degrees = (float(value) for value in match.groups()[2:])
    except ValueError as error:
        raise PoseError(
            f"the {name} '{text}' holds something that is not a number; write it like 2:0.30,0.25,45"
        ) from error
    if not all(math.isfinite(v) for v in (x, y, degrees)):
        raise PoseError(f"the {name} '{text}' holds NaN or infinity; write it like 2:0.30,0.25,45")
    number, count = int(match.group(2)), len(problem.object.placements)
    if not 0 <= number < count:
        raise PoseError(f"the {name} names placement {number}; this object has placements 0 to {count - 1}")
    try:
        return problem.pose(number, x, y, math.radians(degrees), support=match.group(1))
    except UnknownNameError as error:
        raise PoseError(f"the {name} '{text}': {error}") from error


def _in_fixture(text: str, name: str, problem: ProblemData) -> FloatArray | None:
    """Return the pose (4, 4) that ``FIXTURE/POSE`` stands for; None where `text` names no fixture."""
    fixtures = {each.name: each for each in problem.workcell.supports if isinstance(each, Fixture)}
    support, _, pose = text.partition("/")
    if support not in fixtures:
        return None
    labels = {rest.label: rest for rest in problem.rests if rest.support is fixtures[support]}
    if text not in labels:
        there = ", ".join(labels) or f"no pose for '{problem.object.name}'"
        raise PoseError(f"the {name} names the pose '{pose}' of the fixture '{support}', which has {there}")
    return problem.pose(labels[text].placement, support=support)


def _from_json(text: str, name: str) -> FloatArray:
    path, where, called = Path(text), f"{name} '{text}'", f"{name} pose"
    if text.lstrip()[:1] not in ("[", "{"):
        if path.suffix != ".json" and not os.path.isfile(path):
            raise PoseError(
                f"the {name} '{path}' is not a pose; write it like 2:0.30,0.25,45 or name a JSON file with a 4x4 matrix"
            )
        try:
            text = path.read_text(encoding="utf-8")
        except OSError as error:
            raise PoseError(f"cannot read the {name} from '{path}': {error.strerror}") from error
        except ValueError as error:
            raise PoseError(f"the {name} file '{path}' is not text in UTF-8") from error
        where, called = f"{name} file '{path}'", f"{name} pose in '{path}'"
    try:
        pose = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise PoseError(
            f"the {where} is not valid JSON; give four rows of four numbers, or position and quaternion_xyzw"
        ) from error
    return as_pose(pose, called)


def describe_pose(T: FloatArray, problem: ProblemData) -> str:
    """Return the text that `parse_pose` reads as `T` (4, 4) to a millimetre and a tenth of a degree.

    A pose in none of the problem's rests is written as where its origin is [m].
    """
    found = problem.rests.find(T, REST_TOLERANCE)
    if found is None:
        return f"({T[0, 3]:+.3f}, {T[1, 3]:+.3f}, {T[2, 3]:+.3f})"
    return problem.rests.text(*found)
