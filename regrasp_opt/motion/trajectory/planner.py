"""`plan_motion`: joint trajectories that carry out a regrasp plan; `plan_with_motion`: regrasp plan and motion in one.

For each transition the shared grasps are tried in the order of how far the arm would have to move. A grasp is taken
when all seven of its motions, and the way to its approach, were verified. Straight motions are tried first for all
grasps of a group; only then does the sampling planner look for ways around, at first briefly, and for longer once all
groups have failed. Where the straight lines of the tool are not possible, tilted ones follow. Finally the arm's other
configurations are tried in the same way.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.grasps import hold_failures
from regrasp_opt.motion.motion_data import MotionStatus, Phase, Segment
from regrasp_opt.motion.trajectory.collision_context import LEVELS, MotionScene
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.motion.trajectory.motion_plan import MotionPlan
from regrasp_opt.motion.trajectory.options import MotionOptions
from regrasp_opt.motion.trajectory.pick_place import LINES, Grasped, Leg, MotionTools, PickPlaceMotion, Resting
from regrasp_opt.motion.trajectory.smoothing import shortened
from regrasp_opt.planning import RegraspPlan, RegraspProblem, Transition, solve_sequence
from regrasp_opt.threads import one_blas_thread

GROUP = 4
"""Grasps that are tried with straight motions before the sampling planner is tried on them."""

BRIEF = 3
"""One in so many of the sampling planner's steps is spent on each grasp at first."""


def plan_motion(plan: RegraspPlan, options: MotionOptions | None = None) -> MotionPlan:
    """Plan the motion of arm and jaw that carries out `plan`.

    Parameters
    ----------
    plan : RegraspPlan
    options : MotionOptions, optional

    Returns
    -------
    MotionPlan
        Its status says how planning ended. SOLVED means that every segment was verified to be free over its whole
        length and within the joints' limits; otherwise there are no segments, and `reason` says what failed.

    Raises
    ------
    OptionError
        If the home or the accelerations do not fit the robot.
    """
    options = options or MotionOptions()
    began = time.perf_counter()
    robot = plan.problem.workcell.arm.robot
    connector, home = Connector(robot, options.limits(robot), options.distances), options.home_of(robot)
    with one_blas_thread():
        status, reason, segments = _plan(plan, options, connector, home)
    squeeze, limits = options.squeeze_of(plan.problem.workcell.arm.end_effector), connector.limits
    jerk = None if options.jerk is None else limits.jerk
    seconds = time.perf_counter() - began
    return MotionPlan(
        status, reason, plan, tuple(segments), limits.velocity, limits.acceleration, seconds, jerk, squeeze
    )


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
    seconds, first = sum(motion.seconds for motion in tried), tried[0]
    if tried[-1].solved:
        return replace(tried[-1], plan=plan, seconds=seconds)
    others = f"none of {len(tried)} plans allows a motion; for the first, " if len(tried) > 1 else ""
    return replace(first, reason=others + first.reason, seconds=seconds)


def _plan(
    plan: RegraspPlan, options: MotionOptions, connector: Connector, home: FloatArray | None
) -> tuple[MotionStatus, str, list[Segment]]:
    """Return how planning ended, what failed, and the segments."""
    if not plan.solved:
        return MotionStatus.NO_PLAN, f"the plan's status is {plan.status.name.lower()}", []
    scene = MotionScene(plan.problem)
    for T, where in ((plan.poses[0], "start"), (plan.poses[-1], "goal")):
        context = scene.beside(T, (0.0, plan.problem.workcell.arm.end_effector.max_opening))
        if home is not None and not context.passes(home, len(LEVELS) - 1):
            return MotionStatus.HOME_BLOCKED, f"the arm at home collides with the object at the {where}", []
    held = [_held(plan.problem, transition) for transition in plan.transitions]
    plan, rng = replace(plan, transitions=tuple(held)), np.random.default_rng([options.seed, 3])
    tools = MotionTools(plan, options, scene, connector, home, rng)
    for index, transition in enumerate(held):
        if len(transition.grasp_ids) == 0:
            reason = f"no grasp of transition {index} holds the object; check the plan"
            return MotionStatus.NO_MOTION, reason, []
    rest, legs = Resting(home, None), list[Leg]()
    for index in range(len(held)):
        found = _Transition(tools, index, rest).run()
        if isinstance(found, str):
            return MotionStatus.NO_MOTION, found, []
        legs += found
        last = [leg.segment for leg in found if leg.segment.phase is not Phase.RETURN][-1]
        rest = Resting(last.trajectory.positions[-1], last.jaw[1])
    segments = shortened(connector, legs) if options.optimise else [leg.segment for leg in legs]
    return MotionStatus.SOLVED, "", segments


