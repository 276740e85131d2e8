"""The discrete part of the joint problem: which shared grasp, arm branch and whole turns each transition uses.

Every transition gives two layers of states, its free configurations at pick and at place, for each of its grasps. The
shortest path through the layers is the least joint travel, found by dynamic programming: from pick to place the grasp
stays, from place to the next pick it may change. Bounds on clearance and manipulability take states out beforehand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.motion.joint_measures import JointChoice, Measure, manipulability


class States(NamedTuple):
    """Free configurations `q` (S, dof) at one pose, each with its grasp (S,), clearance (S,) [m], manipulability (S,).

    Whole turns of a joint are states of their own.
    """

    grasp_ids: IntArray
    q: FloatArray
    clearance: FloatArray
    manipulability: FloatArray

    def where(self, mask: FloatArray) -> States:
        """Return the states of a mask (S,) or of indices."""
        return States(*(part[mask] for part in self))


def states_at(checker: FeasibilityChecker, T: FloatArray, grasp_ids: IntArray) -> States:
    """Return all free configurations of `grasp_ids` (K,) at object pose `T` (4, 4)."""
    robot = checker.workcell.robot
    ids, q, clearance = [], [], []
    for grasp_id, branches in zip(grasp_ids.tolist(), checker.configurations(T, grasp_ids), strict=True):
        for branch in branches:
            turned = robot.equivalents(branch)
            q.append(turned)
            ids += [grasp_id] * len(turned)
            clearance += [checker.clearance(T, grasp_id, branch)] * len(turned)
    stacked = np.concatenate(q) if q else np.zeros((0, robot.dof))
    skill = manipulability(robot, stacked) if len(stacked) else np.zeros(0)
    return States(np.array(ids, dtype=np.int64), stacked, np.array(clearance, dtype=np.float64), skill)


def best_choice(
    layers: Sequence[tuple[States, States]],
    minimise: Measure,
    floors: Mapping[Measure, float],
    home: FloatArray | None = None,
) -> JointChoice | None:
    """Return the best choice through the `layers` (pick, place) of all transitions, or None where there is none.

    Parameters
    ----------
    minimise : Measure
        ``travel`` is minimised; of ``clearance`` and ``manipulability`` the least one is maximised, and travel decides
        between equals.
    floors : mapping
        Least clearance and manipulability that a state must have.
    home : (dof,), optional
        Where the arm starts and ends.
    """
    for name in ("clearance", "manipulability"):
        if name in floors:
            layers = _kept(layers, name, floors[name])
    if minimise != "travel":
        layers = _kept(layers, minimise, _bottleneck(layers, minimise))
    return _shortest(layers, home)


def _kept(layers: Sequence[tuple[States, States]], name: str, floor: float) -> list[tuple[States, States]]:
    return [tuple(s.where(getattr(s, name) >= floor) for s in pair) for pair in layers]  # type: ignore[misc]


def _bottleneck(layers: Sequence[tuple[States, States]], name: str) -> float:
    """Return the largest value that some grasp reaches at both ends of every transition."""
    best = np.inf
    for pair in layers:
        shared = np.intersect1d(pair[0].grasp_ids, pair[1].grasp_ids)
        values = [min(getattr(s, name)[s.grasp_ids == g].max() for s in pair) for g in shared]
        best = min(best, max(values, default=-np.inf))
    return float(best)


def _shortest(layers: Sequence[tuple[States, States]], home: FloatArray | None) -> JointChoice | None:
    states = [s for pair in layers for s in pair]
    if any(len(s.q) == 0 for s in states):
        return None
    ends = [np.zeros(len(s.q)) if home is None else np.linalg.norm(s.q - home, axis=1) for s in (states[0], states[-1])]
    value, parents = ends[0], []
    for number, (before, after) in enumerate(zip(states[:-1], states[1:], strict=True)):
        length = value[:, None] + cdist(before.q, after.q)
        if number % 2 == 0:
            length[before.grasp_ids[:, None] != after.grasp_ids[None]] = np.inf
        parents.append(length.argmin(axis=0))
        value = length.min(axis=0)
    last = int(np.argmin(value + ends[1]))
    if not np.isfinite(value[last]):
        return None
    path = [last]
    for parent in reversed(parents):
        path.append(int(parent[path[-1]]))
    q = np.array([s.q[i] for s, i in zip(states, reversed(path), strict=True)])
    ids = np.array([s.grasp_ids[i] for s, i in zip(states, reversed(path), strict=True)])
    return JointChoice(ids[::2], q.reshape(len(layers), 2, -1))
