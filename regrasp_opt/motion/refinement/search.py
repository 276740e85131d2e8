"""The search behind `refine_plan`: rounds of a discrete choice, a nonlinear program and an exact check.

In each round the free configurations of all shared grasps at the present poses are enumerated, the best choices among
them are found (`choice`), Ipopt moves poses and configurations of each together (`program`), the
configurations are put exactly on their grasps, and the exact checker has the last word. A step that it refuses is
shortened. The next round starts from the best poses, at which other grasps may be shared.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from regrasp_opt.connectivity import SequenceObjective, exact_energy
from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.motion.refinement.choice import best_choices, states_at, unreachable
from regrasp_opt.motion.refinement.measures import (
    JointChoice,
    JointMeasures,
    Measure,
    MeasureBounds,
    first_choice,
    measure_choice,
)
from regrasp_opt.motion.refinement.program import POSITION_UNIT, JointFunctions, JointTask, joint_functions, solve_joint
from regrasp_opt.planning import RegraspPlan, RegraspProblem
from regrasp_opt.planning.verification import PoseFeasibility

WORTHWHILE = 0.01
"""Another round follows where the last one improved the measure by this share."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Shares of a step that are tried until the exact check accepts one."""

PLACED = 1e-9
"""Kinematic residual at which a configuration counts as exactly on its grasp."""

SAME = 1e-3
"""Configurations nearer than this in every joint are not refined again [rad]."""

_functions: WeakKeyDictionary[RegraspProblem, JointFunctions] = WeakKeyDictionary()


@dataclass(frozen=True)
class SearchOptions:
    """How much is tried.

    Attributes
    ----------
    starts : int
        Choices of grasps and branches that are refined in each round.
    rounds : int
        Most rounds.
    cost_weight : float
        Weight of ``J_seq`` beside the joint travel [rad], or beside a clearance in centimetres.
    ipopt : dict
        Options for Ipopt, over ours.
    """

    starts: int = 3
    rounds: int = 4
    cost_weight: float = 0.02
    ipopt: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.starts < 1 or self.rounds < 1:
            raise OptionError(f"starts is {self.starts} and rounds is {self.rounds}; give at least 1")
        if not self.cost_weight >= 0:
            raise OptionError(f"cost_weight is {self.cost_weight}; give 0 or more")


class Candidate(NamedTuple):
    """Planar parameters (N, 3), the choice of grasps and configurations, and its measures; all of it verified."""

    xi: FloatArray
    choice: JointChoice
    measures: JointMeasures


