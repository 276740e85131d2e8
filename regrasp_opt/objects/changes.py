"""How far a solid is from the surfaces in the file that it was made from."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.shapes import mesh_geometry
from regrasp_opt.geometry.solids import Solid

_POINTS = 1000
"""Points of each kind that are measured."""

_ROUNDING = 1e-7
"""Surfaces nearer to each other than this share of the extent are the same."""


class Changes(NamedTuple):
    """What became of the surfaces in a file: each pair has the number for the file and for the solid.

    A body shares no vertex with another. What surfaces of the file enclose twice counts twice in its volume [m^3]. The
    distance [m] is the largest of the solid's surface from the file's, and of what is outside the solid from it, over
    at most a thousand vertices of each and a thousand middles of the solid's faces.
    """

    faces: tuple[int, int]
    bodies: tuple[int, int]
    volume: tuple[float, float]
    distance: float

    def sentence(self) -> str:
        """Return all of it in words."""
        counts = [f"{what} {a} -> {b}" for what, (a, b) in (("bodies", self.bodies), ("faces", self.faces)) if a != b]
        before, after = (f"{1e6 * volume:.2f}" for volume in self.volume)
        return ", ".join(
            [*counts, f"volume {before} -> {after} cm3, surfaces at most {1e3 * self.distance:.3f} mm apart"]
        )


def compare(file: trimesh.Trimesh, solid: trimesh.Trimesh) -> Changes | None:
    """Return what changed between the surfaces of a `file` and the `solid` made of them; None if nothing did."""
    middle = file.triangles.mean(axis=(0, 1))
    volumes = [float(np.linalg.det(mesh.triangles - middle).sum() / 6) for mesh in (file, solid)]
    points = np.concatenate([_some(solid.vertices), _some(solid.triangles_center)])
    inner, corners = Solid(mesh_geometry(solid.vertices, solid.faces)), _some(file.vertices)
    far = nearest_points(solid, corners)[0]
    distance = nearest_points(file, points)[0].max()
    for corner, away in zip(corners, far, strict=True):
        if away > distance and not inner.holds(corner[None]):
            distance = away
    same = abs(volumes[1] - volumes[0]) < 1e-6 * volumes[1] and distance < _ROUNDING * file.extents.max()
    if same and len(file.faces) == len(solid.faces):
        return None
    bodies = file.body_count, solid.body_count
    return Changes((len(file.faces), len(solid.faces)), bodies, (volumes[0], volumes[1]), float(distance))


def _some(points: FloatArray) -> FloatArray:
    return points[:: -(-len(points) // _POINTS)]


def nearest_points(mesh: trimesh.Trimesh, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the distances (N,) of `points` (N, 3) from the surface of `mesh` [m], and its nearest points (N, 3)."""
    return nearest_on(mesh_geometry(mesh.vertices, mesh.faces), points)


def nearest_on(surface: Any, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the same for a surface that Coal holds already."""
    ball = coal.Sphere(0.0)
    here, request, result = coal.Transform3s(), coal.DistanceRequest(), coal.DistanceResult()
    distances, nearest = np.empty(len(points)), np.empty((len(points), 3))
    for n, point in enumerate(points):
        result.clear()
        distances[n] = coal.distance(surface, here, ball, coal.Transform3s(np.eye(3), point), request, result)
        nearest[n] = result.getNearestPoint1()
    return distances, nearest
