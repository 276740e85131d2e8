"""Bodies inside closed meshes, which touch no surface and still collide.

To Coal a mesh is its surface, while boxes, cylinders, spheres and capsules are solid. A body that touches no surface of
a closed mesh is inside it with all of each connected part or with none of it, so one point of each part decides. Inside
is where the winding number (sum of solid angles, van Oosterom and Strackee, 1983) is at least 1: in any of several
shells, but not in a cavity, whose shell is wound against the one around it. It does not matter how a file winds them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
import trimesh
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from regrasp_opt.conventions import FloatArray, IntArray, invert
from regrasp_opt.geometry.shapes import mesh_faces

SAME_VERTEX = 1e-7
"""Vertices nearer to each other than this share of a mesh's extent are one where its surface is followed."""

PROBE = 0.002
"""Radius of the bodies that look for a way out of a mesh [m]; Coal may miss an overlap of much less."""

_HERE = coal.Transform3s()
_ALONG = [np.roll(np.eye(3), axis - 2, axis=0) for axis in range(3)]
"""Rotations that turn z into each axis."""

_SAMPLES = 32
"""Vertices of a shell that are looked at to see whether it lies in another."""


_CONTACTS = 100_000
"""Triangles of a mesh whose depth is measured at most."""


class Shells(NamedTuple):
    """What is known of a mesh as a solid.

    Attributes
    ----------
    points : (P, 3) array
        A vertex of each connected part.
    triangles : (F, 3, 3) array
        Corners of the closed parts, counter-clockwise as seen from outside the material.
    open_parts : int
        How many parts have an edge, and therefore no inside.
    """

    points: FloatArray
    triangles: FloatArray
    open_parts: int


def find_shells(vertices: FloatArray, faces: IntArray) -> Shells:
    """Return the parts of the mesh with `vertices` (V, 3) and `faces` (F, 3), the closed ones wound outward.

    Faces that a file has more than once are one, as both sides of a sheet are. Where that leaves a part open, they are
    taken for walls between solids, inside the material: left out where they are wound oppositely, else in pairs.
    What was found of a mesh is kept: a collision world, its check at home and its screens all ask for the same ones.
    """
    return _shells(np.asarray(vertices, dtype=np.float64).tobytes(), np.asarray(faces, dtype=np.int64).tobytes())


@lru_cache(maxsize=32)
def _shells(vertex_bytes: bytes, face_bytes: bytes) -> Shells:
    vertices = np.frombuffer(vertex_bytes).reshape(-1, 3)
    faces = np.frombuffer(face_bytes, dtype=np.int64).reshape(-1, 3)
    vertices, same = np.unique(vertices, axis=0, return_inverse=True)
    first, label = merge_close(vertices, SAME_VERTEX * max(float(np.ptp(vertices, axis=0).max()), 1e-9))
    vertices, faces = vertices[first], label[same.reshape(-1)[faces]]
    faces = faces[(np.diff(np.sort(faces, axis=1), axis=1) > 0).all(axis=1)]
    _, kept, which = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_inverse=True)
    turns = np.sign(faces - np.roll(faces, 1, axis=1)).prod(axis=1)
    copies, turns = (np.bincount(which.reshape(-1), weights=w, minlength=len(kept)) for w in (turns * turns, turns))
    faces = faces[kept]
    part = _parts(faces, len(vertices))
    left, sample = np.unique(part, return_index=True)
    shells: list[FloatArray] = []
    for walls in (copies == 0, turns == 0, copies % 2 == 0):
        at = np.flatnonzero(np.isin(part, left) & ~walls)
        piece = _parts(faces[at], len(vertices))
        closed = _closed(vertices, faces[at], piece)
        done = np.setdiff1d(part[at], part[at][~np.isin(piece, list(closed))])
        shells += [closed[p] for p in np.unique(piece[np.isin(part[at], done)]).tolist()]
        left = np.setdiff1d(left, done)
    triangles = np.concatenate([np.zeros((0, 3, 3)), *_outward(shells)])
    return Shells(vertices[faces[sample, 0]], triangles, len(left))


