"""The discrete part of the joint problem: which shared grasp, arm branch and whole turns each transition uses.

Every transition gives two layers of states, its free configurations at pick and at place, for each of its grasps. The
shortest path through the layers is the least joint travel, found by dynamic programming: from pick to place the grasp
stays, from place to the next pick it may change. Each joint takes the whole turns that bring it nearest to where it
was. Bounds on clearance and manipulability remove states beforehand.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.motion.refinement.candidates import JointChoice
from regrasp_opt.motion.refinement.measures import ROUNDING, Measure, MeasureBounds, manipulability, travel

Nearest = Callable[[FloatArray, FloatArray], FloatArray]
"""Moves configurations (..., dof), the first argument, by whole turns as near to the second as can be."""


class States(NamedTuple):
    """Free configurations `q` (S, dof) at a pose, each with grasp (S,), clearance (S,) [m] and manipulability (S,)."""

    grasp_ids: IntArray
    q: FloatArray
    clearance: FloatArray
    manipulability: FloatArray

    def where(self, mask: FloatArray) -> States:
        """Return the states of a mask (S,) or of indices."""
        return States(*(part[mask] for part in self))


Layers = tuple[States, States]
"""States at pick and at place of one transition."""


def states_at(checker: FeasibilityChecker, T: FloatArray, grasp_ids: IntArray) -> States:
    """Return all free configurations of `grasp_ids` (K,) at object pose `T` (4, 4)."""
    robot = checker.workcell.arm.robot
    branches = checker.configurations(T, grasp_ids)
    ids = np.repeat(grasp_ids, [len(q) for q in branches])
    q = np.concatenate([np.zeros((0, robot.dof)), *branches])
    clearance = [checker.clearance(T, int(g), x) for g, x in zip(ids, q, strict=True)]
    return States(ids.astype(np.int64), q, np.array(clearance, dtype=np.float64), manipulability(robot, q))


def best_choices(
    layers: Sequence[Layers],
    minimise: Measure,
    bounds: MeasureBounds,
    home: FloatArray | None = None,
    count: int = 1,
    near: Nearest = lambda q, to: q + 0.0 * to,
) -> list[JointChoice]:
    """Return up to `count` choices through the `layers` (pick, place) of all transitions, the best first.

    Those after the first do without one of its grasps each, in the order of their travel. ``travel`` is minimised; of
    ``clearance`` and ``manipulability`` the least one is maximised, and travel decides between equals. States have at
    least the clearance and manipulability of `bounds`; its travel and cost are not looked at. The arm starts and ends
    at `home` (dof,). `near` is `Robot.nearest_equivalent`, where joints may turn by whole turns.
    """
    layers = _kept(_kept(layers, "clearance", bounds.clearance), "manipulability", bounds.manipulability)
    best = _best(layers, minimise, home, near)
    if best is None or count == 1:
        return [] if best is None else [best]
    others = []
    for i, grasp_id in enumerate(best.grasp_ids):
        pick, place = (s.where(s.grasp_ids != grasp_id) for s in layers[i])
        other = _best([*layers[:i], (pick, place), *layers[i + 1 :]], minimise, home, near)
        others += [] if other is None else [other]
    others.sort(key=lambda choice: travel(choice.q.reshape(-1, choice.q.shape[-1]), home))
    return [best, *others][:count]


def unreachable(layers: Sequence[Layers], bounds: MeasureBounds) -> str:
    """Return which transition has no state within `bounds` on clearance and manipulability, and by how much."""
    for i, pair in enumerate(layers):
        for name, unit in (("clearance", " m"), ("manipulability", "")):
            best, bound = _bottleneck([pair], name), getattr(bounds, name)
            if best == -np.inf:
                return f"transition {i}: no shared grasp has a free configuration"
            if best < bound - ROUNDING:
                return (
                    f"transition {i}: the {name} of its best shared grasp is {best:.4g}{unit}, "
                    f"{bound - best:.2g}{unit} short of the bound of at least {bound:.4g}{unit}"
                )
    return "no shared grasp keeps to the bounds on clearance and manipulability at once"


def _kept(layers: Sequence[Layers], name: str, floor: float) -> list[Layers]:
    kept = [[s.where(getattr(s, name) >= floor - ROUNDING) for s in pair] for pair in layers]
    return [(pick, place) for pick, place in kept]


def _bottleneck(layers: Sequence[Layers], name: str) -> float:
    """Return the largest value that some grasp reaches at both ends of every transition."""
    best = np.inf
    for pair in layers:
        shared = np.intersect1d(pair[0].grasp_ids, pair[1].grasp_ids)
        values = [min(getattr(s, name)[s.grasp_ids == g].max() for s in pair) for g in shared]
        best = min(best, max(values, default=-np.inf))
    return float(best)


def _best(layers: Sequence[Layers], minimise: Measure, home: FloatArray | None, near: Nearest) -> JointChoice | None:
    if minimise != "travel":
        layers = _kept(layers, minimise, _bottleneck(layers, minimise))
    states = [s for pair in layers for s in pair]
    if any(len(s.q) == 0 for s in states):
        return None
    q = states[0].q if home is None else near(states[0].q, home)
    value = np.zeros(len(q)) if home is None else np.linalg.norm(q - home, axis=1)
    turned, parents = [q], []
    for number, after in enumerate(states[1:]):
        moved = near(after.q[None], q[:, None])
        length = value[:, None] + np.linalg.norm(moved - q[:, None], axis=2)
        if number % 2 == 0:
            length[states[number].grasp_ids[:, None] != after.grasp_ids[None]] = np.inf
        parents.append(length.argmin(axis=0))
        q, value = moved[parents[-1], np.arange(len(after.q))], length.min(axis=0)
        turned.append(q)
    last = int(np.argmin(value if home is None else value + np.linalg.norm(q - home, axis=1)))
    if not np.isfinite(value[last]):
        return None
    path = [last]
    for parent in reversed(parents):
        path.insert(0, int(parent[path[0]]))
    ids = np.array([s.grasp_ids[i] for s, i in zip(states, path, strict=True)])
    q = np.array([x[i] for x, i in zip(turned, path, strict=True)])
    return JointChoice(ids[::2], q.reshape(len(layers), 2, -1))
