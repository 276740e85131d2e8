"""Points on, and rays through, a triangle mesh: the geometry that both grasp samplers need."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray, IntArray

CREASE_ANGLE = np.deg2rad(25.0)
"""Edges that bend more than this are creases [rad]."""

CHUNK = 20_000
"""Rays that are cast at once."""

LEAF = 4
"""Triangles in each of the smallest boxes of a surface."""

ROUNDING = 1e-9
"""How far beside a box a ray still counts as meeting it [m]."""


class BoxTree(NamedTuple):
    """Boxes around a surface, halved again and again: what lets a ray skip most triangles.

    `levels` are the centers and halves of the boxes of each level, (2**k, 3) each [m]; box i has the boxes 2 i and 2 i
    + 1 of the next level inside. `leaves` (2**K, LEAF) are the triangles in each box of the last level, filled up with
    numbers from F on.
    """

    levels: tuple[tuple[FloatArray, FloatArray], ...]
    leaves: IntArray


class TriangleSurface(NamedTuple):
    """A triangle mesh, ready for sampling and ray casting.

    `triangles` (F, 3, 3) are corners [m], `normals` (F, 3) unit outward normals, `areas` (F,) [m^2], `creases` (C, 2,
    3) the ends of the edges [m] at which the surface bends by more than `CREASE_ANGLE`, by `crease_angles` (C,) [rad],
    and `tree` boxes around the triangles.
    """

    triangles: FloatArray
    normals: FloatArray
    areas: FloatArray
    creases: FloatArray
    crease_angles: FloatArray
    tree: BoxTree


class Hits(NamedTuple):
    """Where rays meet triangles: ray index (H,), triangle index (H,), distance along the ray (H,) [m]."""

    ray: IntArray
    face: IntArray
    distance: FloatArray


def make_surface(mesh: trimesh.Trimesh) -> TriangleSurface:
    """Return the surface of a mesh, without its degenerate triangles."""
    triangles = np.array(mesh.triangles, dtype=np.float64)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1)
    kept = length > 1e-14
    bend = np.array(mesh.face_adjacency_angles, dtype=np.float64)
    sharp = bend > CREASE_ANGLE
    creases = np.array(mesh.vertices, dtype=np.float64)[mesh.face_adjacency_edges[sharp]]
    normals, areas = cross[kept] / length[kept, None], length[kept] / 2
    return TriangleSurface(triangles[kept], normals, areas, creases, bend[sharp], _box_tree(triangles[kept]))


def _box_tree(triangles: FloatArray) -> BoxTree:
    """Return boxes around `triangles` (F, 3, 3), each halved across the longest side of its triangles' middles."""
    count = len(triangles)
    depth = int(np.ceil(np.log2(max(count, LEAF) / LEAF)))
    low, high = triangles.min(axis=1), triangles.max(axis=1)
    middle = (low + high) / 2
    order, levels = np.arange(LEAF << depth)[None], []
    for level in range(depth + 1):
        part = order % count
        start, end = low[part].min(axis=1), high[part].max(axis=1)
        levels.append(((start + end) / 2, (end - start) / 2))
        if level < depth:
            axis = np.ptp(middle[part], axis=1).argmax(axis=1)
            rank = np.argsort(middle[part, axis[:, None]], axis=1, kind="stable")
            order = np.take_along_axis(order, rank, axis=1).reshape(2 * len(order), -1)
    return BoxTree(tuple(levels), order)


def sample_points(surface: TriangleSurface, count: int, rng: np.random.Generator) -> tuple[FloatArray, IntArray]:
    """Return `count` points (count, 3) spread evenly by area, and the triangles they lie on."""
    edges = np.cumsum(surface.areas)
    face = np.searchsorted(edges, rng.random(count) * edges[-1], side="right").clip(max=len(edges) - 1)
    root, along = np.sqrt(rng.random(count)), rng.random(count)
    weights = np.stack([1 - root, root * (1 - along), root * along], axis=1)
    return np.einsum("pi,pij->pj", weights, surface.triangles[face]), face


