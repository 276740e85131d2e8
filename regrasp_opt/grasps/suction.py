"""Suction grasps: spots where the whole mouth of the cup lies on a smooth piece of the surface.

The seal is checked with rays along the approach on the cup's rim and on rings inside it. Every ray must meet
the surface at nearly the depth of the centre, with a normal close to the approach, and no sharp crease may
pass under the cup; so edges, steps, slots and holes are rejected. How much curvature and faceting a lip
follows depends on the cup: there are grades, and `sample_grasps` takes the strictest that gives enough.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.grasps.candidates import GraspCandidates, frames_about
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.surface import CREASE_ANGLE, TriangleSurface, cast_rays, sample_points, tangents
from regrasp_opt.grasps.table import TableRoom

YAWS = 8
"""Rotations of the cup about its approach at each spot."""

SEAL_DEPTHS = np.array([0.10, 0.20, 0.45])
"""Largest range of depths under the cup, as a share of its radius, by grade: flat cup, soft lip, bellows."""

SEAL_ANGLES = np.deg2rad([18.0, 28.0, 50.0])
"""Largest angle between the approach and the surface normals under the cup, by grade [rad]."""

SEAL_CREASES = np.array([CREASE_ANGLE, np.deg2rad(45.0), np.deg2rad(60.0)])
"""Largest angle by which the surface may bend at one edge under the cup, by grade [rad]."""

PROBED_DEPTH = 2 * SEAL_DEPTHS[-1]
"""How far below the centre rays look, in radii of the cup: twice what seals, as the first guess is rough."""

NO_SEAL = len(SEAL_DEPTHS)
"""The grade of a spot where no cup seals."""

FIRST_RINGS = ((1.0, 8), (0.5, 8))
RINGS = ((1.0, 24), (0.75, 16), (0.5, 12), (0.25, 6))
"""Radii of the probed rings as shares of the cup's radius, with their numbers of rays."""


class RingProbe(NamedTuple):
    """What rays under a cup find: range of depths (N,) [m], largest angle (N,) [rad], mean normal (N, 3)."""

    depth: FloatArray
    angle: FloatArray
    normal: FloatArray


def suction_candidates(
    surface: TriangleSurface,
    end_effector: EndEffector,
    clearance: GripperClearance,
    room: TableRoom | None,
    points: int,
    rng: np.random.Generator,
) -> GraspCandidates:
    """Return sealed grasps at up to `points` random spots, each with `YAWS` rotations.

    Those that a screen finds to overlap the object are left out, and given the `room` above a table, those without room
    in any placement.
    """
    centers, face = sample_points(surface, points, rng)
    approach, grade = seal_grades(surface, centers, -surface.normals[face], end_effector.cup_radius)
    sealed = grade < NO_SEAL
    frames = frames_about(centers[sealed], approach[sealed], YAWS, rng.normal(size=(int(sealed.sum()), 3)))
    grade, width = np.repeat(grade[sealed], YAWS), np.zeros(len(frames))
    kept = clearance.may_be_free(frames, width)
    if room is not None:
        kept &= room.free(frames, width).any(axis=1)
    return GraspCandidates(frames, width, grade).where(kept)


def seal_grades(
    surface: TriangleSurface, centers: FloatArray, approach: FloatArray, radius: float
) -> tuple[FloatArray, IntArray]:
    """Return the approach against the mean normal under the cup (N, 3), and the grade of the seal (N,).

    `centers` (N, 3) [m] lie on the surface, the unit vectors `approach` (N, 3) into it are the first guess of the
    approach, and `radius` is that of the cup's rim [m].
    """
    first = _probe(surface, centers, approach, radius, FIRST_RINGS)
    left = np.flatnonzero((first.depth < PROBED_DEPTH * radius) & (first.angle < np.pi / 2))
    approach, grade = approach.copy(), np.full(len(centers), NO_SEAL)
    approach[left] = -first.normal[left]
    grade[left] = mouth_grades(surface, centers[left], approach[left], radius)[1]
    return approach, grade


