"""What a regrasp plan holds: the poses, and for each move between neighbours every grasp that was verified at both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property
from typing import Any

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray, pose_distance
from regrasp_opt.feasibility.diagnosis import diagnose, summary
from regrasp_opt.notebook import PageInNotebook
from regrasp_opt.objects.symmetry import turn_about
from regrasp_opt.planning.at_rest import EXACT, GivenPose, in_words
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.planning.rests import Station


class Status(Enum):
    """How planning ended; the value says so, and what to try next. `RegraspPlan.message` says more about ends."""

    SOLVED = "solved: every transition has a grasp that was verified reachable and free of collision at both poses"
    START_INFEASIBLE = "no grasp is feasible at the start pose"
    GOAL_INFEASIBLE = "no grasp is feasible at the goal pose"
    NOT_FOUND = "no plan was found; allow more regrasps, give more grasps, or try refiner 'ipopt' with another seed"
    TIME_LIMIT = "the time limit ran out before a plan was found; give more time or allow fewer regrasps"


@dataclass(frozen=True)
class Transition:
    """One pick-and-place between neighbouring poses, with all grasps that were verified at both (K of them).

    Attributes
    ----------
    grasp_ids : (K,) int
        Numbers into ``problem.grasps``.
    q_pick, q_place : (K, dof) float64
        Joint configurations [rad] that hold the grasp at the first and at the second pose, as near to each other as
        the arm's branches allow.
    clearance : (K,) float64
        Least distance of arm and gripper to supports and obstacles, and of the arm to the object, over both [m].
    arm : str
        Name of the arm that makes it.
    """

    grasp_ids: IntArray
    q_pick: FloatArray
    q_place: FloatArray
    clearance: FloatArray
    arm: str = "arm"


@dataclass(frozen=True)
class PlanData(PageInNotebook):
    """The fields of a `RegraspPlan`, and what follows from them."""

    status: Status
    poses: FloatArray
    placements: IntArray
    xi: FloatArray
    transitions: Sequence[Transition]
    cost: float
    timings: dict[str, float]
    refiner_stats: list[dict[str, Any]]
    seed: int
    problem: RegraspProblem = field(repr=False, compare=False)
    given: tuple[GivenPose | None, GivenPose | None] = (None, None)
    alternatives: tuple[Any, ...] = field(default=(), repr=False, compare=False)

    @property
    def num_regrasps(self) -> int:
        """Number N of intermediate poses."""
        return len(self.poses) - 2

    @property
    def solved(self) -> bool:
        """Whether the status is SOLVED."""
        return self.status is Status.SOLVED

    @cached_property
    def stations(self) -> tuple[Station, ...]:
        """Where the object is at each of the `poses`."""
        start, goal = (self.problem.station(self.poses[end]) for end in (0, -1))
        rests = [self.problem.rests[m] for m in self.placements]
        middle = (Station(r.support.name, r.placement, xi) for r, xi in zip(rests, self.xi, strict=True))
        return start, *middle, goal

    @cached_property
    def message(self) -> str:
        """How planning ended; for an end without a feasible grasp with counts of the causes, and what helps."""
        ends = {Status.START_INFEASIBLE: 0, Status.GOAL_INFEASIBLE: -1}
        if self.status not in ends:
            return self.status.value
        failures = diagnose(self.problem.checker, self.poses[ends[self.status]])
        return f"{self.status.value}: {summary(failures)}"

    @cached_property
    def remarks(self) -> tuple[str, ...]:
        """What the plan does not take as it was given, or takes although it is not quite at rest; a sentence each."""
        ends = zip(("start", "goal"), self.poses[[0, -1]], self.given, strict=True)
        return tuple(filter(None, (self._remark(*end) for end in ends)))

    def _remark(self, name: str, T: FloatArray, given: GivenPose | None) -> str | None:
        nearest = next(iter(self.problem.nearest_rests(T)), None)
        at = "" if nearest is None else nearest.label
        if given is None:
            if nearest is None or nearest.motion <= EXACT:
                return None
            return f"the {name} is planned as it was given, {nearest.away} from the nearest stable placement, {at}"
        center, turn = self.problem.object.center_of_mass, given.turn
        turned = T if turn is None else T @ turn_about(center, -turn)
        distance = float(np.linalg.norm((turned - given.T) @ np.append(center, 1.0)))
        angle = float(pose_distance(turned, given.T)[1])
        how = ""
        if distance > EXACT or angle > EXACT:
            how += f" was measured {in_words(distance, angle)} from rest and"
        if turn is not None:
            at += f", turned by {np.degrees(np.linalg.norm(turn)):.1f} degrees about the object's axis of symmetry"
        return f"the {name}{how} is planned at {at}"


def shared_grasps(plan: PlanData, index: int) -> list[int]:
    """Return the grasps that the poses before and after transition `index` share."""
    lazy = getattr(plan.transitions, "shared", None)
    ids: list[int] = (plan.transitions[index].grasp_ids if lazy is None else lazy(index)).tolist()
    return ids
