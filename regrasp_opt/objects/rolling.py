r"""Whether a body can roll where it stands, however its round sides are cut into facets.

A convex hull that rests with the direction :math:`u` down has its centre of mass at the height

.. math:: H(u) = \max_v \; v \cdot u

over the hull's vertices :math:`v`, seen from the centre of mass: its potential energy over its weight. Facets with the
centre of mass above them are minima of `H`, edges are the passes between them. Turning over the edge from facet `i` to
facet `j` lifts the centre of mass to the distance :math:`s_{ij}` of the edge: of a prism of `n` sides, by
:math:`1 / \cos(\pi / n) - 1` of its height, 3.5 % for 12 sides, 8.2 % for 8 and 15.5 % for 6.

Two rules say what rolls:

* **It rolls away** if it can be turned by `FAR` from facet `r`, edge by edge, while the centre of mass stays level,
  :math:`|H(u) - H_r| \le \mathrm{DIP} \, H_r`. Tipping over a single edge never goes as far: it leaves that band after
  :math:`\arccos \frac{1}{1 + \mathrm{DIP}} + \arccos \frac{1 - \mathrm{DIP}}{1 + \mathrm{DIP}}`, 43 degrees. So a body
  that tips is not one that rolls, and its margin decides. Balls, cylinders, cones and scans of them roll away.
* **It rocks** on a round side: a run of at least `RUN` facets, with parallel edges, alike in width and in the angle
  :math:`\delta` from one to the next. Facets of width `w` stand for a side of radius
  :math:`\rho = w / (2 \tan(\delta / 2))`, which rests on a strip of half width
  :math:`\rho \tan(\mathrm{MERGE\_ANGLE})` when it is cut as finely as `placements` tells facets apart. Where this half
  width is below `LEAST_MARGIN` of the height, the facets are not a place to rest. A mug with a handle rolls on such a
  side until the handle stops it.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull

from regrasp_opt.conventions import FloatArray, IntArray

MERGE_ANGLE = np.pi / 64
"""Facets of the hull whose normals are within this angle of a facet belong to its support [rad]."""

LEAST_MARGIN = 0.1
"""Least distance of the projected centre of mass to the edge of the support, over its height, that is stable."""

DIP = 0.05
"""Edges that lift the centre of mass by less than this share of its height do not keep a body from rolling."""

FAR = np.radians(75.0)
"""A body that can be turned this far on one level rolls away [rad]."""

RUN = 4
"""Facets in a row, each like the one before, that make a round side."""

_LARGEST_STEP = 2 * np.arccos(1 / (1 + DIP))
"""Angle between facets of a regular prism whose dip is `DIP`, 35.5 degrees [rad]."""

_ALIKE = 1.25
"""Largest ratio of the widths, and of the angles, of neighbours on a round side."""

_PARALLEL = np.cos(np.radians(30.0))
_FLAT = MERGE_ANGLE / 8


class Hull:
    """Convex hull (F triangles) of a body about its centre of mass, and how it turns from one facet to the next.

    Attributes
    ----------
    normals, heights : (F, 3), (F,)
        Outward unit normal of each triangle, and its distance from the centre of mass [m].
    simplices : (F, 3)
        Its vertices, as numbers into the points.

    Raises
    ------
    QhullError
        If the points (V, 3) are in one plane.
    """

    def __init__(self, points: FloatArray) -> None:
        hull = ConvexHull(points)
        self.normals, self.heights = hull.equations[:, :3], -hull.equations[:, 3]
        self.simplices: IntArray = hull.simplices
        # Each edge twice, from triangle `_from` to triangle `_to`.
        self._from, self._to = np.repeat(np.arange(len(self.normals)), 3), hull.neighbors.ravel()
        corner = self.simplices[:, [[1, 2], [2, 0], [0, 1]]].reshape(-1, 2)
        self._middle = points[corner].mean(axis=1)
        along = points[corner[:, 1]] - points[corner[:, 0]]
        self._along = along / np.linalg.norm(along, axis=1, keepdims=True)
        a, b = self.normals[self._from], self.normals[self._to]
        self._step = 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=1) / 2, 0, 1))
        # The body turns about the edge; it passes over it where the foot of the perpendicular is between the normals.
        foot = self._middle - (self._middle * self._along).sum(axis=1, keepdims=True) * self._along
        between = (np.cross(a, foot) * np.cross(foot, b)).sum(axis=1) > 0
        sides = self.heights[self._from], self.heights[self._to]
        self._reach = np.linalg.norm(foot, axis=1)
        self._pass = np.where(between, self._reach, np.maximum(*sides))
        self._lower = np.minimum(*sides)
        self._face = self._joined(self._step <= _FLAT)
        borders = np.flatnonzero(self._face[self._from] != self._face[self._to])
        borders = borders[np.argsort(self._face[self._from[borders]], kind="stable")]
        ends = np.searchsorted(self._face[self._from[borders]], np.arange(1, self._face.max() + 1))
        self._borders: list[IntArray] = np.split(borders, ends)  # of each face, the edges that leave it

    def rolls(self, facet: int) -> bool:
        """Return whether the body rolls away from triangle `facet`, or rocks on it."""
        return self._rolls_away(facet) or any(self._rocks(facet, edge) for edge in self._small_steps(facet))

    def facet_below(self, down: FloatArray) -> int:
        """Return the triangle on which the body rests when the unit vector `down` (3,) points to the table."""
        return int(np.argmax(self.normals @ down))

    def neighbors(self, facet: int) -> IntArray:
        """Return the triangles that lead on from triangle `facet` along a round side, with itself; else none."""
        faces = [face for edge in self._small_steps(facet) for face in self._side(facet, edge)]
        return np.flatnonzero(np.isin(self._face, faces))

    def _joined(self, passable: np.ndarray) -> IntArray:
        """Return a label for each triangle, equal where `passable` edges lead from one to the other."""
        size, links = len(self.normals), (self._from[passable], self._to[passable])
        graph = coo_array((np.ones(len(links[0])), links), shape=(size, size))
        labels: IntArray = connected_components(graph, directed=False)[1]
        return labels

    def _rolls_away(self, facet: int) -> bool:
        height = self.heights[facet]
        level = (self._pass <= (1 + DIP) * height) & (self._lower >= (1 - DIP) * height)
        labels = self._joined(level)
        return bool((self.normals[labels == labels[facet]] @ self.normals[facet] < np.cos(FAR)).any())

    def _rocks(self, facet: int, edge: int) -> bool:
        if not self._side(facet, edge):
            return False
        reach, height = self._reach[[edge, self._across(edge)[0]]], self.heights[facet]
        width = np.sqrt((reach**2 - height**2).clip(min=0)).sum()  # where the centre of mass is
        radius = width / (2 * np.tan(self._step[edge] / 2))
        return bool(radius * np.tan(MERGE_ANGLE) < LEAST_MARGIN * height)

    def _small_steps(self, facet: int) -> IntArray:
        """Return the edges at which a face begins that is tilted a little against that of `facet`."""
        edges = self._borders[self._face[facet]]
        return edges[self._step[edges] <= _LARGEST_STEP]

    def _side(self, facet: int, edge: int) -> list[int]:
        """Return the face of `facet` and its neighbours over `edge` and opposite, if these lead along a round side."""
        opposite, _ = self._across(edge)
        if opposite is None or self._step[edge] < 2 * MERGE_ANGLE - 1e-6:  # cut finely enough as it is
            return []
        ahead, behind = self._faces_ahead(edge), self._faces_ahead(opposite)
        if not _alike(self._step[edge], self._step[opposite]):
            behind = []
        is_side = ahead and len(ahead) + len(behind) + 1 >= RUN
        return [*behind[:1], int(self._face[facet]), *ahead[:1]] if is_side else []

    def _faces_ahead(self, edge: int) -> list[int]:
        """Return the faces beyond `edge`, each like the one before it."""
        faces: list[int] = []
        _, width = self._across(edge)
        step = self._step[edge]
        while self._step[edge] <= _LARGEST_STEP and _alike(self._step[edge], step):
            first = 3 * self._to[edge]  # each triangle has three edges in a row
            back = int(first + np.argmax(self._to[first : first + 3] == self._from[edge]))
            following, beyond = self._across(back)
            face = int(self._face[self._to[edge]])
            if following is None or not _alike(width, beyond) or face in faces:
                break
            faces.append(face)
            edge, width, step = following, beyond, self._step[edge]
        return faces

    def _across(self, edge: int) -> tuple[int | None, float]:
        """Return the edge opposite `edge` on the face that `edge` leaves, None without one, and its distance [m]."""
        start = self._from[edge]
        parallel = self._borders[self._face[start]]
        parallel = parallel[np.abs(self._along[parallel] @ self._along[edge]) >= _PARALLEL]
        sideways = np.cross(self._along[edge], self.normals[start])
        away = np.abs((self._middle[parallel] - self._middle[edge]) @ sideways)
        farthest = int(np.argmax(away))
        if away[farthest] <= 0.0:
            return None, 0.0
        return int(parallel[farthest]), float(away[farthest])


def _alike(a: float, b: float) -> bool:
    return max(a, b) <= _ALIKE * min(a, b)
