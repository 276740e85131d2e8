"""One way to carry out a transition: a grasp with its two arm configurations, and all motions that belong to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from regrasp_opt.conventions import FK_POSITION_TOLERANCE, FK_ROTATION_TOLERANCE, FloatArray, pose_distance
from regrasp_opt.motion.motion_data import Phase, Segment
from regrasp_opt.motion.trajectory.collision_context import LEVELS, CollisionContext, MotionScene
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.motion.trajectory.options import JAW_TIME
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.planning import RegraspPlan

TILT = 1.0
"""Tangent of the angle by which lines of the tool are tilted."""

RISE = 0.3
"""Least share by which the tool's axis must rise to be a direction of lifting."""


@dataclass(frozen=True, eq=False)
class Grasped:
    """A shared grasp of one transition, with the configurations (dof,) that hold it at both poses."""

    grasp_id: int
    q_pick: FloatArray
    q_place: FloatArray


@dataclass(frozen=True, eq=False)
class Resting:
    """Where the arm rests (dof,), None if it may begin anywhere, and how wide the jaw is [m], None if that is free."""

    q: FloatArray | None
    opening: float | None


@dataclass(frozen=True, eq=False)
class MotionTools:
    """What all motions of a plan are planned with; `home` (dof,) is where the last of them ends, if anywhere."""

    plan: RegraspPlan
    scene: MotionScene
    connector: Connector
    home: FloatArray | None
    rng: np.random.Generator


