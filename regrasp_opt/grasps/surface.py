"""Points on, and rays through, a triangle mesh: the geometry that both grasp samplers need."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray, IntArray

CREASE_ANGLE = np.deg2rad(25.0)
"""Edges that bend more than this are creases [rad]."""

CHUNK = 4_000_000
"""Ray-triangle pairs that are held in memory at once."""


class Surface(NamedTuple):
    """A triangle mesh, ready for sampling and ray casting.

    Attributes
    ----------
    triangles : FloatArray
        Corners (F, 3, 3) [m].
    normals : FloatArray
        Unit outward normals (F, 3).
    areas : FloatArray
        Areas (F,) [m^2].
    creases : FloatArray
        Ends (C, 2, 3) of the edges at which the surface bends by more than `CREASE_ANGLE` [m].
    crease_angles : FloatArray
        How much it bends there (C,) [rad].
    """

    triangles: FloatArray
    normals: FloatArray
    areas: FloatArray
    creases: FloatArray
    crease_angles: FloatArray


class Hits(NamedTuple):
    """Where rays meet triangles: ray index (H,), triangle index (H,), distance along the ray (H,) [m]."""

    ray: IntArray
    face: IntArray
    distance: FloatArray


def make_surface(mesh: trimesh.Trimesh) -> Surface:
    """Return the surface of a mesh, without its degenerate triangles."""
    triangles = np.array(mesh.triangles, dtype=np.float64)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1)
    kept = length > 1e-14
    bend = np.array(mesh.face_adjacency_angles, dtype=np.float64)
    sharp = bend > CREASE_ANGLE
    creases = np.array(mesh.vertices, dtype=np.float64)[mesh.face_adjacency_edges[sharp]]
    return Surface(triangles[kept], cross[kept] / length[kept, None], length[kept] / 2, creases, bend[sharp])


def sample_points(surface: Surface, count: int, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """Return `count` points (count, 3) spread evenly by area, and the triangles they lie on."""
    edges = np.cumsum(surface.areas)
    face = np.searchsorted(edges, rng.random(count) * edges[-1], side="right").clip(max=len(edges) - 1)
    root, along = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    return np.einsum("pi,pij->pj", weights, surface.triangles[face]), face


def cast_rays(surface: Surface, origins: FloatArray, directions: FloatArray) -> Hits:
    """Return every crossing of the lines through `origins` (R, 3) along unit `directions` (R, 3).

    A line that meets a triangle passes all its edges on the same side (Pluecker coordinates), which makes the
    test three matrix products for many rays and triangles at once.
    """
    corners = surface.triangles
    edges = [
        np.hstack([np.cross(corners[:, i], corners[:, j]), corners[:, j] - corners[:, i]])
        for i, j in ((0, 1), (1, 2), (2, 0))
    ]
    nothing = np.zeros(0, dtype=np.int64)
    found = [(nothing, nothing, np.zeros(0))]
    step = max(1, CHUNK // max(len(corners), 1))
    for start in range(0, len(origins), step):
        origin, direction = origins[start : start + step], directions[start : start + step]
        line = np.hstack([direction, np.cross(origin, direction)])
        sides = [line @ edge.T for edge in edges]
        low = np.minimum(np.minimum(sides[0], sides[1]), sides[2])
        high = np.maximum(np.maximum(sides[0], sides[1]), sides[2])
        ray, face = np.nonzero((low >= 0) | (high <= 0))
        slope = np.einsum("ij,ij->i", direction[ray], surface.normals[face])
        crossing = np.abs(slope) > 1e-9
        ray, face, slope = ray[crossing], face[crossing], slope[crossing]
        height = np.einsum("ij,ij->i", corners[face, 0] - origin[ray], surface.normals[face])
        found.append((ray + start, face, height / slope))
    rays, faces, distances = (np.concatenate(part) for part in zip(*found, strict=True))
    return Hits(rays, faces, distances)


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (N, 3) each that complete `normals` (N, 3) to right-handed frames (u, v, n)."""
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    u = np.cross(helper, normals)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normals, u)
