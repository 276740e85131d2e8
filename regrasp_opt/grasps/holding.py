"""Whether grasps hold the object: two opposed contacts on the pads, or a seal under the cup.

A jaw holds where a line along its closing direction, on the pads, leaves the object on both sides near the stated
opening, with surface normals inside the friction cones. The lines are those of the sampler first, then a grid over the
pads. A cup holds where its centre is on the surface and its mouth seals with the approach that it has.
"""

from __future__ import annotations

from enum import Enum

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.grasps.antipodal import FRICTION, contact_depths
from regrasp_opt.grasps.clearance import CONTACT_TOLERANCE, WIDENINGS, gripper_free
from regrasp_opt.grasps.grasp_set import GraspSet
from regrasp_opt.grasps.suction import NO_SEAL, mouth_grades
from regrasp_opt.grasps.surface import TriangleSurface, cast_rays, make_surface
from regrasp_opt.objects import ObjectModel

ROUNDING = 1e-4
"""Tolerance for grasps that were written in single precision, or to a tenth of a millimetre [m, rad]."""

GAP = max(WIDENINGS) / 2 + ROUNDING
"""Farthest that the object may be inside a pad at the stated opening [m]: as far as a flat pad that the sampler closes
on a bumpy side. A jaw that closes farther moves the object on its way."""

SPACING, FINE = 0.003, 0.001
"""Distance between the closing lines that are tried all over a pad, and along its two middle lines [m]."""

MOST_LINES = 40
"""Most lines of a grid along each side of a pad; on larger pads they lie farther apart."""

TILT = np.deg2rad(10.0)
"""Largest angle between the approach of a cup and the mean normal under it [rad]; the sampler's stay within 7 degrees.
"""


class Failure(Enum):
    """Why a grasp does not hold the object; the value is the clause to show."""

    TOO_WIDE = "it needs a wider opening than the jaw has"
    OVERLAP = "the gripper overlaps the object"
    NOTHING_HELD = "no part of the object is between the pads"
    NOT_REACHED = "the pads do not touch the object on both sides at the stated width"
    SLIPS = "the surfaces at the pads do not oppose each other within the friction cone"
    NO_CONTACT = "the cup does not touch the object"
    LEAKS = "the cup does not seal"
    TILTED = "the cup is tilted relative to the surface"


def hold_failures(grasps: GraspSet, model: ObjectModel, end_effector: EndEffector) -> list[Failure | None]:
    """Return for each grasp (G,) why it does not hold the object, or None where it does.

    Whether the gripper overlaps the object is not tested here; see `regrasp_opt.grasps.gripper_free`.

    Parameters
    ----------
    grasps : GraspSet
        Of the end-effector's kind.
    model : ObjectModel
    end_effector : EndEffector
        Its pads, or the radius of its cup.

    Raises
    ------
    GraspError
        If the widths of the grasps are not known yet.
    """
    grasps.need_widths()
    return failures_on(make_surface(model.mesh), grasps, end_effector)


def failures_on(surface: TriangleSurface, grasps: GraspSet, end_effector: EndEffector) -> list[Failure | None]:
    """Return what `hold_failures` does, for the surface of an object."""
    if end_effector.kind == "suction":
        return _cup_failures(surface, grasps.T_object_tcp, end_effector.cup_radius)
    return _jaw_failures(surface, grasps, end_effector)


def rejected_grasps(grasps: GraspSet, model: ObjectModel, end_effector: EndEffector) -> dict[int, Failure]:
    """Return the numbers of the grasps that cannot be used, and why: those that do not hold, or overlap the object.

    Parameters
    ----------
    grasps : GraspSet
    model : ObjectModel
        The object that they hold.
    end_effector : EndEffector
        What holds it.
    """
    failures = hold_failures(grasps, model, end_effector)
    for index in np.flatnonzero(~gripper_free(grasps, model, end_effector)).tolist():
        if failures[index] is not Failure.TOO_WIDE:
            failures[index] = Failure.OVERLAP
    return {index: failure for index, failure in enumerate(failures) if failure is not None}


