"""Stable placements: the ways in which an object rests on a flat table, each with its stability margin.

The support of a hull facet is that facet with all others whose normals are within `MERGE_ANGLE` of its own,
so that a face cut into many slightly tilted triangles counts as one. A facet is stable when the centre of
mass lies well above its support and the body does not roll there (`rolling`). Stable facets that lead from one
to the next in steps of at most `MERGE_ANGLE`, or along a round side, are rolling neighbours: one placement,
which takes the best margin among them and the pose in which the object comes to rest there, the one with the
centre of mass lowest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
import trimesh
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import MeshError
from regrasp_opt.objects.rolling import LEAST_MARGIN, MERGE_ANGLE, Hull

_NO_MARGIN = 1e-3
"""Facets with less stand on an edge."""

TIE = 1e-6
"""Margins closer than this count as equal when placements are ordered."""

FLIP = np.diag([1.0, -1.0, -1.0])
"""Half a turn about x."""


@dataclass(frozen=True, eq=False)
class Placement:
    """One way of resting on the table.

    Attributes
    ----------
    pose : FloatArray
        ``T_world_object`` (4, 4) at xi = 0: the support on z = 0, the centre of mass above the world origin.
    margin : float
        Least distance of the projected centre of mass to the edge of the support polygon, over its height
        above the support.
    """

    pose: FloatArray
    margin: float


class RejectedPlacement(NamedTuple):
    """A way of resting that is not stable enough, and why: ``"rolls"`` or ``"margin"``."""

    placement: Placement
    reason: Literal["rolls", "margin"]


def stable_placements(
    mesh: trimesh.Trimesh, min_margin: float = LEAST_MARGIN, center_of_mass: FloatArray | None = None
) -> tuple[Placement, ...]:
    """Return the placements of a solid whose margin is at least `min_margin`.

    They are ordered by decreasing margin; equal ones by the direction of their support in the object frame. The
    result does not depend on how the surface is triangulated.

    Parameters
    ----------
    mesh : trimesh.Trimesh
        A watertight mesh [m].
    min_margin : float
        Smallest relative stability margin that counts as stable.
    center_of_mass : (3,), optional
        In the frame of the mesh [m]; that of uniform density by default.

    Raises
    ------
    MeshError
        If the mesh is flat, so that it has no convex hull.
    """
    center = mesh.center_mass if center_of_mass is None else center_of_mass
    facets = _Facets.of(mesh, min_margin, center)
    found, taken = [], np.zeros(len(facets.margins), dtype=bool)
    for rest, margin in facets.rests(min_margin):
        if taken[rest] or facets.hull.rolls(rest):
            continue
        taken[facets.hull.neighbors(rest)] = True
        normal = facets.hull.normals[rest]
        found.append((Placement(_resting_pose(mesh, rotation_to_down(normal), center), margin), normal))
    return _ordered(found)


def rejected_placements(
    mesh: trimesh.Trimesh, min_margin: float = LEAST_MARGIN, center_of_mass: FloatArray | None = None
) -> tuple[RejectedPlacement, ...]:
    """Return the other ways in which the solid can rest, by decreasing margin; parameters and errors as above."""
    center = mesh.center_mass if center_of_mass is None else center_of_mass
    facets = _Facets.of(mesh, _NO_MARGIN, center)
    found = []
    for rest, margin in facets.rests(_NO_MARGIN):
        rolls = facets.hull.rolls(rest)
        if rolls or margin < min_margin:
            pose = _resting_pose(mesh, rotation_to_down(facets.hull.normals[rest]), center)
            found.append(RejectedPlacement(Placement(pose, margin), "rolls" if rolls else "margin"))
    return tuple(found)


class _Facets(NamedTuple):
    """The hull's facets, which of them are in each other's support (F, F), and the margins (F,).

    A margin that cannot reach what was asked for is not measured exactly: an upper bound takes its place, the reach of
    the support in one direction. This is what makes round bodies quick: few of their supports reach that far.
    """

    hull: Hull
    linked: csr_array
    margins: FloatArray

    @staticmethod
    def of(mesh: trimesh.Trimesh, least: float, center_of_mass: FloatArray) -> _Facets:
        points = np.asarray(mesh.vertices, dtype=np.float64) - center_of_mass
        try:
            hull = Hull(points)
        except QhullError as error:
            raise MeshError("the mesh is flat and has no convex hull; give a solid") from error
        linked = _alike(hull.normals)
        supports = np.split(linked.indices, linked.indptr[1:-1])
        numbers, corners = np.unique(hull.simplices, return_inverse=True)
        corners, points = corners.reshape(-1, 3), points[numbers]
        triangles = points[corners]
        below = (triangles.mean(axis=1) * hull.normals).sum(axis=1, keepdims=True) * hull.normals
        back = below - triangles.mean(axis=1)  # from a facet's middle to below the centre of mass
        margins = np.linalg.norm(back, axis=1)
        for f, (support, normal, height) in enumerate(zip(supports, hull.normals, hull.heights, strict=True)):
            reach, length = float((triangles[support] @ back[f]).max()), margins[f]
            margins[f] = reach / (length * height) if length > TIE * height else np.inf
            if margins[f] >= least - TIE:
                there = np.bincount(corners[support].ravel(), minlength=len(points)) > 0
                margins[f] = inner_distance(points[there], normal) / height
        return _Facets(hull, linked, margins)

    def rests(self, min_margin: float) -> list[tuple[int, float]]:
        """Return the facet at rest, and the best margin, of each group of rolling neighbours, by decreasing margin."""
        found, members = [], np.flatnonzero(self.margins >= min_margin)
        count, labels = connected_components(self.linked[members][:, members], directed=False)
        for group in (members[labels == label] for label in range(count)):
            best = self.linked[[group[np.argmax(self.margins[group])]]].indices
            found.append((int(best[np.argmin(self.hull.heights[best])]), float(self.margins[group].max())))
        return sorted(found, key=lambda each: -each[1])


def rotation_to_down(normal: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) that takes the unit vector `normal` (3,) to -z without needless yaw.

    It is the least rotation; near +z, where that is ill-defined, half a turn about x comes before it.
    """
    first = FLIP if normal[2] > 0.9 else np.eye(3)
    a, b, c = first @ normal
    # Rodrigues' formula about the axis (-b, a, 0); 1 - c is bounded away from zero here.
    k = 1.0 / (1.0 - c)
    least = np.array([[1 - k * a * a, -k * a * b, a], [-k * a * b, 1 - k * b * b, b], [-a, -b, -c]])
    return least @ first


