"""Antipodal grasps: two contacts facing each other inside their friction cones, seen along many approaches.

Contacts come from rays cast into the object (a standard construction, for example Chen and Burdick, "Finding
antipodal point grasps on irregularly shaped objects", 1993). Every exit of a ray counts, not only the first,
so that a mug is held by its wall as well as across its whole body.
"""

from __future__ import annotations

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.grasps.candidates import GraspCandidates, frames_about
from regrasp_opt.grasps.clearance import WIDENINGS, GripperClearance
from regrasp_opt.grasps.surface import TriangleSurface, cast_rays, sample_points, tangents
from regrasp_opt.grasps.table import TableRoom

FRICTION = 0.5
"""Coefficient of friction at both contacts."""

MIN_WIDTH = 0.001
"""Thinnest part that is grasped [m]."""

APPROACHES = 12
"""Approach directions about each contact line."""

DEPTHS = (0.0, 0.01, -0.01)
"""How far beyond the TCP, towards the fingertips, the pads hold the object [m]."""

RIM = 0.004
"""Least distance of a contact to the ends of the pad along the approach [m]."""

TIPS = (0.002, 0.0005)
"""Distances of a contact to the tip of the pad [m] where the table leaves no room for more."""


def antipodal_candidates(
    surface: TriangleSurface,
    end_effector: EndEffector,
    clearance: GripperClearance,
    room: TableRoom | None,
    points: int,
    rng: np.random.Generator,
) -> GraspCandidates:
    """Return grasps from `points` surface points, two rays each and `APPROACHES` directions; the grade is 0 for all.

    Those that a screen finds to overlap the object are left out. Given the `room` above a table, so are those without
    room in any placement, and every other contact line is approached from right above in one of them.
    """
    middle, closing, contact = contact_pairs(surface, end_effector, points, rng, None if room is None else room.up)
    first = rng.normal(size=middle.shape)
    if room is not None:
        first[::2] = -room.up[rng.integers(len(room.up), size=len(first[::2]))]
    frames = frames_about(middle, closing, APPROACHES, first, closing=True)
    contact = np.repeat(contact, APPROACHES)
    widest = np.minimum(contact + WIDENINGS[-1], end_effector.max_opening - 2 * end_effector.pre_opening)
    depth, kept = _depths(frames, widest, end_effector, room, rng)
    frames[:, :3, 3] -= depth[:, None] * frames[:, :3, 2]
    kept[kept] = clearance.may_be_free(frames[kept], widest[kept])
    return GraspCandidates(frames, contact, np.zeros(len(frames), dtype=np.int64)).where(kept)


def _depths(
    frames: FloatArray, width: FloatArray, end_effector: EndEffector, room: TableRoom | None, rng: np.random.Generator
) -> tuple[FloatArray, BoolArray]:
    """Return the depths (N,) [m] for `frames` (N, 4, 4) at contact lines, and whether there is room anywhere (N,).

    The depth is one of those with room in the most placements, at random; near the tip only where no other has any.
    """
    depths = np.array(contact_depths(end_effector))
    rooms = np.ones((len(frames), len(depths)))
    if room is not None:
        back = -np.einsum("nj,sj->ns", frames[:, :3, 2], room.up)
        heights = room.heights(frames, width)[:, None] + depths[:, None] * back[:, None]
        rooms = (heights >= 0).sum(axis=2).astype(np.float64)
    rooms[:, -len(TIPS) :] = rooms[:, -len(TIPS) :].clip(max=0.1)
    best = np.argmax(rooms + 0.5 * rng.random(rooms.shape) * (rooms >= 1), axis=1)
    return depths[best], rooms.max(axis=1) > 0


def contact_pairs(
    surface: TriangleSurface,
    end_effector: EndEffector,
    points: int,
    rng: np.random.Generator,
    up: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return midpoints (C, 3) [m], closing directions (C, 3) and distances (C,) [m] of antipodal contacts.

    One ray from each point is straight, the other one tilted at random; given verticals `up` (S, 3) in the object
    frame, every other one of these is tilted until it is level under a random one of them.
    """
    start, face = sample_points(surface, points, rng)
    inward = -surface.normals[face]
    u, v = tangents(inward)
    slope, turn = FRICTION * np.sqrt(rng.random((points, 1))), 2 * np.pi * rng.random((points, 1))
    tilted = inward + slope * (np.cos(turn) * u + np.sin(turn) * v)
    if up is not None:
        vertical = up[rng.integers(len(up), size=len(tilted[::2]))]
        tilted[::2] = inward[::2] - np.einsum("ni,ni->n", inward[::2], vertical)[:, None] * vertical
    tilted /= np.maximum(np.linalg.norm(tilted, axis=1, keepdims=True), 1e-12)
    origins, directions = np.concatenate([start, start]), np.concatenate([inward, tilted])
    widest = end_effector.max_opening - 2 * end_effector.pre_opening
    hits = cast_rays(surface, origins, directions, (MIN_WIDTH, widest))
    leaving = np.einsum("ij,ij->i", surface.normals[hits.face], directions[hits.ray])
    entering = np.einsum("ij,ij->i", np.concatenate([inward, inward]), directions)[hits.ray]
    good = np.minimum(leaving, entering) >= 1.0 / np.hypot(1.0, FRICTION) - 1e-9
    ray, width = hits.ray[good], hits.distance[good]
    return origins[ray] + 0.5 * width[:, None] * directions[ray], directions[ray], width


def contact_depths(end_effector: EndEffector) -> list[float]:
    """Return the contact depths beyond the TCP [m] that lie on the pad; the last ones are near its tip."""
    start, end = (edge - end_effector.tcp_offset for edge in end_effector.pad.z)
    rim = min(RIM, (end - start) / 2)
    depths = [*np.clip(DEPTHS, start + rim, end - rim), end - rim, *(end - np.minimum(TIPS, rim))]
    return list(dict.fromkeys(np.round(depths, 9).tolist()))