class PickPlaceMotion:
    """The motions of one grasp of a transition, from where the arm rests; results are remembered from round to round.

    Attributes
    ----------
    blocked : Phase or None
        What was not found when `segments` last returned None.
    """

    def __init__(self, tools: MotionTools, index: int, grasped: Grasped, start: Resting) -> None:
        problem = tools.plan.problem
        self._tools, self._index, self._grasped, self._start = tools, index, grasped, start
        self._T_pick, self._T_place = tools.plan.poses[index : index + 2]
        self._width = float(problem.grasps.width[grasped.grasp_id])
        self._open = self._width + 2 * problem.workcell.arm.end_effector.pre_opening
        self._homeward = tools.home if index == len(tools.plan.transitions) - 1 else None
        self._lines: dict[Phase, Trajectory] = {}
        self._refused: set[tuple[Phase, bool]] = set()
        self._connections: dict[Phase, Trajectory] = {}
        self._bent: set[Phase] = set()
        self.blocked: Phase | None = None

    def segments(self, iterations: int, tilted: bool = False) -> list[Segment] | None:
        """Return all segments of the transition, or None if one of them is not found.

        With no `iterations` of the sampling planner the motions in joint space must be straight. With `tilted`
        the lines of the tool that cannot be straight may be tilted.
        """
        lines = self._straight_lines(tilted)
        if lines is None:
            return None
        approach, lift, lower, retreat = lines
        start, grasped, scene = self._start, self._grasped, self._tools.scene
        wide, narrow = (self._open, self._open), (self._width, self._width)
        opening = self._open if start.opening is None else start.opening
        holding = partial(scene.holding, grasped.grasp_id)
        transfer = self._connected(Phase.TRANSFER, holding, lift.positions[-1], lower.positions[0], iterations)
        if transfer is None:
            return None
        parts = [
            (Phase.APPROACH, approach, wide),
            (Phase.GRASP, _rest(grasped.q_pick), (self._open, self._width)),
            (Phase.LIFT, lift, narrow),
            (Phase.TRANSFER, transfer, narrow),
            (Phase.LOWER, lower, narrow),
            (Phase.RELEASE, _rest(grasped.q_place), (self._width, self._open)),
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
        return [Segment(phase, self._index, grasped.grasp_id, path, jaw) for phase, path, jaw in parts]

    def _connected(
        self,
        phase: Phase,
        context: Callable[[], CollisionContext],
        start: FloatArray,
        goal: FloatArray,
        iterations: int,
    ) -> Trajectory | None:
        """Return the motion of `phase` between configurations (dof,), straight if possible, or None."""
        connector = self._tools.connector
        found = self._connections.get(phase)
        if found is None and phase not in self._bent:
            self._bent.add(phase)
            found = connector.straight(context(), start, goal)
        if found is None and iterations > 0:
            found = connector.around(context(), start, goal, self._tools.rng, iterations)
        if found is None:
            self.blocked = phase
        else:
            self._connections[phase] = found
        return found

    def _straight_lines(self, tilted: bool) -> tuple[Trajectory, Trajectory, Trajectory, Trajectory] | None:
        """Return approach, lift, lowering and retreat, or None if one of them is not possible."""
        grasped = self._grasped
        if not self._holds:
            return None
        for phase, make, q, T in (
            (Phase.LIFT, self._up, grasped.q_pick, self._T_pick),
            (Phase.LOWER, self._up, grasped.q_place, self._T_place),
            (Phase.APPROACH, self._back, grasped.q_pick, self._T_pick),
            (Phase.RETREAT, self._back, grasped.q_place, self._T_place),
        ):
            if phase in self._lines:
                continue
            for turned in (False, True)[: 1 + tilted]:
                if phase not in self._lines and (phase, turned) not in self._refused:
                    found = make(q, T, turned)
                    if found is None:
                        self._refused.add((phase, turned))
                    else:
                        self._lines[phase] = found
            if phase not in self._lines:
                self.blocked = phase
                return None
        lines = self._lines
        return lines[Phase.APPROACH].reversed(), lines[Phase.LIFT], lines[Phase.LOWER].reversed(), lines[Phase.RETREAT]

    @cached_property
    def _holds(self) -> bool:
        """Whether the object is gripped at both poses."""
        ends = (
            (Phase.GRASP, self._grasped.q_pick, self._T_pick),
            (Phase.RELEASE, self._grasped.q_place, self._T_place),
        )
        for phase, q, T in ends:
            if not self._grips(q, T):
                self.blocked = phase
                return False
        return True

    def _grips(self, q: FloatArray, T_world_object: FloatArray) -> bool:
        """Return whether the arm at `q` (dof,) holds the grasp, with room for the jaw; plans may come from files."""
        cell, grasps = self._tools.plan.problem.workcell, self._tools.plan.problem.grasps
        T_world_tcp = cell.arm.T_world_tcp(q)
        distance, angle = pose_distance(T_world_tcp, T_world_object @ grasps.T_object_tcp[self._grasped.grasp_id])
        if distance > FK_POSITION_TOLERANCE or angle > FK_ROTATION_TOLERANCE:
            return False
        return self._tools.scene.closing(T_world_object, (self._width, self._open)).passes(q, len(LEVELS) - 1)

    def _up(self, q: FloatArray, T_world_object: FloatArray, tilted: bool) -> Trajectory | None:
        """Return the straight lift from the object's resting pose (4, 4)."""
        cell, context = (
            self._tools.plan.problem.workcell,
            self._tools.scene.lifting(self._grasped.grasp_id, T_world_object),
        )
        flange = cell.arm.robot.forward(q)
        up = cell.arm.T_base_world[:3, 2]
        directions = up[None]
        if tilted:
            sideways = np.cross(up, flange[:3, 3])
            level = [np.cross(sideways, up), sideways]  # away from the base, and across
            level = [vector / max(float(np.linalg.norm(vector)), 1e-9) for vector in level]
            directions = np.array([up + TILT * sign * vector for vector in level for sign in (-1.0, 1.0)])
            back = -flange[:3, 2]
            if back @ up > RISE:
                directions = np.vstack([back, directions])
        return self._tools.connector.away(context, q, _units(directions))

    def _back(self, q: FloatArray, T_world_object: FloatArray, tilted: bool) -> Trajectory | None:
        """Return the straight retreat of the open jaw from the object at (4, 4), back along the tool's axis."""
        context = self._tools.scene.beside(T_world_object, (self._open, self._open))
        x, _, z = self._tools.plan.problem.workcell.arm.robot.forward(q)[:3, :3].T
        directions = np.array([-z - TILT * x, -z + TILT * x] if tilted else [-z])
        return self._tools.connector.away(context, q, _units(directions))


def _units(vectors: FloatArray) -> FloatArray:
    """Return `vectors` (D, 3) scaled to length 1."""
    units: FloatArray = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    return units


def _rest(q: FloatArray) -> Trajectory:
    return Trajectory(np.array([0.0, JAW_TIME]), np.array([q, q]), np.zeros((2, len(q))))
