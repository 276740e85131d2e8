"""`refine_plan`: a verified plan made better for the arm, by a discrete choice first and a nonlinear program after.

Where the program fails, the discrete choice alone remains, with the reason; where nothing better can be verified, the
plan that was given is returned as it was.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.motion.refinement.measures import (
    MEASURES,
    JointMeasures,
    Measure,
    MeasureBounds,
    clearances,
    first_choice,
    measure_choice,
)
from regrasp_opt.motion.refinement.search import Candidate, JointSearch, SearchOptions
from regrasp_opt.planning import RegraspPlan, RegraspProblem, Transition
from regrasp_opt.planning.verification import enumerate_transition
from regrasp_opt.solvers.base import wrap_yaw
from regrasp_opt.threads import one_blas_thread


@dataclass(frozen=True)
class JointResult:
    """What `refine_plan` returns.

    Attributes
    ----------
    plan : RegraspPlan
        The refined plan, whose transitions list the chosen grasp first. Where `reason` is not empty, its poses are
        those of the given plan, or it is the very plan that was given where no other choice of grasps is better.
    before : JointMeasures
        Of the given plan, with the first grasp of each transition.
    discrete : JointMeasures or None
        Of the best choice among the given plan's grasps and all branches of the arm, without moving a pose; None
        where no choice keeps to the bounds.
    after : JointMeasures
        Of `plan`.
    reason : str
        Why no pose could be moved: which constraint, by how much; empty where the program was solved.
    stats : list of dict
        One entry for each solve.
    """

    plan: RegraspPlan
    before: JointMeasures
    discrete: JointMeasures | None
    after: JointMeasures
    reason: str
    stats: list[dict[str, Any]] = field(repr=False)


def refine_plan(
    plan: RegraspPlan,
    minimise: Measure = "travel",
    *,
    home: ArrayLike | None = None,
    hold: Iterable[Measure] = (),
    bounds: MeasureBounds | None = None,
    options: SearchOptions | None = None,
) -> JointResult:
    """Return `plan` with poses, grasps and configurations chosen such that a measure is better, verified again.

    Parameters
    ----------
    plan : RegraspPlan
        A solved plan; the number of its poses and their placements stay.
    minimise : {"travel", "clearance", "manipulability"}
        What is improved: ``travel`` is minimised, of the others the least value is maximised.
    home : (dof,), optional
        Configuration in which the arm starts and ends; it counts for the travel [rad, m].
    hold : iterable of measures
        What may not become worse than it is in `plan`.
    bounds : MeasureBounds, optional
        Bounds that the result must keep to.
    options : SearchOptions, optional
        How much is tried.

    Returns
    -------
    JointResult
        Its plan keeps to the bounds and, where the given plan does so as well, is at least as good as that in the
        measure and in what is held.

    Raises
    ------
    OptionError, UnknownNameError
        If the plan is not solved, `home` does not fit the robot, or a measure is unknown.
    """
    held: list[Any] = [hold] if isinstance(hold, str) else list(hold)
    for name in (minimise, *held):
        if name not in MEASURES:
            raise UnknownNameError("measure", str(name), MEASURES)
    if not plan.solved:
        raise OptionError(f"the plan is not solved ({plan.status.name.lower()}); refine a solved plan")
    begun = time.perf_counter()
    at_home = None if home is None else _checked_home(home, plan.problem)
    with one_blas_thread():
        before = measure_choice(plan.problem, plan.poses, first_choice(plan), at_home, plan.cost)
        limits = (bounds or MeasureBounds()).tightened(before, held)
        search = JointSearch(plan, minimise, limits, at_home, options or SearchOptions())
        best = search.run()
        refined, refusal = None, ""
        if best is not None and (not search.failure or best.measures.loss(minimise) < before.loss(minimise)):
            refined, refusal = _verified(plan, search, best)
        if best is None or refined is None:
            return JointResult(plan, before, search.discrete, before, refusal or search.failure, search.stats)
        refined = replace(refined, timings={**plan.timings, "joint": time.perf_counter() - begun})
        return JointResult(refined, before, search.discrete, best.measures, search.failure, search.stats)


def _checked_home(home: ArrayLike, problem: RegraspProblem) -> FloatArray:
    robot = problem.workcell.arm.robot
    try:
        q = np.asarray(home, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise OptionError(f"home must be {robot.dof} joint values") from error
    if q.shape != (robot.dof,) or not robot.within_limits(q):
        raise OptionError(f"home is {np.round(q, 3).tolist()}; give {robot.dof} joint values within their limits")
    return q


def _verified(plan: RegraspPlan, search: JointSearch, best: Candidate) -> tuple[RegraspPlan | None, str]:
    """Return the plan of `best` with all shared grasps enumerated, or None and the reason why it is not verified."""
    poses = search.poses(best.xi)
    transitions = list(plan.transitions)
    if not np.array_equal(best.xi, plan.xi):
        chain = search.chain(best.xi)
        checker = plan.problem.checker
        transitions = [enumerate_transition(checker, a, b) for a, b in itertools.pairwise(chain)]
    transitions = [_led_by(t, search, best, i) for i, t in enumerate(transitions)]
    refined = replace(plan, poses=poses, xi=wrap_yaw(best.xi), transitions=tuple(transitions), cost=best.measures.cost)
    problems = refined.residuals().problems
    return (None, f"the refined plan fails the final verification: {problems[0]}") if problems else (refined, "")


def _led_by(transition: Transition, search: JointSearch, best: Candidate, i: int) -> Transition:
    """Return `transition` with the chosen grasp first, in its chosen configurations."""
    grasp_id = int(best.choice.grasp_ids[i])
    others = transition.grasp_ids != grasp_id
    clearance = clearances(search.problem, search.poses(best.xi), best.choice)[i].min()
    return Transition(
        np.append(grasp_id, transition.grasp_ids[others]),
        np.vstack([best.choice.q[i, :1], transition.q_pick[others]]),
        np.vstack([best.choice.q[i, 1:], transition.q_place[others]]),
        np.append(clearance, transition.clearance[others]),
    )