def cast_rays(
    surface: TriangleSurface, origins: FloatArray, directions: FloatArray, span: tuple[float, float] = (-np.inf, np.inf)
) -> Hits:
    """Return every crossing of the lines through `origins` (R, 3) along unit `directions` (R, 3), by ray and triangle.

    Only those at distances within `span` [m] count; negative ones lie behind the origins. A line that meets a
    triangle passes all its edges on the same side (Pluecker coordinates).
    """
    nothing = np.zeros(0, dtype=np.int64)
    found = [(nothing, nothing, np.zeros(0))]
    for start in range(0, len(origins), CHUNK):
        origin, direction = origins[start : start + CHUNK], directions[start : start + CHUNK]
        ray, face = _candidates(surface, origin, direction, span)
        corners, line = surface.triangles[face] - origin[ray, None], direction[ray]
        sides = [_triple(line, corners[:, i], corners[:, j]) for i, j in ((0, 1), (1, 2), (2, 0))]
        met = (np.minimum.reduce(sides) >= 0) | (np.maximum.reduce(sides) <= 0)
        slope = np.einsum("ij,ij->i", line, surface.normals[face])
        met &= np.abs(slope) > 1e-9
        height = np.einsum("ij,ij->i", corners[met, 0], surface.normals[face[met]])
        ray, face, distance = ray[met], face[met], height / slope[met]
        order = np.lexsort((face, ray))
        order = order[(distance[order] >= span[0]) & (distance[order] <= span[1])]
        found.append((ray[order] + start, face[order], distance[order]))
    rays, faces, distances = (np.concatenate(part) for part in zip(*found, strict=True))
    return Hits(rays, faces, distances)


def _candidates(
    surface: TriangleSurface, origins: FloatArray, directions: FloatArray, span: tuple[float, float]
) -> tuple[IntArray, IntArray]:
    """Return ray and triangle (P,) of all pairs in which the line meets the smallest box around the triangle.

    A line misses a box if it does so in one of the three views along the axes, or if all of the box is out of `span`.
    """
    ray, box = np.arange(len(origins)), np.zeros(len(origins), dtype=np.int64)
    for level, (centers, halves) in enumerate(surface.tree.levels):
        if level:
            ray, box = np.repeat(ray, 2), (2 * box[:, None] + np.arange(2)).ravel()
        (x, y, z), (u, v, w) = (centers[box] - origins[ray]).T, directions[ray].T
        (a, b, c), (i, j, k) = halves[box].T + ROUNDING, np.abs((u, v, w))
        met = (np.abs(y * w - z * v) <= b * k + c * j) & (np.abs(z * u - x * w) <= c * i + a * k)
        met &= np.abs(x * v - y * u) <= a * j + b * i
        along, size = x * u + y * v + z * w, a * i + b * j + c * k
        met &= (along >= span[0] - size) & (along <= span[1] + size)
        ray, box = ray[met], box[met]
    ray, face = np.repeat(ray, LEAF), surface.tree.leaves[box].ravel()
    real = face < len(surface.triangles)
    return ray[real], face[real]


def _triple(a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Return a . (b x c) of vectors (P, 3)."""
    (a0, a1, a2), (b0, b1, b2), (c0, c1, c2) = a.T, b.T, c.T
    product: FloatArray = a0 * (b1 * c2 - b2 * c1) + a1 * (b2 * c0 - b0 * c2) + a2 * (b0 * c1 - b1 * c0)
    return product


def tangents(normals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (N, 3) each that complete `normals` (N, 3) to right-handed frames (u, v, n)."""
    helper = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    u = np.cross(helper, normals)
    u /= np.linalg.norm(u, axis=1, keepdims=True)
    return u, np.cross(normals, u)