def mouth_grades(
    surface: TriangleSurface, centers: FloatArray, approach: FloatArray, radius: float
) -> tuple[RingProbe, IntArray]:
    """Return what is under cups that stand at `centers` (N, 3) along `approach` (N, 3), and the grade (N,) of the seal.

    Depths count from the centres; `radius` is that of the rim [m].
    """
    probe = _probe(surface, centers, approach, radius, RINGS)
    crease = _sharpest_crease(surface, centers, approach, radius)
    limits = (SEAL_DEPTHS * radius, probe.depth), (SEAL_ANGLES, probe.angle), (SEAL_CREASES, crease)
    return probe, np.max([np.searchsorted(bounds, values) for bounds, values in limits], axis=0)


def _probe(
    surface: TriangleSurface,
    centers: FloatArray,
    approach: FloatArray,
    radius: float,
    rings: tuple[tuple[float, int], ...],
) -> RingProbe:
    """Cast rays along `approach` on `rings` about `centers`; one that finds nothing near is infinitely deep."""
    angle = np.concatenate([2 * np.pi * np.arange(rays) / rays for _, rays in rings])
    share = np.concatenate([np.full(rays, share) for share, rays in rings])
    u, v = tangents(approach)
    disc = radius * share[:, None] * (np.cos(angle)[:, None] * u[:, None] + np.sin(angle)[:, None] * v[:, None])
    directions = np.repeat(approach, len(angle), axis=0)
    origins = ((centers - radius * approach)[:, None] + disc).reshape(-1, 3)
    hits = cast_rays(surface, origins, directions, (0.0, (1.0 + PROBED_DEPTH) * radius))
    ahead = hits.distance > 0
    order = np.lexsort((hits.distance[ahead], hits.ray[ahead]))
    ray, first = np.unique(hits.ray[ahead][order], return_index=True)
    face, distance = hits.face[ahead][order][first], hits.distance[ahead][order][first]
    depth, normal = np.full(len(directions), np.inf), np.zeros((len(directions), 3))
    depth[ray], normal[ray] = distance - radius, surface.normals[face]
    cosine = -np.einsum("rj,rj->r", normal, directions).clip(-1.0, 1.0)
    shape = (len(centers), len(angle))
    lowest, highest = depth.reshape(shape).max(axis=1), depth.reshape(shape).min(axis=1)
    mean = normal.reshape(*shape, 3).sum(axis=1)
    return RingProbe(
        depth=np.maximum(lowest, 0.0) - np.minimum(highest, 0.0),
        angle=np.arccos(cosine).reshape(shape).max(axis=1),
        normal=mean / np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12),
    )


def _sharpest_crease(surface: TriangleSurface, centers: FloatArray, approach: FloatArray, radius: float) -> FloatArray:
    """Return the largest bend of the surface at an edge under each cup (N,) [rad]; 0 where there is none."""
    u, v = tangents(approach)
    start = surface.creases[None, :, 0] - centers[:, None]
    along = surface.creases[None, :, 1] - surface.creases[None, :, 0]
    planes = np.stack([u, v], axis=1)
    flat_start = np.einsum("ncj,npj->ncp", start, planes)
    flat_along = np.einsum("ncj,npj->ncp", np.broadcast_to(along, start.shape), planes)
    length = np.maximum((flat_along**2).sum(axis=-1), 1e-18)
    nearest = np.clip(-(flat_start * flat_along).sum(axis=-1) / length, 0.0, 1.0)[..., None]
    distance = np.linalg.norm(flat_start + nearest * flat_along, axis=-1)
    depth = np.einsum("ncj,nj->nc", start + nearest * along, approach)
    under = (distance < radius) & (np.abs(depth) < radius)
    return np.max(np.where(under, surface.crease_angles, 0.0), axis=1, initial=0.0)
