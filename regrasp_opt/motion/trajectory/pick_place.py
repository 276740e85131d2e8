"""One way to carry out a transition: a grasp with its two arm configurations, and all motions that belong to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from regrasp_opt.conventions import FK_POSITION_TOLERANCE, FK_ROTATION_TOLERANCE, FloatArray, pose_distance
from regrasp_opt.motion.motion_data import Phase, Segment
from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext, MotionScene
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.motion.trajectory.options import MotionOptions
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.planning import RegraspPlan

TILT = 1.0
"""Tangent of the angle by which lines of the tool are tilted."""

JAW_TILTS = TILT, 0.4, 3.0
"""The same, of lines of the open jaw: between two boards only some slants, or sideways, lead out."""

OUTWARD = 6.0
"""The same, of lines that lead an object out from under another support."""

RISE = 0.3
"""Least share by which the tool's axis must rise to be a direction of lifting."""

LINES = (Phase.LIFT, Phase.LOWER, Phase.APPROACH, Phase.RETREAT)
"""Motions along lines of the tool, in the order in which they are looked for."""

AT_PICK = (Phase.REACH, Phase.APPROACH, Phase.GRASP, Phase.LIFT)
"""Motions at the pose where the object is picked up; the others are where it is put down."""


class Grasped(NamedTuple):
    """A shared grasp of one transition, with the configurations (dof,) that hold it at both poses."""

    grasp_id: int
    q_pick: FloatArray
    q_place: FloatArray


class Resting(NamedTuple):
    """Where the arm rests (dof,), None if it may begin anywhere, and how wide the jaw is [m], None if that is free."""

    q: FloatArray | None
    opening: float | None


class Leg(NamedTuple):
    """A segment, and the context in which it was verified."""

    segment: Segment
    context: CollisionContext


@dataclass(frozen=True, eq=False)
class MotionTools:
    """What all motions of a plan are planned with; `home` (dof,) is where the last of them ends, if anywhere."""

    plan: RegraspPlan
    options: MotionOptions
    scene: MotionScene
    connector: Connector
    home: FloatArray | None
    rng: np.random.Generator