def _held(problem: RegraspProblem, transition: Transition) -> Transition:
    """Return `transition` without the grasps that do not hold the object: a plan may come from a file."""
    grasps, effector = problem.grasps.subset(transition.grasp_ids), problem.workcell.arm.end_effector
    keep = [k for k, failure in enumerate(hold_failures(grasps, problem.object, effector)) if failure is None]
    t = transition
    return Transition(t.grasp_ids[keep], t.q_pick[keep], t.q_place[keep], t.clearance[keep], t.arm)


class _Transition:
    def __init__(self, tools: MotionTools, index: int, start: Resting) -> None:
        self._tools, self._options, self._index, self._start = tools, tools.options, index, start
        self._transition = tools.plan.transitions[index]

    def run(self) -> list[Leg] | str:
        """Return the segments of the transition, or what is in the way."""
        blocked = Counter[Phase]()
        for holds in (self._planned(), self._all_others()):
            ways = [PickPlaceMotion(self._tools, self._index, grasped, self._start) for grasped in self._nearest(holds)]
            found = self._first(ways, tilted=False)
            found = found or self._first([way for way in ways if way.blocked in LINES], tilted=True)
            if found:
                return found
            blocked.update(way.blocked for way in ways if way.blocked is not None)
        causes = ", ".join(f"{count} fail while {phase.doing}" for phase, count in blocked.most_common())
        return (
            f"no shared grasp of transition {self._index} allows a motion; of {blocked.total()} ways to hold the "
            f"object, {causes}"
        )

    def _first(self, ways: list[PickPlaceMotion], *, tilted: bool) -> list[Leg] | None:
        """Return the segments of the first of `ways` that is possible."""
        brief, full = max(1, self._options.iterations // BRIEF), self._options.iterations
        groups = [ways[k : k + GROUP] for k in range(0, len(ways), GROUP)]
        rounds = [(group, iterations) for group in groups for iterations in (0, brief)] + [(ways, full)]
        for group, iterations in rounds:
            for way in group:
                found = way.legs(iterations, tilted)
                if found is not None:
                    return found
        return None

    def _planned(self) -> Iterator[Grasped]:
        """Yield the shared grasps with the configurations of the plan."""
        for k, grasp_id in enumerate(self._transition.grasp_ids.tolist()):
            yield Grasped(grasp_id, self._transition.q_pick[k], self._transition.q_place[k])

    def _all_others(self) -> Iterator[Grasped]:
        """Yield the shared grasps with all other feasible configurations at both poses."""
        checker, poses = self._tools.plan.problem.checker, self._tools.plan.poses[self._index : self._index + 2]
        picks, places = (checker.configurations(T, self._transition.grasp_ids) for T in poses)
        for planned, *ends in zip(self._planned(), picks, places, strict=True):
            for pick, place in itertools.product(*ends):
                if not (_same_arm(pick, planned.q_pick) and _same_arm(place, planned.q_place)):
                    yield Grasped(planned.grasp_id, pick, place)

    def _nearest(self, holds: Iterable[Grasped]) -> list[Grasped]:
        """Return the first of `holds`, whole turns added joint by joint, by how long straight moves would take."""
        robot, tools, start = self._tools.plan.problem.workcell.arm.robot, self._tools, self._start.q
        homeward = tools.home if self._index == len(tools.plan.transitions) - 1 else None
        found = list[tuple[float, Grasped]]()
        for grasped in holds:
            ends = np.stack([grasped.q_pick, grasped.q_place])
            ways = [end - q for end, q in zip((start, homeward), ends, strict=True) if end is not None]
            turns = robot.nearest_equivalent(ends, ends + np.mean(ways or [np.zeros(robot.dof)], axis=0)) - ends
            ends = ends + turns[np.abs(turns).argmin(axis=0), np.arange(robot.dof)]  # what both ends have room for
            moves = [end - q for end, q in zip((start, homeward), ends, strict=True) if end is not None]
            times = [(np.abs(move) / tools.connector.limits.velocity).max() for move in (ends[1] - ends[0], *moves)]
            cost = float(sum(times))  # at full speed [s]
            found.append((cost, Grasped(grasped.grasp_id, *ends)))
        return [grasped for _, grasped in sorted(found, key=lambda each: each[0])][: self._options.candidates]


def _same_arm(a: FloatArray, b: FloatArray) -> bool:
    """Return whether two configurations (dof,) differ by whole turns at most."""
    turns = (a - b) / (2 * np.pi)
    return bool(np.abs(turns - np.round(turns)).max() < 1e-6)
