"""`plan_motion`: joint trajectories that carry out a regrasp plan, and `plan_with_motion`, which plans both.

For each transition the shared grasps are tried in the order of how far the arm would have to move. A grasp is taken
when all seven of its motions, and the way to its approach, were proved. Straight motions are tried first for all
grasps of a group; only then does the sampling planner look for ways around, at first briefly, and for longer once all
groups have failed.
"""

from __future__ import annotations

import itertools
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.motion.connections import Connector
from regrasp_opt.motion.options import JAW_TIME, MotionOptions
from regrasp_opt.motion.plan import MotionPlan, MotionStatus, Phase, Segment
from regrasp_opt.motion.scene import LEVELS, MotionScene, Setting
from regrasp_opt.motion.trajectory import Trajectory
from regrasp_opt.planning import RegraspPlan
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
        Its status says how planning ended. SOLVED means that every segment was proved free of collision over its whole
        length and within the joints' limits; otherwise there are no segments, and `reason` says what failed.

    Raises
    ------
    OptionError
        If the home or the accelerations do not fit the robot.
    """
    options = options or MotionOptions()
    began = time.perf_counter()
    robot = plan.problem.workcell.robot
    connector, home = Connector.of(robot, options), options.home_of(robot)
    with one_blas_thread():
        try:
            segments = _Planner(plan, options, connector, home).run()
            status, reason = MotionStatus.SOLVED, ""
        except _Failure as failure:
            segments, status, reason = (), failure.status, failure.reason
    limits = connector.velocity, connector.acceleration
    return MotionPlan(status, reason, plan, segments, *limits, time.perf_counter() - began)


class _Failure(Exception):
    def __init__(self, status: MotionStatus, reason: str) -> None:
        self.status, self.reason = status, reason


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A shared grasp of one transition, with the configurations (dof,) that hold it at both poses."""

    grasp_id: int
    q_pick: FloatArray
    q_place: FloatArray


@dataclass(frozen=True, eq=False)
class _State:
    """Where the arm rests (dof,), or None where it may begin anywhere, and the opening of the jaw [m]."""

    q: FloatArray | None
    opening: float | None