class PickPlaceMotion:
    """The motions of one grasp of a transition, from where the arm rests; results are remembered from round to round.

    Attributes
    ----------
    blocked : Phase or None
        What was not found when `legs` last returned None.
    """

    def __init__(self, tools: MotionTools, index: int, grasped: Grasped, start: Resting) -> None:
        problem = tools.plan.problem
        self._tools, self._index, self._grasped, self._start = tools, index, grasped, start
        self._T_pick, self._T_place = tools.plan.poses[index : index + 2]
        self._width = float(problem.grasps.width[grasped.grasp_id])
        self._open = self._width + 2 * problem.workcell.arm.end_effector.pre_opening
        self._homeward = tools.home if index == len(tools.plan.transitions) - 1 else None
        self._contexts: dict[Phase, CollisionContext] = {}
        self._lines: dict[tuple[Phase, bool], Trajectory | None] = {}
        self._connections: dict[Phase, Trajectory | None] = {}
        self.blocked: Phase | None = None

    def legs(self, iterations: int, tilted: bool = False) -> list[Leg] | None:
        """Return all segments of the transition, or None if one of them is not found.

        With no `iterations` of the sampling planner the motions in joint space must be straight. With `tilted`
        the lines of the tool that cannot be straight may be tilted.
        """
        self.blocked = self._not_gripped
        if self.blocked is not None:
            return None
        grasped, start = self._grasped, self._start.q
        paths = {Phase.GRASP: self._rest(grasped.q_pick), Phase.RELEASE: self._rest(grasped.q_place)}
        for phase in LINES:
            line = self._line(phase, tilted)
            if line is None:
                self.blocked = phase
                return None
            paths[phase] = line.reversed() if phase in (Phase.APPROACH, Phase.LOWER) else line
        connections = [(Phase.TRANSFER, paths[Phase.LIFT].positions[-1], paths[Phase.LOWER].positions[0])]
        if start is not None:
            connections.append((Phase.REACH, start, paths[Phase.APPROACH].positions[0]))
        if self._homeward is not None:
            connections.append((Phase.RETURN, paths[Phase.RETREAT].positions[-1], self._homeward))
        for phase, begin, end in connections:
            path = self._connected(phase, begin, end, iterations)
            if path is None:
                self.blocked = phase
                return None
            paths[phase] = path
        return [
            Leg(Segment(phase, self._index, grasped.grasp_id, paths[phase], self._jaw(phase)), self._context(phase))
            for phase in Phase
            if phase in paths
        ]

    def _jaw(self, phase: Phase) -> tuple[float, float]:
        """Return the opening of the jaw at the beginning and at the end of `phase` [m]."""
        first = self._width if phase.holds or phase is Phase.RELEASE else self._open
        last = self._width if phase.holds or phase is Phase.GRASP else self._open
        if phase is Phase.REACH and self._start.opening is not None:
            first = self._start.opening
        return first, last

    def _context(self, phase: Phase) -> CollisionContext:
        if phase not in self._contexts:
            self._contexts[phase] = self._new_context(phase)
        return self._contexts[phase]

    def _new_context(self, phase: Phase) -> CollisionContext:
        scene, grasp_id = self._tools.scene, self._grasped.grasp_id
        T = self._T_pick if phase in AT_PICK else self._T_place
        low, high = sorted(self._jaw(phase))
        if phase is Phase.TRANSFER:
            return scene.holding(grasp_id)
        if phase.holds:
            return scene.lifting(grasp_id, T)
        return (scene.closing if phase in (Phase.GRASP, Phase.RELEASE) else scene.beside)(T, (low, high))

    def _connected(self, phase: Phase, start: FloatArray, goal: FloatArray, iterations: int) -> Trajectory | None:
        """Return the motion of `phase` between configurations (dof,), straight if possible, or None."""
        connector = self._tools.connector
        if phase not in self._connections:
            self._connections[phase] = connector.straight(self._context(phase), start, goal)
        if self._connections[phase] is None and iterations > 0:
            found = connector.around(self._context(phase), start, goal, self._tools.rng, iterations)
            self._connections[phase] = found
        return self._connections[phase]

    def _line(self, phase: Phase, tilted: bool) -> Trajectory | None:
        """Return the motion of `phase` away from the object, along a line of the tool, or None."""
        q = self._grasped.q_pick if phase in AT_PICK else self._grasped.q_place
        for turned in (False, True)[: 1 + tilted]:
            if (phase, turned) not in self._lines:
                T = self._T_pick if phase in AT_PICK else self._T_place
                directions = self._upwards(q, T, turned) if phase.holds else self._backwards(q, turned)
                directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
                self._lines[phase, turned] = self._tools.connector.away(self._context(phase), q, directions)
            if self._lines[phase, turned] is not None:
                return self._lines[phase, turned]
        return None

    def _rest(self, q: FloatArray) -> Trajectory:
        times = np.array([0.0, self._tools.options.jaw_time])
        return Trajectory(times, np.array([q, q]), np.zeros((2, len(q))))

    @cached_property
    def _not_gripped(self) -> Phase | None:
        """The phase in which the arm does not hold the grasp, or has no room for the jaw; plans may come from files."""
        cell, grasps = self._tools.plan.problem.workcell, self._tools.plan.problem.grasps
        grasp_id, q_pick, q_place = self._grasped
        for phase, q, T in ((Phase.GRASP, q_pick, self._T_pick), (Phase.RELEASE, q_place, self._T_place)):
            distance, angle = pose_distance(cell.arm.T_world_tcp(q), T @ grasps.T_object_tcp[grasp_id])
            missed = distance > FK_POSITION_TOLERANCE or angle > FK_ROTATION_TOLERANCE
            if missed or not self._context(phase).passes(q, len(LEVELS) - 1):
                return phase
        return None

    def _upwards(self, q: FloatArray, T: FloatArray, tilted: bool) -> FloatArray:
        """Return directions (D, 3) in the base frame in which the object at `T` (4, 4) is lifted at `q` (dof,).

        That is away from its support. Where there are others, tilted ones lead out of a shelf as well.
        """
        problem = self._tools.plan.problem
        arm, supports = problem.workcell.arm, problem.workcell.supports
        normal = supports[problem.checker.support_below(T) or 0].normal
        flange, up = arm.robot.forward(q), arm.T_base_world[:3, :3] @ normal
        if not tilted:
            return up[None]
        sideways = np.cross(up, flange[:3, 3])
        level = [np.cross(sideways, up), sideways]  # away from the base, and across
        level = [vector / max(float(np.linalg.norm(vector)), 1e-9) for vector in level]
        tilts = (TILT, OUTWARD) if len(supports) > 1 else (TILT,)
        directions = np.array([up + t * sign * vector for t in tilts for vector in level for sign in (-1.0, 1.0)])
        back = -flange[:3, 2]
        return np.vstack([back, directions]) if back @ up > RISE else directions

    def _backwards(self, q: FloatArray, tilted: bool) -> FloatArray:
        """Return directions (D, 3) in the base frame in which the open jaw retreats at `q` (dof,)."""
        x, _, z = self._tools.plan.problem.workcell.arm.robot.forward(q)[:3, :3].T
        return np.array([-z + sign * t * x for t in JAW_TILTS for sign in (-1.0, 1.0)] if tilted else [-z])
