"""Collision shapes of end-effectors, tables and obstacles: boxes, cylinders and meshes, each with a pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray


@dataclass(frozen=True)
class Box:
    """A box of full edge lengths `size` (3,) [m], centred at `pose` (4, 4) in its parent frame."""

    name: str
    size: FloatArray
    pose: FloatArray


@dataclass(frozen=True)
class Cylinder:
    """A cylinder of `radius` and full `length` [m] along z, centred at `pose` (4, 4) in its parent frame."""

    name: str
    radius: float
    length: float
    pose: FloatArray


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh, `vertices` (V, 3) [m] and `faces` (F, 3), at `pose` (4, 4) in its parent frame."""

    name: str
    vertices: FloatArray
    faces: IntArray
    pose: FloatArray


Shape = Box | Cylinder | Mesh


def bounding_points(shape: Shape) -> FloatArray:
    """Return points (P, 3) in the parent frame whose convex hull contains `shape`."""
    if isinstance(shape, Mesh):
        local = shape.vertices
    else:
        half = shape.size / 2 if isinstance(shape, Box) else np.array([shape.radius, shape.radius, shape.length / 2])
        local = np.array(np.meshgrid(*[(-h, h) for h in half])).reshape(3, -1).T
    return local @ shape.pose[:3, :3].T + shape.pose[:3, 3]