class JointSearch:
    """One search, from the poses of `plan`.

    Attributes
    ----------
    discrete : JointMeasures or None
        Of the best choice at the plan's own poses.
    problem_found : str
        What was in the way last.
    failure : str
        Why no program could be solved and verified; empty where one was.
    stats : list of dict
        One entry for each solve.
    """

    def __init__(
        self,
        plan: RegraspPlan,
        minimise: Measure,
        bounds: MeasureBounds,
        home: FloatArray | None,
        options: SearchOptions,
    ) -> None:
        self.problem, self.minimise, self.bounds = plan.problem, minimise, bounds
        self.home, self.options = home, options
        self.discrete: JointMeasures | None = None
        self.problem_found = self.failure = ""
        self.stats: list[dict[str, Any]] = []
        self._plan = plan
        self._ends = [PoseFeasibility(self.problem.checker, T) for T in plan.poses[[0, -1]]]
        if self.problem not in _functions:
            _functions[self.problem] = joint_functions(self.problem)
        self._functions = _functions[self.problem]
        self._objective: SequenceObjective | None = None
        self._cost = None
        if self.problem.model_folder is not None:
            self._objective, self._cost = _connectivity(plan, self._ends)

    def run(self) -> Candidate | None:
        """Return the best candidate, or None where no choice keeps to the bounds; `failure` says what went wrong.

        Where no program could be solved and verified, that is the best choice at the plan's own poses.
        """
        best: Candidate | None = None
        short = ""
        xi = self._plan.xi
        shared = [t.grasp_ids for t in self._plan.transitions]
        for number in range(self.options.rounds):
            choices = self._choices(xi, shared)
            short = short or self.problem_found
            as_they_are = [c for c in (self._candidate(xi, choice) for choice in choices[:1]) if c is not None]
            if number == 0:
                short = short or self.problem_found
                own = self._candidate(xi, first_choice(self._plan))
                as_they_are += [] if own is None else [own]
                self.discrete = min(as_they_are, key=self._loss).measures if as_they_are else None
            new = [choice for choice in choices if best is None or not _same(choice, best.choice)]
            solved = [c for c in (self._solved(xi, choice) for choice in new) if c is not None]
            if best is None and not solved:
                self.failure = "; ".join(dict.fromkeys(text for text in (short, self.problem_found) if text))
                return min(as_they_are, key=self._loss, default=None)
            before = best if best is not None else min(as_they_are, key=self._loss, default=None)
            best = min([*([] if best is None else [best]), *as_they_are, *solved], key=self._loss)
            if before is not None and self._loss(before) - self._loss(best) < WORTHWHILE * abs(self._loss(before)):
                break
            xi = best.xi
            shared = [np.flatnonzero(a.all() & b.all()) for a, b in itertools.pairwise(self.chain(xi))]
        return best

    def poses(self, xi: FloatArray) -> FloatArray:
        """Return all poses (N+2, 4, 4) at planar parameters `xi` (N, 3) (Eq. 6)."""
        middle = [self.problem.pose(int(m), *x) for m, x in zip(self._plan.placements, xi, strict=True)]
        return np.array([self._plan.poses[0], *middle, self._plan.poses[-1]])

    def chain(self, xi: FloatArray) -> list[PoseFeasibility]:
        """Return the exact checks of all poses at `xi`; those of the ends are kept."""
        middle = [PoseFeasibility(self.problem.checker, T) for T in self.poses(xi)[1:-1]]
        return [self._ends[0], *middle, self._ends[1]]

    def _loss(self, candidate: Candidate) -> float:
        return candidate.measures.loss(self.minimise)

    def _choices(self, xi: FloatArray, shared: list[Any]) -> list[JointChoice]:
        """Return the best choices at the poses of `xi`, without regard to the bounds where none keeps to them."""
        layers = [
            (states_at(self.problem.checker, a, ids), states_at(self.problem.checker, b, ids))
            for (a, b), ids in zip(itertools.pairwise(self.poses(xi)), shared, strict=True)
        ]
        rest = self.home, self.options.starts, self.problem.workcell.arm.robot.nearest_equivalent
        choices = best_choices(layers, self.minimise, self.bounds, *rest)
        if not choices:
            self.problem_found = unreachable(layers, self.bounds)
            choices = best_choices(layers, self.minimise, MeasureBounds(), *rest)
        return choices

    def _solved(self, xi: FloatArray, choice: JointChoice) -> Candidate | None:
        """Return what Ipopt makes of a choice, verified; None where it fails or nothing of its step can be verified."""
        problem, plan = self.problem, self._plan
        grasps, effector = problem.grasps, problem.workcell.arm.end_effector
        task = JointTask(
            placements=problem.placement_poses[plan.placements],
            ends=plan.poses[[0, -1]],
            T_object_flange=grasps.T_object_tcp[choice.grasp_ids] @ effector.T_tcp_flange,
            width=grasps.width[choice.grasp_ids],
            xi=xi,
            q=choice.q,
            minimise=self.minimise,
            bounds=self.bounds,
            home=self.home,
            cost=self._cost,
            cost_weight=self.options.cost_weight,
            reached=not self.bounds.shortfall(self._measures(xi, choice)),
        )
        solve = solve_joint(problem, self._functions, task, self.options.ipopt)
        self.stats.append({"status": solve.status, "violation": solve.violation, "iterations": solve.iterations})
        if solve.violation:
            self.problem_found = f"Ipopt ended with {solve.status}: {solve.violation}"
            return None
        for share in STEPS:
            x = xi + share * (solve.xi - xi)
            q = self._placed(task, x, choice.q + share * (solve.q - choice.q))
            found = None if q is None else self._candidate(x, JointChoice(choice.grasp_ids, q))
            if found is not None:
                self.stats[-1]["step"] = share
                return found
        return None

    def _placed(self, task: JointTask, xi: FloatArray, q: FloatArray) -> FloatArray | None:
        """Return `q` (N+1, 2, dof) moved exactly onto the grasps at `xi` by Newton steps; None where they diverge."""
        poses, q = task.poses(xi), q.copy()
        for i, side in np.ndindex(q.shape[:2]):
            T = poses[i + side] @ task.T_object_flange[i]
            for _ in range(8):
                residual, jacobian = (np.array(part) for part in self._functions.residual(q[i, side], T))
                if np.abs(residual).max() < PLACED:
                    break
                q[i, side] -= np.linalg.lstsq(jacobian, residual.ravel(), rcond=None)[0]
            else:
                self.problem_found = (
                    f"transition {i}: the arm misses the grasp by {POSITION_UNIT * np.abs(residual).max():.2g}"
                )
                return None
        return q

    def _candidate(self, xi: FloatArray, choice: JointChoice) -> Candidate | None:
        """Return a choice at the poses of `xi` if the exact checker verifies it and it keeps to the bounds."""
        refusal = self._refusal(xi, choice)
        if not refusal:
            measures = self._measures(xi, choice)
            refusal = self.bounds.shortfall(measures)
        if refusal:
            self.problem_found = refusal
            return None
        return Candidate(xi, choice, measures)

    def _refusal(self, xi: FloatArray, choice: JointChoice) -> str:
        """Return what the exact checker has against a choice; empty where it is verified."""
        checker, robot = self.problem.checker, self.problem.workcell.arm.robot
        low, high = self.problem.workcell.bounds.array
        if (xi[:, :2] < low - 1e-9).any() or (xi[:, :2] > high + 1e-9).any():
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

    def _measures(self, xi: FloatArray, choice: JointChoice) -> JointMeasures:
        cost = self._plan.cost
        if self._objective is not None:
            cost = float(self._objective.cost(self._plan.placements[None], xi[None])[0])
        return measure_choice(self.problem, self.poses(xi), choice, self.home, cost)


def _connectivity(plan: RegraspPlan, ends: list[PoseFeasibility]) -> tuple[SequenceObjective, Any]:
    """Return ``J_seq`` with exact ends as an objective and as a `casadi.Function` of ``xi`` (N, 3)."""
    problem = plan.problem
    start, goal = (exact_energy(end.all()) for end in ends)
    objective = problem.objective(start, goal)
    functions = problem.energy.casadi_functions(
        start=start,
        goal=goal,
        placements=plan.placements.tolist(),
        blocked=problem.ruled_out(plan.placements, plan.xi) if len(plan.xi) else None,
    )
    return objective, functions.J_seq


def _same(a: JointChoice, b: JointChoice) -> bool:
    """Return whether two choices are the same but for what a solver leaves undone."""
    return np.array_equal(a.grasp_ids, b.grasp_ids) and bool(np.abs(a.q - b.q).max() < SAME)