def _alike(normals: FloatArray) -> csr_array:
    """Return which `normals` (F, 3) are within `MERGE_ANGLE` of each other, themselves included, (F, F)."""
    pairs = KDTree(normals).query_pairs(2 * np.sin(MERGE_ANGLE / 2), output_type="ndarray")
    rows, columns = (np.concatenate([*each, np.arange(len(normals))]) for each in (pairs.T, pairs.T[::-1]))
    found = coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(len(normals), len(normals))).tocsr()
    found.sort_indices()
    return found


def inner_distance(points: FloatArray, normal: FloatArray) -> float:
    """Return the least distance, seen along `normal`, of the origin to the edge of the hull of `points`.

    `points` are (P, 3); the distance is negative when the origin lies outside.
    """
    polygon = (points @ rotation_to_down(normal).T)[:, :2]
    try:
        return float(-ConvexHull(polygon).equations[:, 2].max())
    except QhullError:
        return -np.inf


def _resting_pose(mesh: trimesh.Trimesh, rotation: FloatArray, center_of_mass: FloatArray) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = -rotation @ center_of_mass
    pose[2, 3] = -(np.asarray(mesh.vertices) @ rotation[2]).min()
    return pose


def _ordered(found: list[tuple[Placement, FloatArray]]) -> tuple[Placement, ...]:
    """Sort by decreasing margin, and within runs of equal margins by the support's normal."""
    found = sorted(found, key=lambda item: -item[0].margin)
    ranks = np.cumsum(np.diff([-placement.margin for placement, _ in found], prepend=-np.inf) > TIE)
    keys = [(rank, *(np.round(normal, 4) + 0.0)) for rank, (_, normal) in zip(ranks, found, strict=True)]
    return tuple(found[index][0] for index in sorted(range(len(found)), key=keys.__getitem__))
