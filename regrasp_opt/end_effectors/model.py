"""The end-effector: where its TCP is, how far it opens, and the bodies that can collide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, invert, translation
from regrasp_opt.errors import WorkcellError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.shapes import Box, Shape, shape_parts

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
"""Reflection through the x-z plane of the flange frame, which swaps the two fingers."""


class Pad(NamedTuple):
    """Where a finger holds: intervals (2,) of x and z in the flange frame [m], on the inner face of the finger."""

    x: tuple[float, float]
    z: tuple[float, float]


@dataclass(frozen=True, eq=False)
class EndEffector:
    """A parallel gripper or a suction cup in its flange frame (approach +z, jaws close along y).

    Attributes
    ----------
    name : str
        Short name, for messages.
    kind : {"parallel", "suction"}
        What holds the object.
    tcp_offset : float
        Distance of the TCP along the flange z axis [m].
    max_opening : float
        Full stroke of the jaw [m]; 0 for suction.
    pre_opening : float
        How far each finger stands beyond the grasp width while approaching [m]; 0 for suction.
    cup_radius : float
        Radius of the suction cup's rim [m]; 0 for a parallel gripper.
    body : tuple of Shape
        What does not move with the jaw, flange frame. A suction cup's cylinder ends short of the TCP, by as
        much as its lip gives way.
    finger : tuple of Box
        The +y finger at zero opening, its inner face at y = 0; the other one is its mirror image. Empty for
        suction.
    pad : Pad
        Where the +y finger may hold the object; the other pad is its mirror image. Means nothing for suction.
    source : str
        ``"built-in"`` or the path of the file it was read from.

    Raises
    ------
    WorkcellError
        If a finger box is turned against the flange frame or reaches below y = 0, or the pad is not on the fingers
        or beside the closing line of the TCP (x = 0).
    """

    name: str
    kind: Literal["parallel", "suction"]
    tcp_offset: float
    max_opening: float
    pre_opening: float
    cup_radius: float
    body: tuple[Shape, ...]
    finger: tuple[Box, ...]
    pad: Pad
    source: str = "built-in"

    def __post_init__(self) -> None:
        where = self.name if self.source == "built-in" else self.source
        for box in self.finger:
            if not np.allclose(box.pose[:3, :3], np.eye(3)):
                raise WorkcellError(f"finger '{box.name}' of '{where}' is turned; give axis-aligned boxes")
            if box.pose[1, 3] - box.size[1] / 2 < -1e-9:
                raise WorkcellError(f"finger '{box.name}' of '{where}' reaches below y = 0; give the +y finger only")
        for axis, (low, high), index in (("x", self.pad.x, 0), ("z", self.pad.z, 2)) if self.finger else ():
            start, end = _interval(self.finger, index)
            if low < start - 1e-9 or high > end + 1e-9:
                raise WorkcellError(
                    f"the pad of '{where}' is not on its fingers; keep its {axis} in [{start:g}, {end:g}]"
                )
        if self.finger and not self.pad.x[0] <= 0 <= self.pad.x[1]:
            raise WorkcellError(f"the pad of '{where}' is beside the TCP; give fingers and a pad with x = 0 inside")

    @property
    def T_flange_tcp(self) -> FloatArray:
        """The TCP in the flange frame (4, 4)."""
        return translation(0.0, 0.0, self.tcp_offset)

    @property
    def T_tcp_flange(self) -> FloatArray:
        """The flange in the TCP frame (4, 4)."""
        return invert(self.T_flange_tcp)

    def finger_boxes(self, width: float, swept: float = 0.0) -> tuple[Box, ...]:
        """Return the boxes of both fingers in the flange frame, those of the +y finger first.

        Parameters
        ----------
        width : float
            Jaw opening between the inner faces [m].
        swept : float
            How much each box is thickened outward [m], so that it covers every opening from `width` to
            ``width + 2 * swept``.
        """
        right = []
        for box in self.finger:
            pose = translation(0.0, (width + swept) / 2, 0.0) @ box.pose
            right.append(Box(f"{box.name}+y", box.size + np.array([0.0, swept, 0.0]), pose))
        left = [Box(f"{box.name[:-2]}-y", box.size, MIRROR @ box.pose @ MIRROR) for box in right]
        return (*right, *left)

    def finger_shifts(self, widths: FloatArray) -> FloatArray:
        """Return how far (G, K, 3) [m] the K boxes of `finger_boxes` move from width 0 to each of `widths` (G,)."""
        shifts = np.zeros((len(widths), 2 * len(self.finger), 3))
        shifts[..., 1] = np.outer(widths, np.repeat([0.5, -0.5], len(self.finger)))
        return shifts

    def points_at_widths(
        self, fixed: Sequence[FloatArray], fingers: Sequence[FloatArray], widths: FloatArray
    ) -> FloatArray:
        """Return points (G, P, 3) [m] of the tool at `widths` (G,), in the flange frame.

        Parameters
        ----------
        fixed : sequence of (F, 3)
            Points of bodies that stand still.
        fingers : sequence of (F, 3)
            Points of each of the boxes of `finger_boxes` at width 0.
        """
        none = np.zeros((0, 3))
        still, moving = np.concatenate([none, *fixed]), np.concatenate([none, *fingers])
        counts = np.array([len(points) for points in fingers], dtype=np.int64)
        moved = moving + np.repeat(self.finger_shifts(widths), counts, axis=1)
        return np.concatenate([np.broadcast_to(still, (len(widths), *still.shape)), moved], axis=1)

    def fingerprint(self) -> str:
        """Return a hash of everything that decides which grasps are feasible; the name is not part of it."""
        shapes: list[object] = [shape_parts(shape) for shape in (*self.body, *self.finger)]
        if self.pad != default_pad(self.finger):
            shapes.append(("pad", np.array(self.pad)))
        lengths = [self.tcp_offset, self.max_opening, self.pre_opening, self.cup_radius]
        return content_hash("end-effector", self.kind, np.array(lengths), len(self.body), shapes)


def default_pad(finger: Sequence[Box]) -> Pad:
    """Return the inner face of a fingertip: of the boxes that reach farthest along z, those nearest to y = 0."""
    if not finger:
        return Pad((0.0, 0.0), (0.0, 0.0))
    tip = _interval(finger, 2)[1]
    tips = [box for box in finger if _interval([box], 2)[1] > tip - 1e-9]
    inner = [box for box in tips if _interval([box], 1)[0] < _interval(tips, 1)[0] + 1e-9]
    return Pad(_interval(inner, 0), _interval(inner, 2))


def _interval(boxes: Sequence[Box], axis: int) -> tuple[float, float]:
    """Return what `boxes` cover of an axis [m]."""
    ends = [(box.pose[axis, 3] - box.size[axis] / 2, box.pose[axis, 3] + box.size[axis] / 2) for box in boxes]
    return float(min(low for low, _ in ends)), float(max(high for _, high in ends))
