"""Rotational symmetry: about which axes through its centre of mass an object looks the same when it is turned.

It is measured on the surface: after a turn, vertices and middles of faces must lie on the surface as it was, to within
`ALIKE` of the longest extent. What does so after any turn is a body of revolution, however its round side is cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray
from regrasp_opt.objects.changes import nearest_on
from regrasp_opt.objects.model import ObjectModel

ALIKE = 0.005
"""Largest distance of a turned surface from itself, as a share of the longest extent, that counts as none."""

LARGEST_ORDER = 36
"""Largest number of sides that is told from a body of revolution."""

_ODD_TURNS = 2.399963 * np.arange(1, 8)
"""Multiples of the golden angle [rad]: no prism of few sides looks the same after all of them."""

_FIRST = 40
"""Points of the surface that are tested first."""

_CUBES = 50
"""Cubes along the longest extent: of the surface in each, one vertex and one middle of a face are tested."""


class Symmetry(NamedTuple):
    """One axis of symmetry.

    Attributes
    ----------
    axis : (3,)
        Unit vector in the object frame; the axis goes through the centre of mass.
    order : int or None
        The object looks the same after a turn by ``2 pi / order``; after any turn, if None.
    """

    axis: FloatArray
    order: int | None

    def turns(self, count: int) -> FloatArray:
        """Return the angles of the equal poses [rad] but 0: all of them, or `count` of a body of revolution."""
        number = self.order or count
        return wrapped(2 * np.pi * np.arange(1, number) / number)


def symmetries(model: ObjectModel) -> list[Symmetry]:
    """Return the axes of the highest order about which `model` is symmetric; none, if there is no such axis.

    Candidates are the principal axes of inertia and the verticals of the stable placements.
    """
    axes = [*np.linalg.eigh(model.mesh.moment_inertia)[1].T, *(p.pose[2, :3] for p in model.placements)]
    points = _surface_points(model)
    found: list[Symmetry] = []
    for axis in axes:
        if all(abs(axis @ other.axis) < 1 - 1e-6 for other in found):
            order = _order(model, points, axis)
            if order != 1:
                found.append(Symmetry(np.array(axis, dtype=np.float64), order))
    best = max((each.order or np.inf for each in found), default=0)
    return [each for each in found if (each.order or np.inf) == best]


def wrapped(angles: FloatArray) -> FloatArray:
    """Return `angles` [rad] in (-pi, pi]."""
    return np.pi - (np.pi - angles) % (2 * np.pi)


def is_symmetry(model: ObjectModel, turn: FloatArray) -> bool:
    """Return whether `model` looks the same after a turn about its centre of mass by a rotation vector (3,) [rad].

    `symmetries` tries some turns of all, so twice `ALIKE` is allowed here: what it finds is never denied.
    """
    return _alike(model, _surface_points(model), turn, 2 * ALIKE)


def turn_about(point: FloatArray, turn: FloatArray) -> FloatArray:
    """Return the transform (4, 4) that turns about `point` (3,) by the rotation vector `turn` (3,) [rad]."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(turn).as_matrix()
    T[:3, 3] = point - T[:3, :3] @ point
    return T


def _surface_points(model: ObjectModel) -> FloatArray:
    """Return points (P, 3) of the surface, seen from the centre of mass."""
    side, found = float(model.mesh.extents.max()) / _CUBES, []
    for points in (model.vertices, np.asarray(model.mesh.triangles_center)):
        cubes = np.floor(points / side).astype(np.int64)
        found.append(points[np.unique(cubes, axis=0, return_index=True)[1]])
    return np.concatenate(found) - model.center_of_mass


def _order(model: ObjectModel, points: FloatArray, axis: FloatArray) -> int | None:
    """Return the order of `axis`; 1 where there is no symmetry, None where there is any."""
    if all(_alike(model, points, angle * axis) for angle in _ODD_TURNS):
        return None
    for order in range(LARGEST_ORDER, 1, -1):
        if all(_alike(model, points, 2 * np.pi * k / order * axis) for k in range(1, order // 2 + 1)):
            return order
    return 1


def _alike(model: ObjectModel, points: FloatArray, turn: FloatArray, share: float = ALIKE) -> bool:
    """Return whether `points` (P, 3) about the centre of mass, turned, lie on the surface to within a `share`."""
    turned = points @ Rotation.from_rotvec(turn).as_matrix().T + model.center_of_mass
    limit, step = share * float(model.mesh.extents.max()), -(-len(points) // _FIRST)
    return all(float(nearest_on(model.solid.geometry, some)[0].max()) <= limit for some in (turned[::step], turned))