class _Planner:
    def __init__(
        self, plan: RegraspPlan, options: MotionOptions, connector: Connector, home: FloatArray | None
    ) -> None:
        self.plan, self.options, self.connector, self.home = plan, options, connector, home
        self.scene = MotionScene(plan.problem)
        self.rng = np.random.default_rng([options.seed, 3])

    def run(self) -> tuple[Segment, ...]:
        if not self.plan.solved:
            raise _Failure(MotionStatus.NO_PLAN, f"the plan's status is {self.plan.status.name.lower()}")
        self._check_home()
        state, segments = _State(self.home, None), list[Segment]()
        for index in range(len(self.plan.transitions)):
            state, added = self._transition(index, state)
            segments += added
        return tuple(segments)

    def _check_home(self) -> None:
        effector = self.plan.problem.workcell.end_effector
        for T, where in ((self.plan.poses[0], "start"), (self.plan.poses[-1], "goal")):
            setting = self.scene.beside(T, (0.0, effector.max_opening))
            if self.home is not None and not setting.passes(self.home, len(LEVELS) - 1):
                raise _Failure(MotionStatus.HOME_BLOCKED, f"with the object at the {where} the home collides")

    def _transition(self, index: int, state: _State) -> tuple[_State, list[Segment]]:
        brief, full = max(1, self.options.iterations // BRIEF), self.options.iterations
        blocked = Counter[Phase]()
        for pairs in (self._planned_pairs, self._all_pairs):
            candidates = self._nearest(index, state, pairs(index))
            handlings = [_Handling(self, index, candidate, state) for candidate in candidates]
            groups = [handlings[k : k + GROUP] for k in range(0, len(handlings), GROUP)]
            rounds = [(group, iterations) for group in groups for iterations in (0, brief)] + [(handlings, full)]
            for group, iterations in rounds:
                for handling in group:
                    found = handling.segments(iterations)
                    if found is not None:
                        last = found[-1]
                        return _State(last.trajectory.positions[-1], last.jaw[1]), found
            blocked.update(h.blocked for h in handlings if h.blocked is not None)
        causes = ", ".join(f"{phase.name.lower()} {count}" for phase, count in blocked.most_common())
        raise _Failure(
            MotionStatus.NO_MOTION,
            f"no shared grasp of transition {index} admits a motion: of {blocked.total()} ways to hold the object, so "
            f"many fail at {causes}",
        )

    def _planned_pairs(self, index: int) -> Iterator[_Candidate]:
        """Yield the shared grasps with the configurations of the plan."""
        transition = self.plan.transitions[index]
        for k, grasp_id in enumerate(transition.grasp_ids.tolist()):
            yield _Candidate(grasp_id, transition.q_pick[k], transition.q_place[k])

    def _all_pairs(self, index: int) -> Iterator[_Candidate]:
        """Yield the shared grasps with all other feasible configurations at both poses."""
        transition, checker = self.plan.transitions[index], self.plan.problem.checker
        ends = [checker.configurations(T, transition.grasp_ids) for T in self.plan.poses[index : index + 2]]
        for k, (picks, places) in enumerate(zip(*ends, strict=True)):
            for pick, place in itertools.product(picks, places):
                candidate = _Candidate(int(transition.grasp_ids[k]), pick, place)
                planned = transition.q_pick[k], transition.q_place[k]
                if not (_same_arm(pick, planned[0]) and _same_arm(place, planned[1])):
                    yield candidate

    def _nearest(self, index: int, state: _State, pairs: Iterable[_Candidate]) -> list[_Candidate]:
        """Return the first of `pairs`, whole turns added, by how long straight moves would take."""
        robot = self.plan.problem.workcell.robot
        homeward = self.home if index == len(self.plan.transitions) - 1 else None
        found = list[tuple[float, _Candidate]]()
        for pair in pairs:
            turns = robot.equivalents(pair.q_pick) - pair.q_pick
            turns = turns[[robot.within_limits(pair.q_place + turn) for turn in turns]]
            cost = np.full(len(turns), self._time(pair.q_place - pair.q_pick))
            cost += 0.0 if state.q is None else self._time(pair.q_pick + turns - state.q)
            cost += 0.0 if homeward is None else self._time(pair.q_place + turns - homeward)
            best = turns[cost.argmin()]
            turned = _Candidate(pair.grasp_id, pair.q_pick + best, pair.q_place + best)
            found.append((float(cost.min()), turned))
        return [candidate for _, candidate in sorted(found, key=lambda each: each[0])][: self.options.candidates]

    def _time(self, change: FloatArray) -> FloatArray:
        """Return how long straight moves by `change` (..., dof) take at full speed (...) [s]."""
        times: FloatArray = (np.abs(change) / self.connector.velocity).max(axis=-1)
        return times


class _Handling:
    """One candidate's motions from a state on; what was found or refuted is remembered from round to round."""

    def __init__(self, planner: _Planner, index: int, candidate: _Candidate, state: _State) -> None:
        problem = planner.plan.problem
        self._planner, self._index, self._candidate, self._state = planner, index, candidate, state
        self._T_pick, self._T_place = planner.plan.poses[index : index + 2]
        width = float(problem.grasps.width[candidate.grasp_id])
        self._width, self._open = width, width + 2 * problem.workcell.end_effector.pre_opening
        self._homeward = planner.home if index == len(planner.plan.transitions) - 1 else None
        self._connections: dict[Phase, Trajectory] = {}
        self._bent: set[Phase] = set()
        self.blocked: Phase | None = None

    def segments(self, iterations: int) -> list[Segment] | None:
        """Return all segments of the transition, or None if one of them is not found.

        With no `iterations` of the sampling planner the three motions in joint space must be straight.
        """
        if self._lines is None:
            return None
        approach, lift, lower, retreat = self._lines
        start, wide, narrow = self._state, (self._open, self._open), (self._width, self._width)
        opening = self._open if start.opening is None else start.opening
        scene, candidate = self._planner.scene, self._candidate
        holding = partial(scene.holding, candidate.grasp_id)
        transfer = self._connected(Phase.TRANSFER, holding, lift.positions[-1], lower.positions[0], iterations)
        if transfer is None:
            return None
        parts = [
            (Phase.APPROACH, approach, wide),
            (Phase.GRASP, _rest(candidate.q_pick), (self._open, self._width)),
            (Phase.LIFT, lift, narrow),
            (Phase.TRANSFER, transfer, narrow),
            (Phase.LOWER, lower, narrow),
            (Phase.RELEASE, _rest(candidate.q_place), (self._width, self._open)),
            (Phase.RETREAT, retreat, wide),
        ]
        if start.q is not None:
            beside = partial(scene.beside, self._T_pick, (min(opening, self._open), max(opening, self._open)))
            reach = self._connected(Phase.REACH, beside, start.q, approach.positions[0], iterations)
            if reach is None:
                return None
            parts.insert(0, (Phase.REACH, reach, (opening, self._open)))
        if self._homeward is not None:
            beside = partial(scene.beside, self._T_place, wide)
            back = self._connected(Phase.RETURN, beside, retreat.positions[-1], self._homeward, iterations)
            if back is None:
                return None
            parts.append((Phase.RETURN, back, wide))
        return [Segment(phase, self._index, candidate.grasp_id, path, jaw) for phase, path, jaw in parts]

    def _connected(
        self, phase: Phase, setting: Callable[[], Setting], start: FloatArray, goal: FloatArray, iterations: int
    ) -> Trajectory | None:
        """Return the motion of `phase` between configurations (dof,), straight if possible, or None."""
        connector, rng = self._planner.connector, self._planner.rng
        found = self._connections.get(phase)
        if found is None and phase not in self._bent:
            self._bent.add(phase)
            found = connector.straight(setting(), start, goal)
        if found is None and iterations > 0:
            found = connector.around(setting(), start, goal, rng, iterations)
        if found is None:
            self.blocked = phase
        else:
            self._connections[phase] = found
        return found

    @cached_property
    def _lines(self) -> tuple[Trajectory, ...] | None:
        """Approach, lift, lowering and retreat, or None if one of them is not possible."""
        found = []
        for phase, make in (
            (Phase.LIFT, self._lift),
            (Phase.LOWER, self._lower),
            (Phase.APPROACH, self._approach),
            (Phase.RETREAT, self._retreat),
        ):
            trajectory = make()
            if trajectory is None:
                self.blocked = phase
                return None
            found.append(trajectory)
        lift, lower, approach, retreat = found
        return approach, lift, lower, retreat

    def _lift(self) -> Trajectory | None:
        return self._up(self._candidate.q_pick, self._T_pick)

    def _lower(self) -> Trajectory | None:
        return _backwards(self._up(self._candidate.q_place, self._T_place))

    def _approach(self) -> Trajectory | None:
        return _backwards(self._back(self._candidate.q_pick, self._T_pick))

    def _retreat(self) -> Trajectory | None:
        return self._back(self._candidate.q_place, self._T_place)

    def _up(self, q: FloatArray, T_world_object: FloatArray) -> Trajectory | None:
        """Return the straight lift by the object's resting pose (4, 4)."""
        planner = self._planner
        setting = planner.scene.lifting(self._candidate.grasp_id, T_world_object)
        up: FloatArray = planner.plan.problem.workcell.T_base_world[:3, 2]
        return planner.connector.away(setting, q, up)

    def _back(self, q: FloatArray, T_world_object: FloatArray) -> Trajectory | None:
        """Return the straight retreat of the open jaw from the object at (4, 4), along the tool's axis."""
        planner = self._planner
        setting = planner.scene.beside(T_world_object, (self._open, self._open))
        axis: FloatArray = planner.plan.problem.workcell.robot.forward(q)[:3, 2]
        return planner.connector.away(setting, q, -axis)


def _rest(q: FloatArray) -> Trajectory:
    return Trajectory(np.array([0.0, JAW_TIME]), np.array([q, q]), np.zeros((2, len(q))))


def _same_arm(a: FloatArray, b: FloatArray) -> bool:
    """Return whether two configurations (dof,) differ by whole turns at most."""
    turns = (a - b) / (2 * np.pi)
    return bool(np.abs(turns - np.round(turns)).max() < 1e-6)


def _backwards(trajectory: Trajectory | None) -> Trajectory | None:
    return None if trajectory is None else trajectory.reversed()
