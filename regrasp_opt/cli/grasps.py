"""The options that give grasps, as `RegraspProblem.load` and `prepare` take them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from regrasp_opt.errors import OptionError
from regrasp_opt.grasps import GraspSet
from regrasp_opt.planning.given_grasps import Near


def given_grasps(
    grasps: str | Path | None, frame: str | None, scale: float, min_quality: float | None, near: str
) -> dict[str, Any]:
    """Return keyword arguments for the grasps of a file, for a number of them, or for none.

    Raises
    ------
    GraspError
        If the file cannot be read, or holds no grasps.
    OptionError
        If options of a grasp file are given without one, or `near` is not a pair of numbers.
    """
    if grasps is None or (isinstance(grasps, str) and grasps.lstrip("+-").isdecimal()):
        if (frame, scale, min_quality) != (None, 1.0, None):
            raise OptionError(
                "--grasp-frame, --grasp-scale and --grasp-quality belong to a file of grasps; give --grasps"
            )
        return {} if grasps is None else {"num_grasps": int(grasps)}
    try:
        distance, degrees = map(float, near.split(","))
    except ValueError as error:
        raise OptionError(f"--grasp-near is '{near}'; give METRES,DEGREES, such as 0.005,5") from error
    read = GraspSet.load(grasps, frame=frame, scale=scale, min_quality=min_quality)
    return {"grasps": read, "near": Near(distance, np.deg2rad(degrees))}
