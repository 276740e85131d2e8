"""Candidates of the joint problem: poses with a choice of grasps and configurations, held to the exact check.

A plan lists all grasps that its transitions share; a robot executes one of each. A `JointChoice` says which, and in
which configurations. The first grasp listed by each transition is the choice that a plan stands for.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from regrasp_opt.connectivity import SequenceObjective, exact_energy
from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.motion.refinement.measures import JointMeasures, Measure, MeasureBounds, manipulability, travel
from regrasp_opt.planning import RegraspPlan, Transition
from regrasp_opt.planning.verification import PoseFeasibility, enumerate_transition
from regrasp_opt.solvers.base import wrap_yaw


@dataclass(frozen=True, eq=False)
class JointChoice:
    """One grasp for each of the N+1 transitions and its configurations.

    `grasp_ids` (N+1,) are numbers into ``problem.grasps``, `q` (N+1, 2, dof) the configurations at pick and place
    [rad, m].
    """

    grasp_ids: IntArray
    q: FloatArray


class Candidate(NamedTuple):
    """Planar parameters (N, 3), the choice of grasps and configurations, and its measures; all of it verified."""

    xi: FloatArray
    choice: JointChoice
    measures: JointMeasures


def first_choice(plan: RegraspPlan) -> JointChoice:
    """Return the choice that `plan` stands for: the first grasp of each transition."""
    q = [np.stack([t.q_pick[0], t.q_place[0]]) for t in plan.transitions]
    return JointChoice(np.array([t.grasp_ids[0] for t in plan.transitions], dtype=np.int64), np.array(q))


class CandidateCheck:
    """Measures and verifies candidates with as many poses as `plan` has, on the same placements.

    `before` are the measures of the first choice of `plan`, `bounds` what candidates keep to: those that are given, and
    what is `held` no worse than before. The arm starts and ends at `home` (dof,), if that is given. `J_seq` is the cost
    as a `casadi.Function` of ``xi`` (N, 3); it is None where there is no energy, and the cost is always that of the
    plan. `refused` says what was in the way last.
    """

    def __init__(
        self, plan: RegraspPlan, bounds: MeasureBounds, held: Iterable[Measure] = (), home: FloatArray | None = None
    ) -> None:
        self.plan, self.problem, self.home = plan, plan.problem, home
        self.refused = ""
        self.J_seq: Any = None
        self._objective: SequenceObjective | None = None
        self._ends = [PoseFeasibility(self.problem.checker, T) for T in plan.poses[[0, -1]]]
        if self.problem.energy_file is not None:
            start, goal = (exact_energy(end.all()) for end in self._ends)
            blocked = self.problem.ruled_out(plan.placements, plan.xi) if len(plan.xi) else None
            chain = {"start": start, "goal": goal, "placements": plan.placements.tolist(), "blocked": blocked}
            self._objective = self.problem.objective(start, goal)
            self.J_seq = self.problem.energy.casadi_functions(**chain).J_seq
        self.before = replace(self.measured(plan.xi, first_choice(plan)), cost=plan.cost)
        self.bounds = bounds.tightened(self.before, held)

    def poses(self, xi: FloatArray) -> FloatArray:
        """Return all poses (N+2, 4, 4) at planar parameters `xi` (N, 3) (Eq. 6)."""
        ends = self.plan.poses[[0, -1]]
        middle = self.problem.rests.planar.at(self.plan.placements, xi)
        return np.concatenate([ends[:1], middle, ends[1:]])

    def chain(self, xi: FloatArray) -> list[PoseFeasibility]:
        """Return the exact checks of all poses at `xi`; those of the ends are kept."""
        middle = [PoseFeasibility(self.problem.checker, T) for T in self.poses(xi)[1:-1]]
        return [self._ends[0], *middle, self._ends[1]]

    def candidate(self, xi: FloatArray, choice: JointChoice) -> Candidate | None:
        """Return a choice at the poses of `xi` if the exact checker verifies it and it keeps to the bounds."""
        refusal = self._refusal(xi, choice)
        if not refusal:
            measures = self.measured(xi, choice)
            refusal = self.bounds.shortfall(measures)
        if refusal:
            self.refused = refusal
            return None
        return Candidate(xi, choice, measures)

    def _refusal(self, xi: FloatArray, choice: JointChoice) -> str:
        """Return what the exact checker has against a choice; empty where it is verified."""
        checker, robot = self.problem.checker, self.problem.workcell.arm.robot
        if not self.problem.rests.planar.allow(self.plan.placements, xi):
            return "a pose lies outside the workspace"
        poses = self.poses(xi)
        for i, T in enumerate(poses[1:-1], start=1):
            if checker.object_collides(T):
                return f"pose {i}: the object is too near to an obstacle, the base or the table's edge"
        for i, side in np.ndindex(choice.q.shape[:2]):
            q, where = choice.q[i, side], f"transition {i}, {('pick', 'place')[side]}"
            if not robot.within_limits(q):
                excess = max(float((robot.lower - q).max()), float((q - robot.upper).max()))
                return f"{where}: a joint is {excess:.2g} rad beyond its limit"
            if not checker.is_free(poses[i + side], int(choice.grasp_ids[i]), q):
                return f"{where}: bodies are nearer than their clearance"
        return ""

    def measured(self, xi: FloatArray, choice: JointChoice) -> JointMeasures:
        """Return the measures of a choice at the poses of `xi`."""
        cost = self.plan.cost
        if self._objective is not None:
            cost = float(self._objective.cost(self.plan.placements[None], xi[None])[0])
        robot = self.problem.workcell.arm.robot
        q = choice.q.reshape(-1, robot.dof)
        least = self._clearances(self.poses(xi), choice).min()
        return JointMeasures(travel(q, self.home), float(least), float(manipulability(robot, q).min()), cost)

    def _clearances(self, poses: FloatArray, choice: JointChoice) -> FloatArray:
        """Return the clearances (N+1, 2) of a choice at pick and place [m]."""
        sides = np.ndindex(choice.q.shape[:2])
        clearance = self.problem.checker.clearance
        values = [clearance(poses[i + side], int(choice.grasp_ids[i]), choice.q[i, side]) for i, side in sides]
        return np.array(values, dtype=np.float64).reshape(-1, 2)

    def as_plan(self, best: Candidate) -> RegraspPlan | str:
        """Return the plan of a candidate with all shared grasps, the chosen ones first; or why it is not verified."""
        transitions = list(self.plan.transitions)
        if not np.array_equal(best.xi, self.plan.xi):
            pairs = itertools.pairwise(self.chain(best.xi))
            transitions = [enumerate_transition(self.problem.checker, a, b) for a, b in pairs]
        poses = self.poses(best.xi)
        clearances = self._clearances(poses, best.choice).min(axis=1)
        for i, (t, grasp_id) in enumerate(zip(transitions, best.choice.grasp_ids, strict=True)):
            others = t.grasp_ids != grasp_id
            transitions[i] = Transition(
                np.append(grasp_id, t.grasp_ids[others]),
                np.vstack([best.choice.q[i, :1], t.q_pick[others]]),
                np.vstack([best.choice.q[i, 1:], t.q_place[others]]),
                np.append(clearances[i], t.clearance[others]),
                t.arm,
            )
        cost, xi = best.measures.cost, wrap_yaw(best.xi)
        refined = replace(self.plan, poses=poses, xi=xi, transitions=tuple(transitions), cost=cost)
        problems = refined.residuals().problems
        return f"the refined plan fails the final verification: {problems[0]}" if problems else refined
