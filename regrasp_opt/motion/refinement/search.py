"""The search behind `refine_plan`: rounds of a discrete choice, a nonlinear program and an exact check.

In each round the free configurations of all shared grasps at the present poses are enumerated, the best choices among
them are found (`choice`), Ipopt moves poses and configurations of each together (`program`), the
configurations are put exactly on their grasps, and the exact checker has the last word (`candidates`). A step that it
refuses is shortened. The next round starts from the best poses, at which other grasps may be shared.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.motion.refinement.candidates import Candidate, CandidateCheck, JointChoice, first_choice
from regrasp_opt.motion.refinement.choice import best_choices, states_at, unreachable
from regrasp_opt.motion.refinement.measures import JointMeasures, Measure, MeasureBounds
from regrasp_opt.motion.refinement.program import JointProgram
from regrasp_opt.robots.newton import descend

WORTHWHILE = 0.01
"""Another round follows where the last one improved the measure by this share."""

STEPS = (1.0, 0.5, 0.25, 0.1)
"""Shares of a step that are tried until the exact check accepts one."""

PLACED, PLACING = 1e-9, 8
"""Error [m, rad] at which a configuration counts as exactly on its grasp, and how many steps bring it there."""

SAME = 1e-3
"""Configurations nearer than this in every joint are not refined again [rad]."""


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


class JointSearch:
    """One search for candidates of `check` that are better in a measure.

    `discrete` are the measures of the best choice at the plan's own poses, `failure` says why no program could be
    solved and verified, and is empty where one was; `stats` has one entry for each solve.
    """

    def __init__(self, check: CandidateCheck, minimise: Measure, options: SearchOptions) -> None:
        self._check, self._minimise, self._options = check, minimise, options
        self.discrete: JointMeasures | None = None
        self.failure = ""
        self.stats: list[dict[str, Any]] = []

    def run(self) -> Candidate | None:
        """Return the best candidate, or None where no choice keeps to the bounds; `failure` says what went wrong.

        Where no program could be solved and verified, that is the best choice at the plan's own poses.
        """
        check, plan = self._check, self._check.plan
        best: Candidate | None = None
        short, xi, shared = "", plan.xi, [t.grasp_ids for t in plan.transitions]
        for number in range(self._options.rounds):
            choices = self._choices(xi, shared)
            short = short or check.refused
            own = [check.candidate(xi, choice) for choice in choices[:1]]
            if number == 0:
                short = short or check.refused
                own.append(check.candidate(xi, first_choice(plan)))
            unmoved = min((c for c in own if c is not None), key=self._loss, default=None)
            if number == 0 and unmoved is not None:
                self.discrete = unmoved.measures
            new = [choice for choice in choices if best is None or not _same(choice, best.choice)]
            solved = [c for c in (self._solved(xi, choice) for choice in new) if c is not None]
            if best is None and not solved:
                self.failure = "; ".join(dict.fromkeys(text for text in (short, check.refused) if text))
                return unmoved
            before = best or unmoved
            best = min((c for c in (best, unmoved, *solved) if c is not None), key=self._loss)
            if before is not None and self._loss(before) - self._loss(best) < WORTHWHILE * abs(self._loss(before)):
                break
            xi = best.xi
            shared = [np.flatnonzero(a.all() & b.all()) for a, b in itertools.pairwise(check.chain(xi))]
        return best

    def _loss(self, candidate: Candidate) -> float:
        return candidate.measures.loss(self._minimise)

    def _choices(self, xi: FloatArray, shared: list[Any]) -> list[JointChoice]:
        """Return the best choices at the poses of `xi`, without regard to the bounds where none keeps to them."""
        check, problem = self._check, self._check.problem
        layers = [
            (states_at(problem.checker, a, ids), states_at(problem.checker, b, ids))
            for (a, b), ids in zip(itertools.pairwise(check.poses(xi)), shared, strict=True)
        ]
        rest = check.home, self._options.starts, problem.workcell.arm.robot.nearest_equivalent
        choices = best_choices(layers, self._minimise, check.bounds, *rest)
        if not choices:
            check.refused = unreachable(layers, check.bounds)
            choices = best_choices(layers, self._minimise, MeasureBounds(), *rest)
        return choices

    def _solved(self, xi: FloatArray, choice: JointChoice) -> Candidate | None:
        """Return what Ipopt makes of a choice, verified; None where it fails or nothing of its step can be verified."""
        program = JointProgram(self._check, self._minimise, self._options.cost_weight, xi, choice)
        solve = program.solve(self._options.ipopt)
        self.stats.append({"status": solve.status, "violation": solve.violation, "iterations": solve.iterations})
        if solve.violation:
            self._check.refused = f"Ipopt ended with {solve.status}: {solve.violation}"
            return None
        for share in STEPS:
            x = xi + share * (solve.xi - xi)
            placed = self._placed(x, JointChoice(choice.grasp_ids, choice.q + share * (solve.q - choice.q)))
            found = None if placed is None else self._check.candidate(x, placed)
            if found is not None:
                self.stats[-1]["step"] = share
                return found
        return None

    def _placed(self, xi: FloatArray, choice: JointChoice) -> JointChoice | None:
        """Return `choice` with its configurations exactly on the grasps at `xi`; None where Newton steps diverge."""
        problem, arm = self._check.problem, self._check.problem.workcell.arm
        poses = arm.T_base_world @ self._check.poses(xi)
        T_object_flange = problem.grasps.T_object_tcp[choice.grasp_ids] @ arm.end_effector.T_tcp_flange
        T = np.stack([poses[:-1] @ T_object_flange, poses[1:] @ T_object_flange], axis=1)
        q, errors = descend(arm.robot.chain, T.reshape(-1, 4, 4), choice.q.reshape(-1, arm.robot.dof), PLACING)
        if (errors > PLACED).any():
            worst = int(errors.argmax())
            self._check.refused = f"transition {worst // 2}: the arm misses the grasp by {errors[worst]:.2g}"
            return None
        return JointChoice(choice.grasp_ids, q.reshape(choice.q.shape))


def _same(a: JointChoice, b: JointChoice) -> bool:
    """Return whether two choices are the same but for what a solver leaves undone."""
    return np.array_equal(a.grasp_ids, b.grasp_ids) and bool(np.abs(a.q - b.q).max() < SAME)
