"""Object poses as a person types them: ``PLACEMENT:x,y,yaw_deg`` or a JSON file with a 4x4 matrix."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np

from regrasp_opt.conventions import FloatArray, as_pose, planar_transform
from regrasp_opt.errors import PoseError

_PLANAR = re.compile(r"(-?\d{1,9}):([^,]+),([^,]+),([^,]+)")


def parse_pose(text: str, name: str, placements: FloatArray) -> FloatArray:
    """Return the pose (4, 4) T_world_object that `text` stands for.

    Parameters
    ----------
    name : str
        Start or goal, for messages.
    placements : (S, 4, 4)

    Raises
    ------
    PoseError
        If `text` is neither form, names a placement that does not exist, or its file cannot be read.
    """
    match = _PLANAR.fullmatch(text.strip())
    if match is None:
        return _from_file(Path(text), name)
    number = int(match.group(1))
    if not 0 <= number < len(placements):
        raise PoseError(f"the {name} names placement {number}; this object has placements 0 to {len(placements) - 1}")
    try:
        x, y, degrees = (float(value) for value in match.groups()[1:])
    except ValueError as error:
        raise PoseError(
            f"the {name} '{text}' holds something that is no number; write it like 2:0.30,0.25,45"
        ) from error
    if not all(math.isfinite(v) for v in (x, y, degrees)):
        raise PoseError(f"the {name} '{text}' holds NaN or infinity; write it like 2:0.30,0.25,45")
    return planar_transform(np.array([x, y, math.radians(degrees)])) @ placements[number]


def _from_file(path: Path, name: str) -> FloatArray:
    if path.suffix != ".json" and not _is_file(path):
        raise PoseError(
            f"the {name} '{path}' is no pose; write it like 2:0.30,0.25,45 or name a JSON file with a 4x4 matrix"
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


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # longer than a path may be, or with a null character
        return False


def describe_pose(T: FloatArray) -> str:
    """Return a short text for a pose: where its origin is [m]."""
    return f"({T[0, 3]:+.3f}, {T[1, 3]:+.3f}, {T[2, 3]:+.3f})"
