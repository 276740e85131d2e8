"""Collision shapes of end-effectors, tables and obstacles: boxes, cylinders and meshes, each with a pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
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


def shape_parts(shape: Shape) -> list[object]:
    """Return what makes up `shape` but for its name, as `content_hash` takes it."""
    if isinstance(shape, Box):
        return ["box", np.asarray(shape.size, dtype=np.float64), shape.pose]
    if isinstance(shape, Cylinder):
        return ["cylinder", np.array([shape.radius, shape.length]), shape.pose]
    return ["mesh", shape.vertices, shape.faces, shape.pose]


def geometry_parts(geometry: Any) -> list[object]:
    """Return what makes up a Coal geometry, as `content_hash` takes it."""
    kind = type(geometry).__name__
    if isinstance(geometry, coal.Box):
        return [kind, np.array(geometry.halfSide)]
    if isinstance(geometry, coal.Sphere):
        return [kind, float(geometry.radius)]
    if isinstance(geometry, (coal.Cylinder, coal.Capsule)):
        return [kind, float(geometry.radius), float(geometry.halfLength)]
    return [kind, np.array(geometry.vertices()), mesh_faces(geometry)]


def mesh_faces(geometry: Any) -> IntArray:
    """Return the triangles (F, 3) of a Coal mesh as indices of its vertices."""
    corners = [geometry.tri_indices(i) for i in range(geometry.num_tris)]
    return np.array([[t[0], t[1], t[2]] for t in corners], dtype=np.int64)


def mesh_geometry(vertices: FloatArray, faces: IntArray) -> Any:
    """Return a triangle mesh as a Coal bounding-volume hierarchy, concave parts included."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(faces), len(vertices))
    model.addVertices(np.asarray(vertices, dtype=np.float64))
    model.addTriangles(np.asarray(faces, dtype=np.int64))
    model.endModel()
    return model


def shape_geometry(shape: Shape) -> Any:
    """Return `shape` as a Coal geometry; its pose stays with the caller."""
    if isinstance(shape, Box):
        return coal.Box(*[float(s) for s in shape.size])
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length)
    return mesh_geometry(shape.vertices, shape.faces)


def surface_points(shape: Shape) -> FloatArray:
    """Return points (P, 3) on the surface of `shape` in its parent frame: corners, rim points or vertices."""
    if isinstance(shape, Mesh):
        local = shape.vertices
    elif isinstance(shape, Box):
        local = np.array(np.meshgrid(*[(-h, h) for h in shape.size / 2])).reshape(3, -1).T
    else:
        angles = np.arange(16) * (np.pi / 8)
        rim = shape.radius * np.column_stack([np.cos(angles), np.sin(angles)])
        ends = np.repeat([-shape.length / 2, shape.length / 2], len(rim))
        local = np.column_stack([np.tile(rim, (2, 1)), ends])
    return local @ shape.pose[:3, :3].T + shape.pose[:3, 3]
