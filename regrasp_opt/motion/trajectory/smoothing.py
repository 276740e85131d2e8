"""Motions without stops between the rests that picking and placing require.

A motion that was found goes from rest to rest in every phase. Here all that lies between two rests of the jaw, and
between those and home, becomes one run: it follows the tool's straight line away from a grasp for at least half of it,
crosses freely, and follows the line towards the next grasp in the same way. `fastest_run` finds it; every part is
verified like any other motion, and where no attempt holds or saves time, the motion stays as it was.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.motion_data import Phase, Segment
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.motion.trajectory.pick_place import Leg
from regrasp_opt.motion.trajectory.smoothing_program import LINE_STEPS, STEPS, Crossing, Line, fastest_run
from regrasp_opt.motion.trajectory.time_parameterization import LINE_GRID, smoothed
from regrasp_opt.motion.trajectory.trajectory import Trajectory

ATTEMPTS = ((0.5, np.inf), (0.5, 0.3), (1.0, 0.3))
"""Share of the lines that stays, and how far the crossing may be from the verified path [rad, m], in that order."""

SHORTEST = 0.031
"""What stays of a line at least, if it is as long [m]; 1 mm of it is room for smoothing."""

DENSE = 20
"""Points of each segment by which a verified path is resampled."""

_LEAVING = (Phase.LIFT, Phase.RETREAT)
_ARRIVING = (Phase.LOWER, Phase.APPROACH)


def shortened(connector: Connector, legs: Sequence[Leg]) -> list[Segment]:
    """Return the segments of `legs` with every run that can be verified in place of those that it replaces."""
    result: list[Segment] = []
    for rests, group in itertools.groupby(legs, lambda leg: leg.segment.phase in (Phase.GRASP, Phase.RELEASE)):
        run = list(group)
        result += [leg.segment for leg in run] if rests else _run(connector, run)
    return result


def _run(connector: Connector, legs: list[Leg]) -> list[Segment]:
    """Return the run of `legs` without stops, or as it is."""
    run = [leg.segment for leg in legs]
    leaves, arrives = run[0].phase in _LEAVING, run[-1].phase in _ARRIVING
    if len(run) != 1 + leaves + arrives:
        return run
    duration = sum(segment.trajectory.duration for segment in run)
    for share, radius in ATTEMPTS:
        parts = _attempt(connector, run, share, radius)
        if parts is None or sum(part.duration for part in parts) >= duration:
            continue
        if all(connector.accepted(leg.context, part) for leg, part in zip(legs, parts, strict=True)):
            return [replace(segment, trajectory=part) for segment, part in zip(run, parts, strict=True)]
    return run


def _attempt(connector: Connector, run: list[Segment], share: float, radius: float) -> list[Trajectory] | None:
    paths = [segment.trajectory for segment in run]
    before = after = None
    rests = list[FloatArray]()  # what is left of the lines
    if run[0].phase in _LEAVING:
        before, rest = _cut(connector, paths.pop(0), share)
        rests.append(rest)
    middle = paths[0].at(np.linspace(0.0, paths[0].duration, DENSE))
    middle[[0, -1]] = paths[0].positions[[0, -1]]  # exactly
    if run[-1].phase in _ARRIVING:
        line, rest = _cut(connector, paths[-1].reversed(), share)
        after = Line(line.positions[::-1], -line.first[::-1], line.second[::-1])
        path = np.vstack([*rests, middle, rest[::-1]])
    else:
        path = np.vstack([*rests, middle])
    robot = connector.robot
    guess = _resampled(path)
    crossing = Crossing(guess, np.maximum(guess - radius, robot.lower), np.minimum(guess + radius, robot.upper))
    parts = fastest_run(before, crossing, after, connector.limits.velocity, connector.limits.acceleration)
    return None if parts is None else smoothed(parts, connector.limits)


def _cut(connector: Connector, line: Trajectory, share: float) -> tuple[Line, FloatArray]:
    """Return what stays of a line that begins at rest, and points (P, dof) on the rest of it."""
    q = line.at(np.linspace(0.0, line.duration, LINE_GRID + 1))
    tips = np.array([connector.robot.forward(each)[:3, 3] for each in q])
    lengths = np.linalg.norm(tips - tips[0], axis=1)
    length = float(lengths[-1])
    path = CubicSpline(lengths / length, q)
    kept = min(1.0, max(share, SHORTEST / length))
    s = kept * np.linspace(0.0, 1.0, LINE_STEPS + 1)
    return Line(path(s), kept * path(s, 1), kept**2 * path(s, 2)), path(np.linspace(kept, 1.0, DENSE))


def _resampled(path: FloatArray) -> FloatArray:
    """Return `STEPS` + 1 points that are evenly spaced along a polyline (P, dof)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    keep = np.append(np.diff(lengths) > 0, True)
    wanted = np.linspace(0.0, lengths[-1], STEPS + 1)
    points = np.column_stack([np.interp(wanted, lengths[keep], column) for column in path[keep].T])
    points[0], points[-1] = path[0], path[-1]
    return points
