"""Supports: what objects stand on. Boards (tables, shelves, tilted plates) and fixtures, which hold an object.

The frame of a support has z along its outward normal. A board turns and tilts about the middle of its surface, and
where it is level and square to the world, x and y in its plane are those of the world.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from regrasp_opt.conventions import FloatArray, invert, pose_distance, translation
from regrasp_opt.geometry.shapes import Box, Shape

MARGIN = 0.05
"""What a board's workspace leaves free along the edges where none is given, or a quarter of its width [m]."""


@dataclass(frozen=True)
class WorkspaceBounds:
    """The rectangle of object positions, ``(low, high)`` in x and in y [m]."""

    x: tuple[float, float]
    y: tuple[float, float]

    @property
    def array(self) -> FloatArray:
        """The low and the high corner (2, 2): ``[[x_low, y_low], [x_high, y_high]]`` [m]."""
        return np.array([self.x, self.y]).T


@dataclass(frozen=True, eq=False)
class Support:
    """A rectangular surface and the board below it.

    Attributes
    ----------
    name : str
        Its name in messages.
    T_world_support : (4, 4) array
        The frame of its plane, z along its outward normal.
    center, size : (2,) arrays
        Middle and edge lengths of the rectangle in its plane [m].
    thickness : float
        Thickness below the surface [m].
    workspace : WorkspaceBounds
        Where in its plane objects may be put down: their centres of mass, seen along the normal.
    weight : float
        Added to the cost of a plan for each intermediate pose here.
    """

    name: str
    T_world_support: FloatArray
    center: FloatArray
    size: FloatArray
    thickness: float
    workspace: WorkspaceBounds
    weight: float = 0.0

    @classmethod
    def table(
        cls,
        height: float,
        center: FloatArray,
        size: FloatArray,
        thickness: float,
        workspace: WorkspaceBounds | None = None,
        *,
        name: str = "table",
        rotation: FloatArray | None = None,
        weight: float = 0.0,
    ) -> Support:
        """Return a board with the middle of its surface at `height` above `center` (2,) [m], turned by `rotation`.

        Without a `workspace` all of it may be used, less `MARGIN`.
        """
        x, y = float(center[0]), float(center[1])
        turn = np.eye(4)
        turn[:3, :3] = np.eye(3) if rotation is None else rotation
        T = translation(x, y, height) @ turn @ translation(-x, -y, 0.0)
        if rotation is None:
            T = translation(0.0, 0.0, height)
        half = size / 2 - np.minimum(MARGIN, size / 4)
        (x_low, y_low), (x_high, y_high) = (center - half).tolist(), (center + half).tolist()
        space = workspace or WorkspaceBounds((x_low, x_high), (y_low, y_high))
        return cls(name, T, center, size, thickness, space, weight)

    @property
    def height(self) -> float:
        """Z of the middle of the surface [m]."""
        return float((self.T_world_support @ [*self.center, 0.0, 1.0])[2])

    @property
    def normal(self) -> FloatArray:
        """The outward normal (3,) in the world."""
        return self.T_world_support[:3, 2]

    @property
    def slope(self) -> float:
        """Tangent of the angle by which it is tilted."""
        return float(np.linalg.norm(self.normal[:2]) / max(self.normal[2], 1e-9))

    @property
    def edges(self) -> FloatArray:
        """The low and the high corner (2, 2) of the surface in its plane [m]."""
        return self.center + np.array([[-0.5], [0.5]]) * self.size

    def seen(self, points: FloatArray) -> FloatArray:
        """Return `points` (..., 3) of the world in the frame of this support."""
        T = invert(self.T_world_support)
        seen: FloatArray = points @ T[:3, :3].T + T[:3, 3]
        return seen

    @cached_property
    def shape(self) -> Box:
        """The board as a box in the world whose upper face is the surface."""
        pose = self.T_world_support @ translation(float(self.center[0]), float(self.center[1]), -self.thickness / 2)
        return Box(self.name, np.array([*self.size, self.thickness]), pose)

    @property
    def shapes(self) -> tuple[Shape, ...]:
        """What it is made of, in the world."""
        return (self.shape,)


@dataclass(frozen=True, eq=False)
class HeldPose:
    """A pose in which a fixture holds an object.

    Attributes
    ----------
    name : str
    T_support_object : (4, 4) array
        The object in the frame of the fixture.
    object : str or None
        Name of the object that is held so; None: any.
    """

    name: str
    T_support_object: FloatArray
    object: str | None = None


@dataclass(frozen=True, eq=False)
class Fixture:
    """A nest that holds an object in one pose, or a few; the object need not be stable by itself.

    Attributes
    ----------
    name : str
    T_world_support : (4, 4) array
        Its frame; an object leaves along z.
    shapes : tuple of Shape
        What it is made of, in the world.
    poses : tuple of HeldPose
    weight : float
        Same as for a `Support`.
    """

    name: str
    T_world_support: FloatArray
    shapes: tuple[Shape, ...]
    poses: tuple[HeldPose, ...]
    weight: float = 0.0

    @property
    def height(self) -> float:
        """Z of its frame [m]."""
        return float(self.T_world_support[2, 3])

    @property
    def normal(self) -> FloatArray:
        """The direction (3,) in the world in which an object leaves it."""
        return self.T_world_support[:3, 2]

    def holding(self, T: FloatArray, tolerance: float) -> HeldPose | None:
        """Return the pose that an object at `T` (4, 4) is held in, to `tolerance` [m and rad], or None."""
        off = [max(map(float, pose_distance(self.T_world_support @ pose.T_support_object, T))) for pose in self.poses]
        return next((pose for pose, each in zip(self.poses, off, strict=True) if each <= tolerance), None)
