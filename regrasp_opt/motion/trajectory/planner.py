"""`plan_motion`: joint trajectories that carry out a regrasp plan.

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
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.grasps import hold_failures
from regrasp_opt.motion.motion_data import MotionStatus, Phase, Segment
from regrasp_opt.motion.trajectory.collision_context import LEVELS, MotionScene
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.motion.trajectory.motion_plan import MotionPlan
from regrasp_opt.motion.trajectory.options import MotionOptions
from regrasp_opt.motion.trajectory.pick_place import Grasped, MotionTools, PickPlaceMotion, Resting
from regrasp_opt.motion.trajectory.smoothing import shortened
from regrasp_opt.planning import RegraspPlan, RegraspProblem, Transition
from regrasp_opt.threads import one_blas_thread

GROUP = 4
"""Grasps that are tried with straight motions before the sampling planner is tried on them."""

LINES = (Phase.LIFT, Phase.LOWER, Phase.APPROACH, Phase.RETREAT)
"""Motions for which tilted lines are tried where straight ones fail."""

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
    connector, home = Connector.of(robot, options), options.home_of(robot)
    with one_blas_thread():
        result = _plan(plan, options, connector, home)
    limits = connector.velocity, connector.acceleration
    return MotionPlan(result.status, result.reason, plan, result.segments, *limits, time.perf_counter() - began)


class _Result(NamedTuple):
    status: MotionStatus
    reason: str
    segments: tuple[Segment, ...] = ()


def _plan(plan: RegraspPlan, options: MotionOptions, connector: Connector, home: FloatArray | None) -> _Result:
    if not plan.solved:
        return _Result(MotionStatus.NO_PLAN, f"the plan's status is {plan.status.name.lower()}")
    scene = MotionScene(plan.problem)
    for T, where in ((plan.poses[0], "start"), (plan.poses[-1], "goal")):
        context = scene.beside(T, (0.0, plan.problem.workcell.arm.end_effector.max_opening))
        if home is not None and not context.passes(home, len(LEVELS) - 1):
            return _Result(MotionStatus.HOME_BLOCKED, f"the arm at home collides with the object at the {where}")
    held = [_held(plan.problem, transition) for transition in plan.transitions]
    for index, transition in enumerate(held):
        if len(transition.grasp_ids) == 0:
            return _Result(MotionStatus.NO_MOTION, f"no grasp of transition {index} holds the object; check the plan")
    plan = replace(plan, transitions=tuple(held))
    tools = MotionTools(plan, scene, connector, home, np.random.default_rng([options.seed, 3]))
    rest, segments = Resting(home, None), list[Segment]()
    for index in range(len(plan.transitions)):
        found = _Transition(tools, options, index, rest).run()
        if isinstance(found, str):
            return _Result(MotionStatus.NO_MOTION, found)
        segments += found
        before_home = [s for s in found if s.phase is not Phase.RETURN][-1]
        rest = Resting(before_home.trajectory.positions[-1], before_home.jaw[1])
    if options.optimise:
        segments = shortened(plan, scene, connector, segments)
    return _Result(MotionStatus.SOLVED, "", tuple(segments))


def _held(problem: RegraspProblem, transition: Transition) -> Transition:
    """Return `transition` without the grasps that do not hold the object: a plan may come from a file."""
    grasps, effector = problem.grasps.subset(transition.grasp_ids), problem.workcell.arm.end_effector
    keep = [k for k, failure in enumerate(hold_failures(grasps, problem.object, effector)) if failure is None]
    t = transition
    return Transition(t.grasp_ids[keep], t.q_pick[keep], t.q_place[keep], t.clearance[keep])


class _Transition:
    def __init__(self, tools: MotionTools, options: MotionOptions, index: int, start: Resting) -> None:
        self._tools, self._options, self._index, self._start = tools, options, index, start
        self._transition = tools.plan.transitions[index]

    def run(self) -> list[Segment] | str:
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

    def _first(self, ways: list[PickPlaceMotion], *, tilted: bool) -> list[Segment] | None:
        """Return the segments of the first of `ways` that is possible."""
        brief, full = max(1, self._options.iterations // BRIEF), self._options.iterations
        groups = [ways[k : k + GROUP] for k in range(0, len(ways), GROUP)]
        rounds = [(group, iterations) for group in groups for iterations in (0, brief)] + [(ways, full)]
        for group, iterations in rounds:
            for way in group:
                found = way.segments(iterations, tilted)
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
            cost = sum(float(self._time(move)) for move in (ends[1] - ends[0], *moves))
            found.append((cost, Grasped(grasped.grasp_id, *ends)))
        return [grasped for _, grasped in sorted(found, key=lambda each: each[0])][: self._options.candidates]

    def _time(self, change: FloatArray) -> FloatArray:
        """Return how long straight moves by `change` (..., dof) take at full speed (...) [s]."""
        times: FloatArray = (np.abs(change) / self._tools.connector.velocity).max(axis=-1)
        return times


def _same_arm(a: FloatArray, b: FloatArray) -> bool:
    """Return whether two configurations (dof,) differ by whole turns at most."""
    turns = (a - b) / (2 * np.pi)
    return bool(np.abs(turns - np.round(turns)).max() < 1e-6)
