"""Goals that count as equal because the object is symmetric about an axis: "anyhow about its axis" is one goal.

A grasp is feasible at them if it is at one of them, so the search treats them as one pose; the plan takes the one that
shares the most grasps with the pose before it. Of axes of the same order the steepest at the goal counts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.errors import OptionError, PoseError
from regrasp_opt.objects.symmetry import turn_about, wrapped
from regrasp_opt.planning.at_rest import EXACT, GivenPose
from regrasp_opt.planning.ends import checked_end
from regrasp_opt.planning.problem_data import ProblemData
from regrasp_opt.planning.verification import PoseFeasibility

SAMPLE = 24
"""Goals that stand for all of a body of revolution."""

FINE = 120
"""Goals among which one is sought that shares a grasp with the start, if none of the sample does."""


class EquivalentPoses(PoseFeasibility):
    """Several poses that count as equal; the first is the one that was asked for."""

    def __init__(self, problem: ProblemData, poses: Sequence[PoseFeasibility]) -> None:
        super().__init__(problem.checker, poses[0].T, given=poses[0].given)
        self._poses = tuple(poses)

    @property
    def members(self) -> Sequence[PoseFeasibility]:
        """All of them."""
        return self._poses

    def feasible(self, grasp_ids: IntArray) -> BoolArray:
        """Return which of `grasp_ids` (K,) are feasible at one of them."""
        found = np.zeros(len(grasp_ids), dtype=bool)
        for pose in self._poses:
            left = np.flatnonzero(~found)
            found[left] = pose.feasible(grasp_ids[left])
        return found

    def possible(self) -> BoolArray:
        """Return the grasps (G,) that are feasible, or not yet known to be infeasible, at one of them."""
        return np.any([pose.possible() for pose in self._poses], axis=0)


def equivalent_goals(
    problem: ProblemData, start: PoseFeasibility, goal: PoseFeasibility, tolerance: tuple[float, float]
) -> PoseFeasibility:
    """Return the goals that differ from `goal` by a symmetry of the object, as one; but those where it cannot be.

    Raises
    ------
    OptionError
        If the object has no axis of symmetry.
    """
    if not problem.symmetries:
        raise OptionError(f"'{problem.object.name}' has no axis of rotational symmetry; omit symmetry")
    best = max(problem.symmetries, key=lambda each: abs(float(goal.T[2, :3] @ each.axis)))
    angles = best.turns(SAMPLE)
    poses = [goal, *_turned(problem, goal, angles[:, None] * best.axis, tolerance)]
    wanted = np.flatnonzero(start.all())
    if best.order is None and not any(pose.feasible(wanted).any() for pose in poses):
        between = np.setdiff1d(np.arange(1, FINE), np.arange(0, FINE, FINE // SAMPLE))
        fine = _turned(problem, goal, wrapped(between * 2 * np.pi / FINE)[:, None] * best.axis, tolerance)
        poses += [pose for pose in fine if pose.feasible(wanted).any()]
    return EquivalentPoses(problem, poses)


def _turned(
    problem: ProblemData, goal: PoseFeasibility, turns: FloatArray, tolerance: tuple[float, float]
) -> Iterator[PoseFeasibility]:
    """Yield `goal` turned by rotation vectors (K, 3) about the centre of mass, put exactly to rest; where it can be."""
    for turn in turns:
        T = goal.T @ turn_about(problem.object.center_of_mass, turn)
        nearest = problem.nearest_rests(T)[0]
        if nearest.motion > EXACT and nearest.within(tolerance):
            T = nearest.T
        try:
            T = checked_end(T, "goal", problem)
        except PoseError:
            continue
        given = GivenPose(goal.T if goal.given is None else goal.given.T, turn)
        yield PoseFeasibility(problem.checker, T, given=given)
