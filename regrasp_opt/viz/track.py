"""A motion as the page needs it: moments with configuration, opening of the jaw and pose of the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.motion import Segment
from regrasp_opt.planning import RegraspPlan

RATE = 25.0
"""Moments for each second of a motion."""


@dataclass(frozen=True, eq=False)
class Track:
    """Moments of a motion.

    Attributes
    ----------
    times : (M,) [s]
    labels : tuple of str
        The transition and what the arm is doing.
    transitions : tuple of int
    grasp_ids : tuple of int
        Numbers into ``problem.grasps`` of the grasp that each moment's transition uses.
    poses : tuple of int
        Number of the plan's pose that the object rests at, -1 while it is carried.
    q : (M, dof)
    jaw : (M,)
        Opening of the jaw [m].
    T_world_object : (M, 4, 4)
    """

    times: FloatArray
    labels: tuple[str, ...]
    transitions: tuple[int, ...]
    grasp_ids: tuple[int, ...]
    poses: tuple[int, ...]
    q: FloatArray
    jaw: FloatArray
    T_world_object: FloatArray


def track_of(plan: RegraspPlan, segments: Sequence[Segment], rate: float = RATE) -> Track:
    """Return evenly spaced moments of a motion of `plan`, `rate` or a little more for each second.

    `segments` are those of a `MotionPlan`. The object rests at its pose until a segment holds it, moves with the TCP
    while one does, and rests at its next pose after that.
    """
    cell, grasps = plan.problem.workcell, plan.problem.grasps
    total = sum(s.trajectory.duration for s in segments)
    moments = np.linspace(0.0, total, int(np.ceil(rate * total - 1e-9)) + 1)
    rows: list[tuple[Any, ...]] = []
    began, carried = 0.0, set[int]()
    for number, s in enumerate(segments):
        duration, last = s.trajectory.duration, number == len(segments) - 1
        times = moments[(moments >= began) & ((moments < began + duration) | last)]
        q = s.trajectory.at(times - began)
        jaw = np.interp(times - began, [0.0, duration], s.jaw)
        if s.phase.holds:
            carried.add(s.transition)
            tcp = cell.arm.T_world_tcp(q)
            T, pose = tcp @ invert(grasps.T_object_tcp[s.grasp_id]), -1
        else:
            pose = s.transition + (s.transition in carried)
            T = np.tile(plan.poses[pose], (len(times), 1, 1))
        label = f"move {s.transition}: {s.phase.name.lower()}"
        rows += [(t, label, s.transition, s.grasp_id, pose, *rest) for t, *rest in zip(times, q, jaw, T, strict=True)]
        began += duration
    seconds, labels, transitions, grasp_ids, poses, *arrays = zip(*rows, strict=True)
    return Track(np.array(seconds), labels, transitions, grasp_ids, poses, *(np.array(each) for each in arrays))
