"""Surfaces to draw: bodies of robots, grippers and workcells as triangles, their edges broken to catch light."""

from __future__ import annotations

from typing import Any, NamedTuple

import coal
import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.geometry.shapes import Shape, mesh_faces, shape_geometry

CREASE = np.radians(32.0)
"""Faces that meet at a sharper angle than this are drawn with an edge between them [rad]."""


class Patch(NamedTuple):
    """Triangles: `vertices` (V, 3) [m] and `faces` (F, 3)."""

    vertices: FloatArray
    faces: IntArray

    def placed(self, T: FloatArray) -> Patch:
        """Return the surface moved by `T` (4, 4)."""
        return Patch(self.vertices @ T[:3, :3].T + T[:3, 3], self.faces)

    def creased(self) -> Patch:
        """Return the surface with vertices split along edges, so that averaged normals are smooth only where it is."""
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=True)
        return _surface(trimesh.graph.smooth_shade(mesh, angle=CREASE))


def merged(surfaces: list[Patch]) -> Patch:
    """Return several surfaces as one."""
    offsets = np.cumsum([0, *(len(s.vertices) for s in surfaces[:-1])])
    faces = [s.faces + offset for s, offset in zip(surfaces, offsets, strict=True)]
    return Patch(np.concatenate([s.vertices for s in surfaces]), np.concatenate(faces))


def chamfered_box(size: FloatArray, chamfer: float = 0.003) -> Patch:
    """Return a box of edge lengths `size` (3,) about the origin with its edges cut off by `chamfer` [m]."""
    cut = min(chamfer, 0.2 * float(np.min(size)))
    signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
    corners = [signs * (size / 2 - cut * (np.arange(3) != axis)) for axis in range(3)]
    return _surface(trimesh.convex.convex_hull(np.concatenate(corners)))


def rounded_cylinder(radius: float, length: float, fillet: float = 0.012) -> Patch:
    """Return a cylinder along z about the origin with rounded rims [m]."""
    f = min(fillet, 0.4 * radius, 0.4 * length)
    arc = np.linspace(0.0, np.pi / 2, 5)
    rim = np.column_stack([radius - f + f * np.sin(arc), -length / 2 + f - f * np.cos(arc)])
    profile = np.vstack([[0.0, -length / 2], rim, (rim * (1, -1))[::-1], [0.0, length / 2]])
    return _surface(trimesh.creation.revolve(profile, sections=40))


def shape_surface(shape: Shape) -> Patch:
    """Return the surface of a shape of an end-effector or a workcell in its parent frame."""
    return coal_surface(shape_geometry(shape), 0.003, 0.003).placed(shape.pose)


def coal_surface(geometry: Any, chamfer: float = 0.006, fillet: float = 0.012) -> Patch:
    """Return the surface of a `coal.CollisionGeometry` in its own frame; edges and rims are rounded off [m]."""
    if isinstance(geometry, coal.Box):
        return chamfered_box(2 * np.array(geometry.halfSide), chamfer)
    if isinstance(geometry, coal.Sphere):
        return _surface(trimesh.creation.icosphere(subdivisions=3, radius=geometry.radius))
    if isinstance(geometry, coal.Cylinder):
        return rounded_cylinder(geometry.radius, 2 * geometry.halfLength, fillet)
    if isinstance(geometry, coal.Capsule):
        return rounded_cylinder(geometry.radius, 2 * (geometry.halfLength + geometry.radius), geometry.radius)
    return Patch(np.array(geometry.vertices()), mesh_faces(geometry))


def _surface(mesh: trimesh.Trimesh) -> Patch:
    return Patch(np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64))
