"""A regrasp plan: the poses, and for each move between neighbours every grasp that was proved at both."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import TYPE_CHECKING, Any

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.feasibility.diagnosis import diagnose, summary

if TYPE_CHECKING:
    from regrasp_opt.planning.problem import RegraspProblem
    from regrasp_opt.planning.residuals import Residuals


class Status(Enum):
    """How planning ended; the value says so, and what to try next. `RegraspPlan.message` says more about ends."""

    SOLVED = "solved: every transition has a grasp that was proved reachable and free of collision at both poses"
    START_INFEASIBLE = "no grasp is feasible at the start pose"
    GOAL_INFEASIBLE = "no grasp is feasible at the goal pose"
    NOT_FOUND = "no plan was found; allow more regrasps, give more grasps, or try refiner 'ipopt' with another seed"
    TIME_LIMIT = "the time limit ran out before a plan was found; give more time or allow fewer regrasps"


@dataclass(frozen=True)
class Transition:
    """One pick-and-place between neighbouring poses, with all grasps that were proved at both (K of them).

    Attributes
    ----------
    grasp_ids : (K,) int
        Numbers into ``problem.grasps``.
    q_pick, q_place : (K, dof) float64
        Joint configurations [rad] that hold the grasp at the first and at the second pose, as near to each other as
        the arm's branches allow.
    clearance : (K,) float64
        Least distance of arm and gripper to table and obstacles, and of the arm to the object, over both [m].
    """

    grasp_ids: IntArray
    q_pick: FloatArray
    q_place: FloatArray
    clearance: FloatArray


@dataclass(frozen=True)
class RegraspPlan:
    """What `solve_sequence` returns.

    Attributes
    ----------
    status : Status
        SOLVED only if every transition was proved by inverse kinematics and collision checks.
    poses : (N+2, 4, 4) float64
        T_world_object of start, N intermediate poses and goal. Without a plan: start and goal, and after a time limit
        the cheapest unproved candidate between them.
    placements : (N,) int
        Numbers into ``problem.placements`` of the intermediate poses.
    xi : (N, 3) float64
        Their planar parameters (x, y, theta) [m, m, rad] (Eq. 6).
    transitions : tuple of Transition
        N+1 of them; empty without a plan.
    cost : float
        ``J_seq`` (Eq. 5), with exact feasibility at both ends unless the recipe asks for learned energies; NaN without
        a plan.
    timings : dict
        Seconds spent, by part.
    refiner_stats : list of dict
        One entry for each N that was tried.
    seed : int
    problem : RegraspProblem
    """

    status: Status
    poses: FloatArray
    placements: IntArray
    xi: FloatArray
    transitions: tuple[Transition, ...]
    cost: float
    timings: dict[str, float]
    refiner_stats: list[dict[str, Any]]
    seed: int
    problem: RegraspProblem = field(repr=False, compare=False)

    @property
    def num_regrasps(self) -> int:
        """Number N of intermediate poses."""
        return len(self.poses) - 2

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    @cached_property
    def message(self) -> str:
        """How planning ended; for an end without a feasible grasp with counts of the causes, and what helps."""
        ends = {Status.START_INFEASIBLE: 0, Status.GOAL_INFEASIBLE: -1}
        if self.status not in ends:
            return self.status.value
        failures = diagnose(self.problem.checker, self.poses[ends[self.status]])
        return f"{self.status.value}: {summary(failures)}"

    def residuals(self) -> Residuals:
        """Recompute what the plan claims to be feasible from problem data alone, apart from the planner's checks.

        Returns
        -------
        Residuals
            Forward-kinematics errors, joint-limit and collision margins of every grasp of every transition.
        """
        from regrasp_opt.planning.residuals import compute_residuals

        return compute_residuals(self)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the plan to `path` as JSON, whole or not at all (docs/plan-file.md)."""
        from regrasp_opt.planning.plan_file import save_plan

        save_plan(self, path)

    @staticmethod
    def load(path: str | os.PathLike[str]) -> RegraspPlan:
        """Return the plan in the file `path`, with the problem that it was made for.

        Raises
        ------
        PlanFileError
            If the file is missing, malformed, or its object or workcell has changed since.
        """
        from regrasp_opt.planning.plan_file import load_plan

        return load_plan(path)