def merge_close(vertices: FloatArray, reach: float) -> tuple[IntArray, IntArray]:
    """Return which of the `vertices` (V, 3) stay where those within `reach` are one, and which of them each becomes."""
    pairs = KDTree(vertices).query_pairs(reach, output_type="ndarray")
    links = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(vertices),) * 2)
    _, label = connected_components(links, directed=False)
    return np.unique(label, return_index=True)[1], label


def _parts(faces: IntArray, vertices: int) -> IntArray:
    """Return the number of the connected part that each face (F,) is in."""
    links = coo_array(
        (np.ones(2 * len(faces)), (faces[:, :2].T.ravel(), faces[:, 1:].T.ravel())), shape=(vertices,) * 2
    )
    parts: IntArray = connected_components(links, directed=False)[1][faces[:, 0]]
    return parts


def _closed(vertices: FloatArray, faces: IntArray, part: IntArray) -> dict[int, FloatArray]:
    """Return the triangles (F, 3, 3) of the parts that are closed, each consistently wound, by their numbers."""
    which, turns = _edges(faces, len(vertices))
    edges = np.repeat(part, 3)
    odd = edges[np.bincount(which)[which] % 2 == 1]
    unbalanced = set(edges[np.bincount(which, weights=turns)[which] != 0].tolist())
    found = {p: vertices[faces[part == p]] for p in np.setdiff1d(part, odd).tolist()}
    for p in unbalanced & set(found):
        mesh = trimesh.Trimesh(vertices, faces[part == p], process=False)
        trimesh.repair.fix_winding(mesh)
        found[p] = vertices[mesh.faces]
        if not mesh.is_winding_consistent:
            del found[p]
    return found


def _edges(faces: IntArray, vertices: int) -> tuple[IntArray, IntArray]:
    """Return the number of each side's edge (3 F,), and 1 or -1 for the direction in which its face runs along it."""
    ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, which = np.unique(ends.min(axis=1) * vertices + ends.max(axis=1), return_inverse=True)
    return which.reshape(-1), np.where(ends[:, 0] < ends[:, 1], 1, -1)


