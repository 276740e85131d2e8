"""`plan_with_motion`: regrasp plan and motion in one, going on with the next candidate where the arm finds no way."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from regrasp_opt.motion.trajectory.motion_plan import MotionPlan
from regrasp_opt.motion.trajectory.options import MotionOptions
from regrasp_opt.motion.trajectory.planner import plan_motion
from regrasp_opt.planning import RegraspPlan, RegraspProblem, solve_sequence


def plan_with_motion(
    problem: RegraspProblem, start: Any, goal: Any, *, options: MotionOptions | None = None, **search: Any
) -> MotionPlan:
    """Plan poses and motion from `start` to `goal`.

    Each plan that `solve_sequence` verifies has its motion planned; where there is none, the search goes on.

    Parameters
    ----------
    problem : RegraspProblem
    start, goal : (4, 4) array_like
        T_world_object.
    options : MotionOptions, optional
        How to move.
    **search
        Other arguments of `solve_sequence`: refiner, max_regrasps, seed, time_limit.

    Returns
    -------
    MotionPlan
        If no plan that was found allows a motion, the first of them with what is in its way; if none was found at all,
        its status is NO_PLAN. ``.plan`` is the regrasp plan either way.

    Raises
    ------
    PoseError, OptionError, UnknownNameError, ModelError
        Same as in `solve_sequence` and `plan_motion`.
    """
    tried: list[MotionPlan] = []

    def movable(plan: RegraspPlan) -> bool:
        tried.append(plan_motion(plan, options))
        return tried[-1].solved

    plan = solve_sequence(problem, start, goal, accept=movable, **search)
    if not tried:
        return plan_motion(plan, options)
    seconds = sum(motion.seconds for motion in tried)
    if tried[-1].solved:
        return replace(tried[-1], plan=plan, seconds=seconds)
    first = tried[0]
    reason = (
        first.reason
        if len(tried) == 1
        else f"none of {len(tried)} plans allows a motion; for the first, {first.reason}"
    )
    return replace(first, reason=reason, seconds=seconds)