def _jaw_failures(surface: TriangleSurface, grasps: GraspSet, effector: EndEffector) -> list[Failure | None]:
    found: list[Failure | None] = [None] * len(grasps)
    left = np.arange(len(grasps))
    for lines in (np.array([(0.0, depth) for depth in contact_depths(effector)]), _pad_lines(effector)):
        part = grasps.subset(left)
        held, touched, crossed = _contacts(surface, part, lines, effector.max_opening)
        for k, index in enumerate(left.tolist()):
            missed = Failure.NOT_REACHED if crossed[k] else Failure.NOTHING_HELD
            found[index] = None if held[k] else Failure.SLIPS if touched[k] else missed
        left = left[~held]
    too_wide = grasps.width + 2 * effector.pre_opening > effector.max_opening + 1e-6
    return [Failure.TOO_WIDE if wide else failure for wide, failure in zip(too_wide, found, strict=True)]


def _pad_lines(effector: EndEffector) -> FloatArray:
    """Return where closing lines meet a pad (L, 2): x and z in the frame of the TCP [m]."""

    def spread(ends: tuple[float, float], spacing: float, most: float) -> FloatArray:
        count = int(min(np.ceil((ends[1] - ends[0]) / spacing), most))
        return ends[0] + (np.arange(count) + 0.5) * (ends[1] - ends[0]) / count

    x, (low, high) = effector.pad.x, effector.pad.z
    z = low - effector.tcp_offset, high - effector.tcp_offset
    grids = (
        (spread(x, SPACING, MOST_LINES), spread(z, SPACING, MOST_LINES)),
        (np.zeros(1), spread(z, FINE, np.inf)),
        (spread(x, FINE, np.inf), np.clip([0.0], *z)),
    )
    return np.concatenate([np.stack(np.meshgrid(*grid), axis=-1).reshape(-1, 2) for grid in grids])


def _contacts(
    surface: TriangleSurface, grasps: GraspSet, lines: FloatArray, opening: float
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Return in which grasps (G,) a line of `lines` (L, 2) holds, touches both pads, crosses the object in the jaw."""
    T, count = grasps.T_object_tcp, len(lines)
    origins = T[:, None, :3, 3] + lines @ np.swapaxes(T[:, :3, [0, 2]], 1, 2)
    hits = cast_rays(surface, origins.reshape(-1, 3), np.repeat(T[:, :3, 1], count, axis=0))
    grasp = hits.ray // count
    facing = np.einsum("hi,hi->h", surface.normals[hits.face], T[grasp, :3, 1])
    half = grasps.width[grasp] / 2
    cosine = np.cos(np.arctan(FRICTION) + ROUNDING)
    touches, opposes = np.zeros((2, 2, len(T) * count), dtype=bool)
    for side, sign in enumerate((-1.0, 1.0)):
        inside = half - sign * hits.distance
        at_pad = (inside >= -CONTACT_TOLERANCE) & (inside <= np.minimum(GAP, half))
        touches[side, hits.ray[at_pad]] = True
        opposes[side, hits.ray[at_pad & (sign * facing >= cosine)]] = True
    crossed = np.zeros(len(T), dtype=bool)
    crossed[grasp[np.abs(hits.distance) <= opening / 2]] = True
    held, touched = (np.all(both, axis=0).reshape(-1, count).any(axis=1) for both in (opposes, touches))
    return held, touched, crossed


def _cup_failures(surface: TriangleSurface, T: FloatArray, radius: float) -> list[Failure | None]:
    spots = np.hstack([T[:, :3, 3], T[:, :3, 2]])
    first, spot = np.unique(np.round(spots, 9), axis=0, return_index=True, return_inverse=True)[1:]  # turned cups
    center, approach = spots[first, :3], spots[first, 3:]
    hits = cast_rays(surface, center, approach)
    entered = np.einsum("hi,hi->h", surface.normals[hits.face], approach[hits.ray]) < 0
    touching = np.zeros(len(first), dtype=bool)
    touching[hits.ray[entered & (np.abs(hits.distance) <= CONTACT_TOLERANCE)]] = True
    probe, grade = mouth_grades(surface, center, approach, radius)
    tilted = -np.einsum("ni,ni->n", probe.normal, approach) < np.cos(TILT)
    found: list[Failure | None] = []
    for k in spot.tolist():
        sealed = Failure.LEAKS if grade[k] == NO_SEAL else Failure.TILTED if tilted[k] else None
        found.append(sealed if touching[k] else Failure.NO_CONTACT)
    return found
