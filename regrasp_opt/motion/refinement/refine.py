"""`refine_plan`: a verified plan made better for the arm, by a discrete choice first and a nonlinear program after.

Where the program fails, the discrete choice alone remains, with the reason; where nothing better can be verified, the
plan that was given is returned as it was.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from numpy.typing import ArrayLike

from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.motion.refinement.candidates import CandidateCheck
from regrasp_opt.motion.refinement.measures import MEASURES, JointMeasures, Measure, MeasureBounds
from regrasp_opt.motion.refinement.search import JointSearch, SearchOptions
from regrasp_opt.planning import RegraspPlan
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
    at_home = None if home is None else plan.problem.workcell.arm.robot.configuration(home, "home")
    with one_blas_thread():
        check = CandidateCheck(plan, bounds or MeasureBounds(), held, at_home)
        search = JointSearch(check, minimise, options or SearchOptions())
        best = search.run()
        refined: RegraspPlan | str = search.failure
        if best is not None and (not search.failure or best.measures.loss(minimise) < check.before.loss(minimise)):
            refined = check.as_plan(best)
        if isinstance(refined, str):
            return JointResult(plan, check.before, search.discrete, check.before, refined, search.stats)
        assert best is not None
        refined = replace(refined, timings={**plan.timings, "joint": time.perf_counter() - begun})
        return JointResult(refined, check.before, search.discrete, best.measures, search.failure, search.stats)
