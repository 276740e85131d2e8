"""Object poses as users type them: ``PLACEMENT:x,y,yaw_deg`` or a JSON file with a 4x4 matrix."""

from __future__ import annotations

import json
import math
import os
import re
from pathlib import Path

import numpy as np

from regrasp_opt.conventions import FloatArray, as_pose, planar_transform
from regrasp_opt.errors import PoseError

REST_TOLERANCE = 1e-4
"""How far a rotation matrix's entries and the height [m] may together be off for a pose to be called a placement."""
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
            f"the {name} '{text}' holds something that is not a number; write it like 2:0.30,0.25,45"
        ) from error
    if not all(math.isfinite(v) for v in (x, y, degrees)):
        raise PoseError(f"the {name} '{text}' holds NaN or infinity; write it like 2:0.30,0.25,45")
    return planar_transform(np.array([x, y, math.radians(degrees)])) @ placements[number]


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


def describe_pose(T: FloatArray, placements: FloatArray) -> str:
    """Return the text that `parse_pose` reads as `T` (4, 4) to a millimetre and a tenth of a degree.

    A pose that is none of the `placements` (S, 4, 4), moved on the table, is written as where its origin is [m].
    """
    turn: FloatArray = T[:3, :3] @ placements[:, :3, :3].transpose(0, 2, 1)
    yaw = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    upright = planar_transform(np.stack([0 * yaw, 0 * yaw, yaw], axis=-1)) @ placements
    moved = T[:3, 3] - upright[:, :3, 3]
    error = np.abs(upright[:, :3, :3] - T[:3, :3]).max(axis=(1, 2)) + np.abs(moved[:, 2])
    number = int(error.argmin())
    if error[number] > REST_TOLERANCE:
        return f"({T[0, 3]:+.3f}, {T[1, 3]:+.3f}, {T[2, 3]:+.3f})"
    return f"{number}:{moved[number, 0]:.3f},{moved[number, 1]:.3f},{np.degrees(yaw[number]):.1f}"
