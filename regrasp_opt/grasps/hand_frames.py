"""Frames in which other tools give a hand's pose: where the origin is, which axes approach and close, where the TCP is.

Ours has its origin at the TCP, approaches along z and closes along y. Of another frame three things matter: the axis
along which the hand approaches, the axis along which it closes, and how far ahead of the origin the TCP is.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import GraspError

AXES = {
    sign + name: (-1.0 if sign else 1.0) * np.eye(3)[index] for sign in ("", "-") for index, name in enumerate("xyz")
}


class HandFrame(NamedTuple):
    """A frame fixed to a hand.

    Attributes
    ----------
    approach, closing : str
        Axes of the frame: ``"x"``, ``"-x"``, ``"y"``, ... Which way the closing axis points means nothing, and for a
        suction cup neither does the axis.
    tcp : float
        Distance of the TCP from the origin along the approach [m].
    kind : {"parallel", "suction"}
        What the hand is.
    """

    approach: str
    closing: str
    tcp: float
    kind: Literal["parallel", "suction"] = "parallel"

    @property
    def T_hand_tcp(self) -> FloatArray:
        """Our grasp frame in this one (4, 4)."""
        z, y = AXES[self.approach], AXES[self.closing]
        T = np.eye(4)
        T[:3, :3] = np.column_stack([np.cross(y, z), y, z])
        T[:3, 3] = self.tcp * z
        return T

    def __str__(self) -> str:
        text = f"{self.approach},{self.closing},{self.tcp:g}"
        return text if self.kind == "parallel" else f"{text},{self.kind}"


FRAMES = {
    "tcp": HandFrame("z", "y", 0.0),
    "panda_hand": HandFrame("z", "y", 0.1034),
    "acronym": HandFrame("z", "x", 0.1034),
    "franka_panda": HandFrame("z", "x", 0.1034),
    "robotiq_2f_140": HandFrame("z", "x", 0.195),
    "single_suction_cup_30mm": HandFrame("z", "x", 0.0, "suction"),
}
"""Hand frames by name: ours, the hand link in Franka's URDF, ACRONYM's, and those of GraspGen's grippers.

The TCP of Franka's hand is that of its URDF, in the middle of the fingertips' pads; they end at 0.112 m.
"""


def hand_frame(text: str) -> HandFrame:
    """Return one of `FRAMES` by name, or the frame that ``"APPROACH,CLOSING,TCP[,KIND]"`` describes.

    Raises
    ------
    GraspError
        If `text` is neither.
    """
    if text in FRAMES:
        return FRAMES[text]
    parts = [part.strip() for part in str(text).split(",")]
    try:
        approach, closing, tcp, kind = parts if len(parts) == 4 else [*parts, "parallel"]
        frame = HandFrame(approach, closing, float(tcp), kind)  # type: ignore[arg-type]
        sound = abs(frame.tcp) < 1 and kind in ("parallel", "suction") and AXES[approach] @ AXES[closing] == 0
    except (ValueError, KeyError):
        sound = False
    if not sound:
        raise GraspError(
            f"'{text}' is not a hand frame; give {', '.join(FRAMES)}, or APPROACH,CLOSING,TCP, such as 'z,x,0.1034': "
            "two different axes of the frame and the metres from its origin to the TCP along the approach"
        )
    return frame
