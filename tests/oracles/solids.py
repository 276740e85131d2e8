"""Triangle meshes as MuJoCo does not know them: concave, with an inside, and hit by rays."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

LEAF = 16
"""Triangles in one ball of the broad phase at most."""


class Solid:
    """A triangle mesh with balls around groups of neighbouring triangles.

    Attributes
    ----------
    corners : (F, 3, 3)
        Corners of the triangles [m], sorted by group.
    four : (F, 4, 3)
        The same with the first one again, as MuJoCo wants four.
    center, radius : (F, 3), (F,)
        Balls around the triangles.
    groups : list of slice
        Neighbouring triangles; `group_center` and `group_radius` are balls around them.
    closed, convex : bool
        Whether every edge joins two triangles, and whether its hull is the body itself.
    """

    def __init__(self, vertices, faces):
        self.vertices = np.asarray(vertices, dtype=np.float64)
        corners = self.vertices[faces]
        order = _sorted_by_place(corners.mean(axis=1))
        self.corners = np.ascontiguousarray(corners[np.concatenate(order)])
        self.four = np.ascontiguousarray(self.corners[:, [0, 1, 2, 0]], dtype=np.float32)
        ends = np.cumsum([len(rows) for rows in order])
        self.groups = [slice(end - len(rows), end) for rows, end in zip(order, ends, strict=True)]
        self.center = (self.corners.min(axis=1) + self.corners.max(axis=1)) / 2
        self.radius = np.linalg.norm(self.corners - self.center[:, None], axis=2).max(axis=1)
        self.group_center = np.array([self.center[rows].mean(axis=0) for rows in self.groups])
        self.group_radius = np.array(
            [
                (np.linalg.norm(self.center[rows] - middle, axis=1) + self.radius[rows]).max()
                for rows, middle in zip(self.groups, self.group_center, strict=True)
            ]
        )
        cross = np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])
        self.normals = cross / np.maximum(np.linalg.norm(cross, axis=1, keepdims=True), 1e-300)
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        self.closed = bool((np.unique(edges, axis=0, return_counts=True)[1] == 2).all())
        six_volumes = np.einsum("fi,fi->f", self.corners[:, 0], np.cross(self.corners[:, 1], self.corners[:, 2]))
        self.volume = six_volumes.sum() / 6
        self.center_of_mass = (six_volumes[:, None] * self.corners.sum(axis=1)).sum(axis=0) / (24 * self.volume or 1)
        self.convex = False
        try:
            self.hull = ConvexHull(self.vertices)
            self.convex = self.closed and self.volume > 0.999 * self.hull.volume and self._is_its_hull()
        except QhullError:
            self.hull = None

    def _is_its_hull(self):
        """Return whether every triangle lies on the hull."""
        planes = self.hull.equations
        return all((centers @ planes[:, :3].T + planes[:, 3]).max(axis=1).min() > -1e-7
                   for centers in np.array_split(self.center, len(self.center) // 500 + 1))  # fmt: skip

    def winding(self, points):
        """Return how often the surface winds around `points` (P, 3): 1 inside, 0 outside of a closed mesh."""
        a, b, c = np.moveaxis(self.corners[None] - np.asarray(points)[:, None, None], 2, 0)
        la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
        triple = np.einsum("pfi,pfi->pf", a, np.cross(b, c))
        dot = lambda u, v: np.einsum("pfi,pfi->pf", u, v)  # noqa: E731
        below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb
        return np.abs(2 * np.arctan2(triple, below).sum(axis=1)) / (4 * np.pi)

    def hits(self, origins, direction):
        """Return (ray, distance, triangle) for all crossings of lines through `origins` (R, 3) along one direction."""
        u = np.eye(3)[np.argmin(np.abs(direction))]
        u = np.cross(direction, u) / np.linalg.norm(np.cross(direction, u))
        plane = np.stack([u, np.cross(direction, u)])
        flat, points = self.corners @ plane.T, origins @ plane.T  # (F, 3, 2), (R, 2)
        low, high = points.min(axis=0), points.max(axis=0)
        near = np.flatnonzero(((flat.min(axis=1) <= high) & (flat.max(axis=1) >= low)).all(axis=1))
        steep = np.abs(self.normals[near] @ direction) > 1e-9
        near = near[steep]
        side = []
        for i, j in ((0, 1), (1, 2), (2, 0)):
            edge, to = flat[near, j] - flat[near, i], points[:, None] - flat[None, near, i]
            side.append(edge[:, 0] * to[..., 1] - edge[:, 1] * to[..., 0])
        side = np.stack(side)
        ray, triangle = np.nonzero((side >= 0).all(axis=0) | (side <= 0).all(axis=0))
        triangle = near[triangle]
        gap = np.einsum("ri,ri->r", self.corners[triangle, 0] - origins[ray], self.normals[triangle])
        return ray, gap / (self.normals[triangle] @ direction), triangle


def _sorted_by_place(points):
    """Return groups of at most `LEAF` rows of `points` (P, 3) that lie near each other."""
    waiting, done = [np.arange(len(points))], []
    while waiting:
        rows = waiting.pop()
        if len(rows) <= LEAF:
            done.append(rows)
            continue
        axis = np.argmax(np.ptp(points[rows], axis=0))
        half = len(rows) // 2
        parted = np.argpartition(points[rows, axis], half)
        waiting += [rows[parted[:half]], rows[parted[half:]]]
    return done
