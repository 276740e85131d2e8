"""Poses as users type them: ``[SUPPORT/]PLACEMENT:x,y,yaw_deg``, ``FIXTURE/POSE``, or a JSON file with a 4x4 matrix."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

import numpy as np

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
        return _from_file(Path(text), name) if held is None else held
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


def _from_file(path: Path, name: str) -> FloatArray:
    if path.suffix != ".json" and not os.path.isfile(path):
        raise PoseError(
            f"the {name} '{path}' is not a pose; write it like 2:0.30,0.25,45 or name a JSON file with a 4x4 matrix"
        )
    try:
        matrix = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise PoseError(f"cannot read the {name} from '{path}': {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise PoseError(
            f"the {name} file '{path}' is not valid JSON; it must hold four rows of four numbers"
        ) from error
    return as_pose(matrix, f"{name} pose in '{path}'")


def describe_pose(T: FloatArray, problem: ProblemData) -> str:
    """Return the text that `parse_pose` reads as `T` (4, 4) to a millimetre and a tenth of a degree.

    A pose in none of the problem's rests is written as where its origin is [m].
    """
    found = problem.rests.find(T, REST_TOLERANCE)
    if found is None:
        return f"({T[0, 3]:+.3f}, {T[1, 3]:+.3f}, {T[2, 3]:+.3f})"
    rest, (x, y, yaw) = problem.rests[found[0]], found[1]
    if isinstance(rest.support, Fixture):
        return rest.label
    label = rest.label if len(problem.workcell.supports) > 1 else str(rest.placement)
    return f"{label}:{x:.3f},{y:.3f},{np.degrees(yaw):.1f}"