def _outward(shells: list[FloatArray]) -> list[FloatArray]:
    """Return `shells`, each (F, 3, 3), with the material on the inner side of all but those of cavities."""
    volumes = np.array([np.linalg.det(shell).sum() for shell in shells])
    inside_out = volumes.sum() < 0
    found = []
    for shell, inward in zip(shells, volumes < 0, strict=True):
        samples = shell[:: -(-len(shell) // _SAMPLES), 0]
        cavity = inward != inside_out and any(
            (np.abs(winding_numbers(other, samples)) > 0.5).all()
            for other, turned in zip(shells, volumes < 0, strict=True)
            if turned == inside_out
        )
        found.append(shell[:, ::-1] if inward != cavity else shell)
    return found


def winding_numbers(triangles: FloatArray, points: FloatArray) -> FloatArray:
    """Return how often the surface of `triangles` (F, 3, 3) encloses each of the `points` (N, 3)."""
    found = np.empty(len(points))
    for n, point in enumerate(points):
        a, b, c = np.moveaxis(triangles - point, 1, 0)
        x, y, z = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        volume = np.einsum("fi,fi->f", a, np.cross(b, c))
        dots = [np.einsum("fi,fi->f", *pair) for pair in ((b, c), (c, a), (a, b))]
        found[n] = np.arctan2(volume, x * y * z + dots[0] * x + dots[1] * y + dots[2] * z).sum() / (2 * np.pi)
    return found


class Solid:
    """A Coal geometry, in its own frame, that knows its inside.

    Parameters
    ----------
    geometry : coal.CollisionGeometry
    faces : (F, 3), optional
        The triangles of a mesh, where they are at hand: Coal gives them one by one.

    Attributes
    ----------
    geometry : coal.CollisionGeometry
    radius : float
        Of a ball around it [m].
    box : (2, 3) array
        Low and high corner of the box around it [m].
    """

    def __init__(self, geometry: Any, faces: IntArray | None = None) -> None:
        geometry.computeLocalAABB()
        self._faces = faces
        self.geometry, self.radius = geometry, float(geometry.aabb_radius)
        self.box = np.array([geometry.aabb_local.min_, geometry.aabb_local.max_])
        self.is_mesh = isinstance(geometry, coal.BVHModelBase)

    @cached_property
    def shells(self) -> Shells:
        """What is known of the inside; other bodies than meshes have no triangles: Coal knows theirs."""
        if self.is_mesh:
            faces = mesh_faces(self.geometry) if self._faces is None else self._faces
            return find_shells(np.array(self.geometry.vertices()), faces)
        middle = self.geometry.points() if isinstance(self.geometry, coal.ConvexBase) else [self.geometry.aabb_center]
        return Shells(np.mean(middle, axis=0, keepdims=True), np.zeros((0, 3, 3)), 0)

    @cached_property
    def bounds(self) -> FloatArray | None:
        """The low and the high corner (2, 3) of what may be inside; None if nothing may."""
        corners = self.shells.triangles.reshape(-1, 3)
        return np.array([corners.min(axis=0), corners.max(axis=0)]) if len(corners) else None

    def may_hold(self, other: Solid) -> bool:
        """Return whether there is an inside, and anything that could be in it."""
        return self.bounds is not None and len(other.shells.points) > 0

    def holds(self, points: FloatArray) -> bool:
        """Return whether any of the `points` (N, 3) is inside a closed part."""
        if self.bounds is None:
            return False
        near = points[((points > self.bounds[0]) & (points < self.bounds[1])).all(axis=1)]
        return any(not self._has_way_out(p) and winding_numbers(self.shells.triangles, p[None])[0] > 0.5 for p in near)

    def _has_way_out(self, point: FloatArray) -> bool:
        """Return whether a thin body reaches from `point` (3,) out of the mesh along an axis: quicker than counting."""
        assert self.bounds is not None
        ways = (self.bounds - point) * ((-1.0,), (1.0,))  # distances to the sides
        request = coal.CollisionRequest()
        for number in np.argsort(ways, axis=None).tolist():
            side, axis = divmod(number, 3)
            half = (float(ways[side, axis]) + PROBE) / 2
            middle = point.copy()
            middle[axis] += (2 * side - 1) * half
            probe, along = coal.Capsule(PROBE, 2 * half), coal.Transform3s(_ALONG[axis], middle)
            if not coal.collide(self.geometry, _HERE, probe, along, request, coal.CollisionResult()):
                return True
        return False


def nested(a: Solid, b: Solid, T_a_b: FloatArray) -> bool:
    """Return whether one of two bodies that do not touch, `b` at `T_a_b` (4, 4) in `a`, holds the other."""
    T_b_a = invert(T_a_b)
    inside_a, inside_b = (o.shells.points @ T[:3, :3].T + T[:3, 3] for o, T in ((b, T_a_b), (a, T_b_a)))
    return a.holds(inside_a) or b.holds(inside_b)


def overlap(a: Solid, b: Solid) -> float:
    """Return the distance that is stated of bodies of which Coal cannot say how deep they overlap [m]: negative."""
    return -min(a.radius, b.radius)


def distance(a: Solid, b: Solid, T_world_a: FloatArray, T_world_b: FloatArray) -> float:
    """Return the distance of two bodies at poses (4, 4) [m], negative where they overlap or one is in the other.

    How deep a mesh overlaps another body is not measured: it is at least what `overlap` says.
    """
    transforms = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (T_world_a, T_world_b)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    found = float(coal.distance(a.geometry, transforms[0], b.geometry, transforms[1], request, result))
    touching = found <= 0 and (a.is_mesh or b.is_mesh)  # Coal ends at the first such triangle, however deep others are
    return min(found, overlap(a, b)) if touching or nested(a, b, invert(T_world_a) @ T_world_b) else found


def separation(a: Solid, b: Solid, T_world_a: FloatArray, T_world_b: FloatArray) -> float:
    """Return the distance of two bodies at poses (4, 4) [m]; where they overlap, less than minus their depth.

    Of a mesh that touches a convex body it is minus the depth of the deepest triangle, and of two meshes what `overlap`
    says: they can be apart, but not touch.
    """
    found = distance(a, b, T_world_a, T_world_b)
    if found > 0 or a.is_mesh == b.is_mesh or nested(a, b, invert(T_world_a) @ T_world_b):
        return found
    request, result = coal.CollisionRequest(coal.CollisionRequestFlag.CONTACT, _CONTACTS), coal.CollisionResult()
    transforms = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (T_world_a, T_world_b)]
    coal.collide(a.geometry, transforms[0], b.geometry, transforms[1], request, result)
    return min((result.getContact(k).penetration_depth for k in range(result.numContacts())), default=found)


class Containment:
    """Which pairs of bodies of a Pinocchio geometry model are one inside the other.

    To be asked where no surfaces touch. Bodies are first looked at in another geometry model, of boxes around what may
    hold others and balls around the points to be tested; for most it has nothing, and no time is lost.

    Parameters
    ----------
    model, data
        The robot's.
    geometry : pin.GeometryModel
    pairs : sequence of (int, int)
        Numbers of the bodies that are tested against each other.
    solids : list of Solid
        The bodies.
    """

    def __init__(
        self, model: Any, data: Any, geometry: Any, pairs: Sequence[tuple[int, int]], solids: list[Solid]
    ) -> None:
        self._model, self._data, self._geometry = model, data, geometry
        self.solids = solids
        self._screen = pin.GeometryModel()
        self._copies: dict[int, list[tuple[int, Any]]] = defaultdict(list)
        self._tests: list[tuple[int, int, int]] = []  # pair, the body that may be inside, the body around it
        known: dict[tuple[int, bool], int] = {}
        for number, pair in enumerate(pairs):
            for inner, outer in (pair, pair[::-1]):
                if self.solids[outer].may_hold(self.solids[inner]):
                    for index, whole in ((inner, False), (outer, True)):
                        if (index, whole) not in known:
                            known[index, whole] = self._copy(index, whole)
                    self._screen.addCollisionPair(pin.CollisionPair(known[inner, False], known[outer, True]))
                    self._tests.append((number, inner, outer))
        self._screen_data = self._screen.createData()

    def _copy(self, index: int, whole: bool) -> int:
        """Put a box around the shells of a body, or a ball around its points, into the other model."""
        item, solid = self._geometry.geometryObjects[index], self.solids[index]
        corners = solid.shells.triangles.reshape(-1, 3) if whole else solid.shells.points
        low, high = corners.min(axis=0), corners.max(axis=0)
        size = high - low
        shape = coal.Box(*size) if whole else coal.Sphere(1e-6 + float(np.linalg.norm(size)) / 2)
        offset = pin.SE3(np.eye(3), (low + high) / 2)
        copy = pin.GeometryObject(f"{index}", item.parentJoint, item.placement * offset, shape)
        number = int(self._screen.addGeometryObject(copy))
        self._copies[index].append((number, offset))
        return number

    def moved(self, index: int) -> None:
        """Note that the placement of a body has changed."""
        for number, offset in self._copies.get(index, ()):
            self._screen.geometryObjects[number].placement = self._geometry.geometryObjects[index].placement * offset

    def found(self, q: FloatArray) -> list[int]:
        """Return the numbers of the pairs of which one body is inside the other at configuration `q` (dof,)."""
        if not self._tests:
            return []
        screen = self._model, self._data, self._screen, self._screen_data, q
        if not pin.computeCollisions(*screen, True):
            return []
        pin.computeCollisions(*screen, False)
        return [
            number
            for result, (number, inner, outer) in zip(self._screen_data.collisionResults, self._tests, strict=True)
            if result.isCollision() and self._holds(outer, inner)
        ]

    def _holds(self, outer: int, inner: int) -> bool:
        """Return whether a body holds another where the data's joints are."""
        items = self._geometry.geometryObjects
        T_outer, T_inner = (self._data.oMi[items[i].parentJoint] * items[i].placement for i in (outer, inner))
        T = T_outer.actInv(T_inner).homogeneous
        return self.solids[outer].holds(self.solids[inner].shells.points @ T[:3, :3].T + T[:3, 3])
