"""Grasps that somebody gives: tested on the object, and put on it first where their widths are not known.

Grasps from other tools are where a hand of another shape held a mesh that was perhaps another one. So each is moved to
its contacts on this object, if they are near, and what cannot be used is left out: with a count and the names for each
reason and, if that is most of the set, with what else the file could mean.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, invert, pose_distance
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.grasps import GraspSet, rejected_grasps
from regrasp_opt.grasps.hand_frames import AXES, FRAMES, HandFrame, hand_frame
from regrasp_opt.grasps.projection import GraspProjector
from regrasp_opt.grasps.suction import NO_SEAL
from regrasp_opt.objects import ObjectModel

NAMED = 3
"""Grasps that are named for each reason in the warning about those left out."""

TRIED = 40
"""Grasps with which other frames are tried."""

CLEARLY = 0.5
"""Share of the grasps below which other frames are tried, and above which one is named."""

logger = logging.getLogger(__name__)


class Near(NamedTuple):
    """How far a grasp may be moved and turned to hold the object.

    Parameters
    ----------
    distance : float
        Of the TCP [m].
    angle : float
        Of the tool [rad].
    """

    distance: float = 0.005
    angle: float = np.deg2rad(5.0)


NEAR = Near()
"""The default: 5 mm and 5 degrees."""


def usable_grasps(
    grasps: GraspSet, body: ObjectModel, effector: EndEffector, near: Near = NEAR
) -> tuple[GraspSet, dict[int, str]]:
    """Return those of the given grasps that hold the object, with widths, and why the others are left out.

    Parameters
    ----------
    grasps : GraspSet
        Those with widths are taken as they are, those without are put on the object.
    body : ObjectModel
    effector : EndEffector
    near : Near
        How far grasps without widths may be moved.

    Returns
    -------
    grasps : GraspSet
        In the same order.
    left_out : dict
        Numbers of the others in the given set, and the reasons.

    Raises
    ------
    GraspError
        If `grasps` is not a set of the end-effector's kind, is empty, or none can be used.
    OptionError
        If `near` is not a distance and an angle.
    """
    if not isinstance(grasps, GraspSet):
        raise GraspError(f"grasps is a {type(grasps).__name__}; give a GraspSet of poses, widths and kind")
    if len(grasps) == 0:
        raise GraspError("the grasp set is empty; sample or load at least one grasp")
    if grasps.kind != effector.kind:
        raise GraspError(f"the grasps are for a {grasps.kind} end-effector, which '{effector.name}' is not")
    if not (np.isfinite(near).all() and min(near) >= 0):
        raise OptionError(f"near is {tuple(near)}; give a distance in metres and an angle in radians, 0 or more")
    used, left_out = _settled(grasps, body, effector, near)
    if not left_out:
        return used, {}
    reasons: dict[str, list[int]] = {}
    for index, why in left_out.items():
        reasons.setdefault(why, []).append(index)
    by_count = sorted(reasons.items(), key=lambda item: -len(item[1]))
    hint = _hint(grasps, body, effector, near) if len(left_out) > (1 - CLEARLY) * len(grasps) else None
    if len(used) == 0:
        counts = ", ".join(f"{len(which)} because {why}" for why, which in by_count)
        if hint is not None:
            raise GraspError(f"none of the {len(grasps)} grasps can be used on '{body.name}': {counts}; {hint}")
        raise GraspError(
            f"none of the {len(grasps)} grasps can be used on '{body.name}' with '{effector.name}': {counts}; sample "
            "grasps for both together, or check units and frames (T_object_tcp: z approach, y closing direction)"
        )
    clauses = [f"{len(which)} because {why} ({_names(grasps, which)})" for why, which in by_count]
    text = "%d of %d grasps are left out, and the others renumbered from 0: %s (problem.left_out has all)%s"
    logger.warning(text, len(left_out), len(grasps), "; ".join(clauses), "" if hint is None else f"; {hint}")
    return used, left_out


def _names(grasps: GraspSet, which: list[int]) -> str:
    more = f" and {len(which) - NAMED} more" if len(which) > NAMED else ""
    return ", ".join(grasps.name(index) for index in which[:NAMED]) + more


def _settled(grasps: GraspSet, body: ObjectModel, effector: EndEffector, near: Near) -> tuple[GraspSet, dict[int, str]]:
    """Return the grasps that can be used, on the object, and why the others cannot be."""
    numbers, left_out = np.arange(len(grasps)), dict[int, str]()
    if not grasps.settled:
        projector = GraspProjector(body, effector)
        found, source, close = _projected(grasps.T_object_tcp, projector, near)
        lost = np.setdiff1d(numbers, source)
        failures = projector.failures(grasps.T_object_tcp[lost], NO_SEAL - 1)
        far = (
            f"it would have to be moved more than {1e3 * near.distance:g} mm or turned more than "
            f"{np.degrees(near.angle):.3g} degrees to hold the object"
        )
        left_out = {index: why.value for index, why in zip(lost.tolist(), failures, strict=True)}
        left_out |= dict.fromkeys(source[~close].tolist(), far)
        numbers, found = source[close], found.subset(close)
        grasps = replace(grasps.subset(numbers), T_object_tcp=found.T_object_tcp, width=found.width)
    rejected = rejected_grasps(grasps, body, effector)
    left_out |= {int(numbers[index]): failure.value for index, failure in rejected.items()}
    if rejected:
        grasps = grasps.subset([index for index in range(len(grasps)) if index not in rejected])
    return grasps, dict(sorted(left_out.items()))


def _projected(T_object_tcp: FloatArray, projector: GraspProjector, near: Near) -> tuple[GraspSet, IntArray, BoolArray]:
    """Return the grasps in which poses (B, 4, 4) settle, which pose each is from (K,), and which are near it (K,)."""
    found, source = projector.settle(T_object_tcp, NO_SEAL - 1)
    moved, turned = pose_distance(T_object_tcp[source], found.T_object_tcp)
    return found, source, (moved <= near.distance + 1e-9) & (turned <= near.angle + 1e-6)


def _hint(grasps: GraspSet, body: ObjectModel, effector: EndEffector, near: Near) -> str | None:
    """Return what the file of grasps of which most cannot be used could mean instead; None if they have no file."""
    source = grasps.source
    if source is None:
        return None
    read_as = f"'{source.path}' was read with scale {source.scale:g} and the hand frame '{source.frame}'"
    middle, size = body.vertices.mean(axis=0), float(np.ptp(body.vertices, axis=0).max())
    T = grasps.T_object_tcp[:: max(1, len(grasps) // TRIED)]
    away = np.median(np.linalg.norm(T[:, :3, 3] - middle, axis=1))
    if away > 3 * size + 1.0:
        scale = f"give scale (--grasp-scale) {1e-3 * source.scale:g}"
        return (
            f"{read_as}, and half its grasps are {away:.3g} m or more from the object; {scale} if it is in millimetres"
        )
    best = _better_frame(T, hand_frame(source.frame), body, effector, near)
    if best is not None:
        return f"{read_as}; {best[1]} of {len(T)} that were tried hold with the frame '{best[0]}' (--grasp-frame)"
    if source.mesh_scale is not None and not np.isclose(source.mesh_scale, body.scale, rtol=1e-3):
        return (
            f"'{source.path}' is for the mesh '{source.mesh}' at scale {source.mesh_scale:g}, and '{body.name}' is "
            f"loaded at scale {body.scale:g}; give --scale {source.mesh_scale:g} if it is that mesh"
        )
    return f"{read_as}; check the object, its scale and origin, or give another frame (--grasp-frame)"


def _better_frame(
    T_object_tcp: FloatArray, mine: HandFrame, body: ObjectModel, effector: EndEffector, near: Near
) -> tuple[str, int] | None:
    """Return the frame with which most of some grasps hold the object, and how many; None where that is not half."""
    T = T_object_tcp @ invert(mine.T_hand_tcp)
    others = {name: frame for name, frame in FRAMES.items() if frame.kind == mine.kind}
    for approach, closing in permutations(AXES, 2):
        if AXES[approach] @ AXES[closing] == 0 and not closing.startswith("-"):
            frame = HandFrame(approach, closing, mine.tcp, mine.kind)
            others[str(frame)] = frame
    best, most, projector = None, 0, GraspProjector(body, effector)
    for name, frame in others.items():
        count = 0 if frame == mine else int(_projected(T @ frame.T_hand_tcp, projector, near)[2].sum())
        if count > most:
            best, most = name, count
    return None if best is None or most < CLEARLY * len(T) else (best, most)
