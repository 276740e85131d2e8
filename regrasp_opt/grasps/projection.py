"""Grasps near given tool poses: the tool is put on the object's surface, and kept if the sampler would accept it.

A tool pose that came out of an optimisation is a little off the surface. Here its contacts are found, the tool is
centred between them (or pressed on the surface), and the same rules as in sampling decide: both contacts inside their
friction cones, widths within the jaw, a sealed rim, body and fingers clear of the object.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.grasps.antipodal import FRICTION, MIN_WIDTH, contact_depths, contact_pairs
from regrasp_opt.grasps.candidates import frames_about
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.grasps.holding import Failure, failures_on
from regrasp_opt.grasps.suction import NO_SEAL, seal_grades
from regrasp_opt.grasps.surface import TriangleSurface, cast_rays, make_surface, sample_points
from regrasp_opt.objects import ObjectModel

SHIFT = 0.03
"""Farthest that a contact or rim may be from where the tool pose has it [m]."""


LOOSE = 0.3
"""Cosine between closing line and normals from which it is worth turning the tool towards them."""


class GraspProjector:
    """Puts tool poses on one object with one end-effector."""

    def __init__(self, model: ObjectModel, end_effector: EndEffector) -> None:
        self._surface = make_surface(model.mesh)
        self._clearance = GripperClearance(model.vertices, model.faces, end_effector)
        self._effector = end_effector

    def anywhere(self, count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """Return at most `count` tool poses (K, 4, 4) anywhere on the surface, and widths (K,); not settled yet."""
        if self._effector.kind == "suction":
            points, face = sample_points(self._surface, count, rng)
            return frames_about(points, -self._surface.normals[face], 1, rng.normal(size=(count, 3))), np.zeros(count)
        middle, closing, width = contact_pairs(self._surface, self._effector, count, rng)
        chosen = rng.permutation(len(middle))[:count]
        toward = rng.normal(size=(len(chosen), 3))
        return frames_about(middle[chosen], closing[chosen], 1, toward, closing=True), width[chosen]

    def worst_grade(self, grasps: GraspSet) -> int:
        """Return the worst grade of seal among suction `grasps`; 0 for parallel ones."""
        if grasps.kind == "parallel":
            return 0
        T = grasps.T_object_tcp
        grade = seal_grades(self._surface, T[:, :3, 3], T[:, :3, 2], self._effector.cup_radius)[1]
        return int(np.minimum(grade, NO_SEAL - 1).max())

    def settle(self, T_object_tcp: FloatArray, grade: int = 0) -> tuple[GraspSet, IntArray]:
        """Return the grasps that tool poses (B, 4, 4) settle in, and which pose each came from (K,).

        Seals of suction grasps are accepted up to `grade`, as in `regrasp_opt.grasps.suction`.
        """
        T = np.array(T_object_tcp, dtype=np.float64).reshape(-1, 4, 4)
        settled, width, source = self._gripped(T) if self._effector.kind == "parallel" else self._sealed(T, grade)
        order = np.argsort(source)
        grasps, source = GraspSet(settled[order], width[order], self._effector.kind), source[order]
        failures = failures_on(self._surface, grasps, self._effector)
        holds = [index for index, failure in enumerate(failures) if failure is None]
        return grasps.subset(holds), source[holds]

    def failures(self, T_object_tcp: FloatArray, grade: int = 0) -> list[Failure]:
        """Return for tool poses (B, 4, 4) that do not settle what is wrong with them: the first cause that is not."""
        T = np.array(T_object_tcp, dtype=np.float64).reshape(-1, 4, 4)
        if self._effector.kind == "suction":
            passed = [(Failure.NO_CONTACT, self._touched(T)[0]), (Failure.LEAKS, self._sealed(T, grade, free=False)[2])]
        else:
            widest = self._effector.max_opening - 2 * self._effector.pre_opening
            depths = contact_depths(self._effector)
            between = [
                np.concatenate([_between_contacts(self._surface, T, depth, width)[2] for depth in depths])
                for width in (np.inf, widest)
            ]
            crossed = [
                k
                for depth in depths
                for k, (distance, _) in enumerate(_crossings(self._surface, T, depth))
                if (np.abs(distance) <= widest / 2).any()
            ]
            opposed, fit = between
            held = np.union1d(crossed, opposed)
            passed = [(Failure.NOTHING_HELD, held), (Failure.SLIPS, opposed), (Failure.TOO_WIDE, fit)]
        return [next((why for why, fine in passed if k not in fine), Failure.OVERLAP) for k in range(len(T))]

    def _gripped(self, T: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return the nearest parallel grasps, their widths and sources; the first depth and widening that fit count."""
        widest = self._effector.max_opening - 2 * self._effector.pre_opening
        poses, widths, sources = [T[:0]], [np.zeros(0)], [np.zeros(0, dtype=np.int64)]
        left = np.arange(len(T))
        for depth in contact_depths(self._effector):
            centered, contact, index = _between_contacts(self._surface, T[left], depth, widest)
            width = self._clearance.fitting(centered, contact, widest)
            fits = np.isfinite(width)
            poses.append(centered[fits])
            widths.append(width[fits])
            sources.append(left[index[fits]])
            left = np.setdiff1d(left, sources[-1])
        return np.concatenate(poses), np.concatenate(widths), np.concatenate(sources)

    def _touched(self, T: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return which cups find surface near ahead or behind (K,), where (K, 3), and the direction into it (K, 3)."""
        hits = cast_rays(self._surface, T[:, :3, 3], T[:, :3, 2])
        facing = np.einsum("hi,hi->h", self._surface.normals[hits.face], T[hits.ray, :3, 2]) < 0
        near = np.flatnonzero(facing & (np.abs(hits.distance) <= SHIFT))
        near = near[np.lexsort((np.abs(hits.distance[near]), hits.ray[near]))]
        source, first = np.unique(hits.ray[near], return_index=True)
        near = near[first]
        center = T[source, :3, 3] + hits.distance[near, None] * T[source, :3, 2]
        return source, center, -self._surface.normals[hits.face[near]]

    def _sealed(self, T: FloatArray, grade: int, free: bool = True) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return the nearest suction grasps, their widths (0) and sources; if asked, only where the body is `free`."""
        source, center, inward = self._touched(T)
        approach, grades = seal_grades(self._surface, center, inward, self._effector.cup_radius)
        settled = np.array([_turned(T[k], 2, z) for k, z in zip(source, approach, strict=True)]).reshape(-1, 4, 4)
        settled[:, :3, 3] = center
        good = grades <= grade
        if free:
            good[good] = self._clearance.body_free(settled[good])
        return settled[good], np.zeros(int(good.sum())), source[good]


def _between_contacts(
    surface: TriangleSurface, T: FloatArray, depth: float, widest: float
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return tool poses centred between contacts inside their friction cones (K, 4, 4), contact distances, sources.

    Where the closing line of a pose (B, 4, 4) meets no such contacts, the tool is turned until the line is normal to
    what it meets, on average, and tried once more.
    """
    cosine = 1.0 / np.hypot(1.0, FRICTION)
    found: list[tuple[FloatArray, float, int]] = []
    tried = list(enumerate(T))
    for worth in (LOOSE, np.inf):
        poses, turned = np.array([pose for _, pose in tried]).reshape(-1, 4, 4), []
        for (k, pose), (distance, normals) in zip(tried, _crossings(surface, poses, depth), strict=True):
            facing = normals @ pose[:3, 1]
            pair = _central_pair(distance, facing, cosine, widest)
            if pair is not None:
                found.append((_centered(pose, distance, pair), float(distance[pair[1]] - distance[pair[0]]), k))
                continue
            pair = _central_pair(distance, facing, worth, np.inf)
            if pair is not None:  # turned about the middle of its contacts
                before, direction = _centered(pose, distance, pair), normals[pair[1]] - normals[pair[0]]
                after = _turned(before, 1, direction / np.linalg.norm(direction))
                after[:3, 3] = before[:3, 3] + depth * (before[:3, 2] - after[:3, 2])
                turned.append((k, after))
        tried = turned
    poses = np.array([pose for pose, _, _ in found]).reshape(-1, 4, 4)
    contact = np.array([width for _, width, _ in found], dtype=np.float64)
    return poses, contact, np.array([k for _, _, k in found], dtype=np.int64)


def _crossings(surface: TriangleSurface, T: FloatArray, depth: float) -> list[tuple[FloatArray, FloatArray]]:
    """Return where each closing line crosses the surface: distances from its middle (H,) [m], normals (H, 3)."""
    hits = cast_rays(surface, T[:, :3, 3] + depth * T[:, :3, 2], T[:, :3, 1])
    order = np.lexsort((hits.distance, hits.ray))
    edges = np.searchsorted(hits.ray[order], np.arange(1, len(T)))
    parts = np.split(order, edges) if len(T) else []
    return [(hits.distance[part], surface.normals[hits.face[part]]) for part in parts]


def _central_pair(distance: FloatArray, facing: FloatArray, cosine: float, widest: float) -> tuple[int, int] | None:
    """Return the crossings (entry, exit) with normals within `cosine` of the line whose middle is nearest, or None."""
    entries, exits = np.flatnonzero(-facing >= cosine), np.flatnonzero(facing >= cosine)
    pairs = [(int(i), int(j)) for i in entries for j in exits if MIN_WIDTH <= distance[j] - distance[i] <= widest]
    pairs = [(i, j) for i, j in pairs if abs(distance[i] + distance[j]) / 2 <= SHIFT]
    return min(pairs, key=lambda pair: abs(distance[pair[0]] + distance[pair[1]]), default=None)


def _centered(T: FloatArray, distance: FloatArray, pair: tuple[int, int]) -> FloatArray:
    """Return `T` moved along its closing line to the middle of a pair of crossings."""
    moved = T.copy()
    moved[:3, 3] += (distance[pair[0]] + distance[pair[1]]) / 2 * T[:3, 1]
    return moved


def _turned(T: FloatArray, axis: int, direction: FloatArray) -> FloatArray:
    """Return `T` with its `axis` along the unit `direction`, turned no more than that takes."""
    before = T[:3, axis]
    cross = np.cross(before, direction)
    cosine = float(before @ direction)
    if cosine < -0.999:
        return T.copy()
    K = np.array([[0, -cross[2], cross[1]], [cross[2], 0, -cross[0]], [-cross[1], cross[0], 0]])
    turned = T.copy()
    turned[:3, :3] = (np.eye(3) + K + K @ K / (1 + cosine)) @ T[:3, :3]
    return turned
