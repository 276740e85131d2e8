"""What the arm may run into while it moves: with the jaw open beside a resting object, or with the object in its hand.

Distances that must be kept are those of the workcell, the same as in the feasibility checks; what touches by design
is left out, as each context says. Every context can be asked at several `LEVELS`: level k demands what is needed so
that bodies which move by at most ``LEVELS[k]`` between two samples cannot touch in between (see
`regrasp_opt.motion.trajectory.continuous_collision`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.geometry.solids import separation
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.scene import Fixture
from regrasp_opt.scene.collision_model import CollisionModel
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase

LEVELS = 0.032 / 2.0 ** np.arange(10)
"""Motion between two samples [m] that each level of a context allows for: 32 mm down to 0.06 mm."""

FLOOR = 0.5
"""Share of a clearance that is left between samples at least; at the samples all of it is."""

TOUCH = 1e-4
"""How far a held object may be below its resting height while it is lifted or lowered [m]."""


@dataclass(frozen=True)
class CollisionContext:
    """One arrangement of the scene, as long as a segment of motion lasts.

    Attributes
    ----------
    passes : callable
        Whether all required distances hold at a configuration (dof,) at a level.
    reach : (dof,) array
        Upper bound on how far any point that moves lies from each joint's axis [m]; 1 for a prismatic joint.
    """

    passes: Callable[[FloatArray, int], bool]
    reach: FloatArray

    def travel(self, change: FloatArray) -> FloatArray:
        """Return a bound [m] on how far any point moves while the joints turn by at most `change` (..., dof)."""
        return np.abs(change) @ self.reach


class MotionScene:
    """The bodies of a problem for motions, in two models: object on a support and object in hand."""

    def __init__(self, problem: RegraspProblem) -> None:
        self._problem = problem
        hull = ConvexHull(problem.object.vertices)
        self._corners = problem.object.vertices[hull.vertices]
        world = problem.checker.world
        self._free, self._held = _Model(world, ContactPhase.MOVE), _Model(world, ContactPhase.CARRY)

    def beside(self, T_world_object: FloatArray, openings: tuple[float, float]) -> CollisionContext:
        """Return the context with the object resting at a pose (4, 4) and the jaw at any of `openings` (low, high) [m].

        The arm keeps its clearance from the object; the gripper must not touch it.
        """
        return self._free.context(ContactPhase.MOVE, _Arrangement(T_world_object, openings))

    def closing(self, T_world_object: FloatArray, openings: tuple[float, float]) -> CollisionContext:
        """Return the context in which the jaw closes on, or lets go of, the object at (4, 4), and may touch it."""
        return self._free.context(ContactPhase.GRASP, _Arrangement(T_world_object, openings))

    def holding(self, grasp_id: int) -> CollisionContext:
        """Return the context with the object in the hand, clear of everything but the gripper and the last link."""
        return self._held.context(ContactPhase.CARRY, self._in_hand(grasp_id))

    def lifting(self, grasp_id: int, T_world_rest: FloatArray) -> CollisionContext:
        """Return the context of lifting from, or lowering to, a resting pose (4, 4).

        The object may touch the support that it is on: its lowest point must not be more than `TOUCH` below where it
        rests, or below the board's top where it rests higher; in a fixture, it must not be deeper in any of its bodies
        than at rest by more than that. Everything else is as in `holding`.
        """
        arrangement, data, cell = self._in_hand(grasp_id), self._held.data, self._problem.workcell
        on = self._problem.checker.support_below(T_world_rest) or 0
        context = self._held.context(ContactPhase.LIFT, arrangement, on if len(cell.supports) > 1 else None)
        height = self._height_in if isinstance(cell.supports[on], Fixture) else self._height_on
        floor, joint = min(height(T_world_rest, on), 0.0), cell.arm.robot.dof

        def passes(q: FloatArray, level: int) -> bool:
            if not context.passes(q, level):
                return False
            T = cell.arm.T_world_base @ (data.oMi[joint].homogeneous @ arrangement.T_object)
            return bool(height(T, on) - floor >= LEVELS[level] / 2 - TOUCH)

        return CollisionContext(passes, context.reach)

    def _height_on(self, T: FloatArray, on: int) -> float:
        """Return how high the object at `T` (4, 4) is above the board of that number [m]."""
        board = self._problem.workcell.supports[on].T_world_support
        up = board[:3, 2]
        return float((self._corners @ (up @ T[:3, :3])).min() + up @ (T[:3, 3] - board[:3, 3]))

    def _height_in(self, T: FloatArray, on: int) -> float:
        """Return how far the object at `T` (4, 4) is from the bodies of the fixture of that number [m]."""
        world, body = self._held.world, self._problem.object.solid
        near = [separation(body, world.solids[i], T, world.bodies[i].pose) for i in world.by_support[on]]
        return min(near, default=np.inf)

    def _in_hand(self, grasp_id: int) -> _Arrangement:
        grasps, arm = self._problem.grasps, self._problem.workcell.arm
        width = float(grasps.width[grasp_id])
        T_flange_object = arm.end_effector.T_flange_tcp @ invert(grasps.T_object_tcp[grasp_id])
        return _Arrangement(arm.robot.chain.tip @ T_flange_object, (width, width))


class _Arrangement(NamedTuple):
    """Where the object is, in the world or the tip joint (4, 4), and which openings (low, high) the jaw may have."""

    T_object: FloatArray
    openings: tuple[float, float]


class _Model(CollisionModel):
    """A collision model with one set of required distances for each level."""

    def __init__(self, world: CollisionWorld, phase: ContactPhase) -> None:
        super().__init__(world, phase)
        self._robot = world.workcell.arm.robot
        self._arrangement: _Arrangement | None = None
        self._tests: dict[tuple[ContactPhase, int | None], list[tuple[Any, Any]]] = {}

    def context(self, phase: ContactPhase, arrangement: _Arrangement, on: int | None = None) -> CollisionContext:
        """Return the context of an arrangement in a phase, `on` a support, whose pairs are among this model's."""
        if (phase, on) not in self._tests:
            margins = [np.maximum(self.required, FLOOR * self.required + size / 2) for size in LEVELS]
            known = {(i, j) for i, j, _ in self.world.pairs(phase, on)}
            asked = np.array([pair in known for pair in self.pairs])
            self._tests[phase, on] = [self.test(least, asked) for least in margins]
        tests = self._tests[phase, on]

        def passes(q: FloatArray, level: int) -> bool:
            self._arrange(arrangement)
            return not (pin.computeCollisions(self.model, self.data, tests[level][0], q, True) or self.inside.found(q))

        return CollisionContext(passes, self._reach(arrangement))

    def _arrange(self, arrangement: _Arrangement) -> None:
        """Put object and fingers where they belong, unless they are there already."""
        if self._arrangement is not arrangement:
            self._arrangement = arrangement
            self.place_object(arrangement.T_object)
            self.open_jaw(*arrangement.openings)

    def _reach(self, arrangement: _Arrangement) -> FloatArray:
        """Return how far any point beyond a joint can be from its axis (dof,) [m]."""
        self._arrange(arrangement)
        chain = self._robot.chain
        slides = np.maximum(np.abs(self._robot.lower), np.abs(self._robot.upper)) * chain.prismatic
        radius = np.zeros(chain.dof)  # of what hangs on each joint, about its origin
        for item in self.geometry.geometryObjects:
            if (joint := item.parentJoint - 1) >= 0:
                item.geometry.computeLocalAABB()
                center = item.placement.act(np.array(item.geometry.aabb_center))
                radius[joint] = max(radius[joint], float(np.linalg.norm(center)) + float(item.geometry.aabb_radius))
        reach = radius.copy()
        for j in range(chain.dof - 2, -1, -1):
            step = float(np.linalg.norm(chain.placements[j + 1, :3, 3])) + slides[j + 1]
            reach[j] = max(radius[j], step + reach[j + 1])
        return np.where(chain.prismatic, 1.0, reach)
