"""Supports: what objects stand on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from regrasp_opt.conventions import FloatArray, translation
from regrasp_opt.geometry.shapes import Box


@dataclass(frozen=True, eq=False)
class Support:
    """A rectangular surface, level for now, and the board below it.

    Attributes
    ----------
    name : str
        Its name in messages.
    T_world_support : (4, 4) array
        The frame in the middle of the surface, z along its outward normal.
    size : (2,) array
        Edge lengths of the surface along the x and y axes of its frame [m].
    thickness : float
        Thickness below the surface [m].
    """

    name: str
    T_world_support: FloatArray
    size: FloatArray
    thickness: float

    @classmethod
    def table(cls, height: float, center: FloatArray, size: FloatArray, thickness: float) -> Support:
        """Return a level support named "table" with its surface at `height` about `center` (2,) [m]."""
        return cls("table", translation(float(center[0]), float(center[1]), height), size, thickness)

    @property
    def height(self) -> float:
        """Z of the middle of the surface [m]."""
        return float(self.T_world_support[2, 3])

    @property
    def center(self) -> FloatArray:
        """X and y of the middle of the surface (2,) [m]."""
        return self.T_world_support[:2, 3]

    @cached_property
    def shape(self) -> Box:
        """The support as a box in the world whose upper face is the surface."""
        pose = self.T_world_support @ translation(0.0, 0.0, -self.thickness / 2)
        return Box(self.name, np.array([*self.size, self.thickness]), pose)
