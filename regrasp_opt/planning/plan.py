"""A regrasp plan: what was found, its certificate, and its file."""

from __future__ import annotations

import os
from dataclasses import dataclass

from regrasp_opt.planning.explaining import explain
from regrasp_opt.planning.explanation import Explanation
from regrasp_opt.planning.plan_data import PlanData
from regrasp_opt.planning.plan_file import load_plan, save_plan
from regrasp_opt.planning.residuals import Residuals, compute_residuals


@dataclass(frozen=True)
class RegraspPlan(PlanData):
    """What `solve_sequence` returns.

    Attributes
    ----------
    status : Status
        SOLVED only if every transition was verified by inverse kinematics and collision checks.
    poses : (N+2, 4, 4) float64
        T_world_object of start, N intermediate poses and goal. Without a plan: start and goal, and after a time limit
        the cheapest unverified candidate between them.
    placements : (N,) int
        Numbers into ``problem.rests`` of the intermediate poses; on the first support they are those of
        ``problem.placements``. `stations` has names.
    xi : (N, 3) float64
        Their planar parameters (x, y, theta) in the planes of their supports [m, m, rad] (Eq. 6).
    transitions : sequence of Transition
        N+1 of them, each enumerated when it is first looked at; empty without a plan.
    cost : float
        ``J_seq`` (Eq. 5), with exact feasibility at both ends unless the recipe asks for learned energies; NaN without
        a plan.
    timings : dict
        Seconds spent, by part.
    refiner_stats : list of dict
        One entry for each N that was tried.
    seed : int
    problem : RegraspProblem
    given : (GivenPose or None, GivenPose or None)
        What start and goal were given as, where `poses` has others that mean the same: the nearest resting pose of a
        measured one, or an equal one of a symmetric object. `remarks` says so in words.
    alternatives : tuple of RegraspPlan
        Further plans, where they were asked for; files do not keep them.
    """

    def residuals(self) -> Residuals:
        """Recompute what the plan claims to be feasible from problem data alone, apart from the planner's checks.

        Returns
        -------
        Residuals
            Forward-kinematics errors, joint-limit and collision margins of every grasp of every transition.
        """
        return compute_residuals(self)

    def explain(self, *, remedies: bool = True, time_limit: float = 30.0) -> Explanation:
        """Return why there is no plan: what fails at which pose and why, what is to blame, and what would help.

        It works for a plan from a file as well. Of a solved plan it tells what keeps grasps from being shared.

        Parameters
        ----------
        remedies : bool
            Whether to try changes (poses, obstacles, grasps, end-effectors), with exact checks. That takes seconds,
            the rest a fraction of one.
        time_limit : float
            Seconds after which no further change is tried.

        Returns
        -------
        Explanation
            ``str()`` gives a text, ``.data()`` all of it for JSON.
        """
        exact = [entry.get("max_regrasps", entry.get("num_regrasps", 0)) for entry in self.refiner_stats]
        return explain(
            self.problem,
            list(self.poses),
            self.status.value,
            solved=self.solved,
            tried=max(exact, default=0),
            remedies=remedies,
            time_limit=time_limit,
            seed=self.seed,
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan to `path` as JSON, atomically (docs/plan-file.md)."""
        save_plan(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> RegraspPlan:
        """Return the plan in the file `path`, with the problem that it was made for.

        Raises
        ------
        PlanFileError
            If the file is missing, malformed, or its object or workcell has changed since.
        """
        return load_plan(path, RegraspPlan)
