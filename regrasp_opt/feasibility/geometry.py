"""Shapes and meshes as Coal geometries."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.shapes import Box, Cylinder, Shape


def mesh_geometry(vertices: FloatArray, faces: IntArray) -> Any:
    """Return a triangle mesh as a Coal bounding-volume hierarchy, concave parts included."""
    points, triangles = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    points.extend(list(np.asarray(vertices, dtype=np.float64)))
    triangles.extend([coal.Triangle(int(a), int(b), int(c)) for a, b, c in faces])
    model = coal.BVHModelOBBRSS()
    model.beginModel(len(triangles), len(points))
    model.addSubModel(points, triangles)
    model.endModel()
    return model


def shape_geometry(shape: Shape) -> Any:
    """Return `shape` as a Coal geometry; its pose stays with the caller."""
    if isinstance(shape, Box):
        return coal.Box(*[float(s) for s in shape.size])
    if isinstance(shape, Cylinder):
        return coal.Cylinder(shape.radius, shape.length)
    return mesh_geometry(shape.vertices, shape.faces)
