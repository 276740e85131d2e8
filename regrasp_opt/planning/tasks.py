"""Random planning tasks: start and goal poses at which the object can be grasped, drawn from one seed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import GraspError, PoseError
from regrasp_opt.feasibility.diagnosis import diagnose_poses, summary
from regrasp_opt.planning.ends import checked_end
from regrasp_opt.planning.problem import RegraspProblem

_ATTEMPTS = 500


class Task(NamedTuple):
    """Start and goal (4, 4) T_world_object, and how many grasps they share."""

    start: FloatArray
    goal: FloatArray
    shared: int


def random_graspable_pose(problem: RegraspProblem, rng: np.random.Generator) -> FloatArray:
    """Return a random resting pose (4, 4) inside the workspace at which some grasp is feasible.

    Raises
    ------
    GraspError
        If none is found.
    """
    planar = problem.rests.planar
    empty, refused = list[FloatArray](), ""
    for _ in range(_ATTEMPTS):
        numbers, xi = planar.draw(1, rng)
        T = planar.at(numbers[0], xi[0])
        try:
            checked_end(T, "start", problem)
        except PoseError as error:
            refused = str(error)
            continue
        if problem.feasible_grasps(T).any():
            return T
        empty.append(T)
    reason = summary(diagnose_poses(problem.checker, empty, rng)) if empty else refused
    raise GraspError(
        f"no pose of '{problem.object.name}' with a feasible grasp was found in {_ATTEMPTS} tries: {reason}"
    )


def random_task(
    problem: RegraspProblem,
    rng: np.random.Generator,
    *,
    start: FloatArray | None = None,
    goal: FloatArray | None = None,
    needs_regrasp: bool | None = None,
) -> Task:
    """Return a random task with feasible grasps at both ends.

    Parameters
    ----------
    start, goal : (4, 4), optional
        Keep this end instead of drawing it.
    needs_regrasp : bool, optional
        True asks for ends that share no grasp, False for ends that do; None takes what comes.

    Raises
    ------
    GraspError
        If no such pair is found.
    """
    for _ in range(_ATTEMPTS):
        first = random_graspable_pose(problem, rng) if start is None else start
        last = random_graspable_pose(problem, rng) if goal is None else goal
        shared = int((problem.feasible_grasps(first) & problem.feasible_grasps(last)).sum())
        if needs_regrasp is None or needs_regrasp == (shared == 0):
            return Task(first, last, shared)
        if start is not None and goal is not None:
            break
    wanted = "no" if needs_regrasp else "a"
    raise GraspError(f"no two poses of '{problem.object.name}' share {wanted} grasp; give --start and --goal")
