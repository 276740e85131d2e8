"""Antipodal grasps: two contacts facing each other inside their friction cones, seen along many approaches.

Contacts come from rays cast into the object (a standard construction, for example Chen and Burdick, "Finding
antipodal point grasps on irregularly shaped objects", 1993). Every exit of a ray counts, not only the first,
so that a mug is held by its wall as well as across its whole body.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.grasps.candidates import GraspCandidates, frames_about
from regrasp_opt.grasps.clearance import GripperClearance
from regrasp_opt.grasps.surface import TriangleSurface, cast_rays, sample_points, tangents

FRICTION = 0.5
"""Coefficient of friction at both contacts."""

MIN_WIDTH = 0.001
"""Thinnest part that is grasped [m]."""

APPROACHES = 12
"""Approach directions about each contact line."""

DEPTHS = (0.0, 0.01, -0.01)
"""How far beyond the TCP, towards the fingertips, the pads hold the object [m]; the first free one counts."""

WIDENINGS = (0.0, 0.0015, 0.003)
"""How much wider than the contact line a flat pad may close on a hollow or bumpy side [m]; likewise."""

PAD_RIM = 0.004
"""Least distance of a contact to the ends of the pad along the approach [m]."""


def antipodal_candidates(
    surface: TriangleSurface,
    end_effector: EndEffector,
    clearance: GripperClearance,
    points: int,
    rng: np.random.Generator,
) -> GraspCandidates:
    """Return collision-free grasps from `points` surface points, two rays each and `APPROACHES` directions.

    The grade is 0 for all.
    """
    middle, closing, contact = contact_pairs(surface, end_effector, points, rng)
    frames = frames_about(middle, closing, APPROACHES, rng, closing=True)
    contact = np.repeat(contact, APPROACHES)
    widest = end_effector.max_opening - 2 * end_effector.pre_opening
    poses, widths = [frames[:0]], [contact[:0]]
    for depth in contact_depths(end_effector):
        tcp = frames.copy()
        tcp[:, :3, 3] -= depth * frames[:, :3, 2]
        rejected = np.ones(len(frames), dtype=bool)
        left = np.flatnonzero(clearance.body_free(tcp, screen=True))
        for widening in WIDENINGS:
            left = left[contact[left] + widening <= widest]
            free = clearance.fingers_free(tcp[left], contact[left] + widening)
            fit, left = left[free], left[~free]
            fit = fit[clearance.body_free(tcp[fit])]
            poses.append(tcp[fit])
            widths.append(contact[fit] + widening)
            rejected[fit] = False
        frames, contact = frames[rejected], contact[rejected]
    T, width = np.concatenate(poses), np.concatenate(widths)
    return GraspCandidates(T, width, np.zeros(len(T), dtype=np.int64))


def contact_pairs(
    surface: TriangleSurface, end_effector: EndEffector, points: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return midpoints (C, 3) [m], closing directions (C, 3) and distances (C,) [m] of antipodal contacts."""
    start, face = sample_points(surface, points, rng)
    inward = -surface.normals[face]
    u, v = tangents(inward)
    slope, turn = FRICTION * np.sqrt(rng.random((points, 1))), 2 * np.pi * rng.random((points, 1))
    tilted = inward + slope * (np.cos(turn) * u + np.sin(turn) * v)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    origins, directions = np.concatenate([start, start]), np.concatenate([inward, tilted])
    widest = end_effector.max_opening - 2 * end_effector.pre_opening
    hits = cast_rays(surface, origins, directions, (MIN_WIDTH, widest))
    facing = np.einsum("ij,ij->i", surface.normals[hits.face], directions[hits.ray])
    good = facing >= 1.0 / np.hypot(1.0, FRICTION)
    ray, width = hits.ray[good], hits.distance[good]
    return origins[ray] + 0.5 * width[:, None] * directions[ray], directions[ray], width


def contact_depths(end_effector: EndEffector) -> list[float]:
    """Return the contact depths beyond the TCP [m] that lie on the pad, in the order they are tried."""
    start, end = (edge - end_effector.tcp_offset for edge in end_effector.pad.z)
    rim = min(PAD_RIM, (end - start) / 2)
    return list(dict.fromkeys(float(np.clip(depth, start + rim, end - rim)) for depth in DEPTHS))
