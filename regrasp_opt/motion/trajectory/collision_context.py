"""What the arm may run into while it moves: with the jaw open beside a resting object, or with the object in its hand.

Distances that must be kept are those of the workcell, the same as in the feasibility checks; what touches by design
is left out, as each setting says. Every setting can be asked at several `LEVELS`: level k demands what is needed so
that bodies which move by at most ``LEVELS[k]`` between two samples cannot touch in between (see
`regrasp_opt.motion.trajectory.continuous_collision`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.geometry.shapes import mesh_geometry, shape_geometry
from regrasp_opt.geometry.solids import Containment
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.robots.queries import settle_queries
from regrasp_opt.scene.pairs import arm_pairs

LEVELS = 0.032 / 2.0 ** np.arange(10)
"""Motion between two samples [m] that each level of a setting allows for: 32 mm down to 0.06 mm."""

FLOOR = 0.5
"""Share of a clearance that is left between samples at least; at the samples all of it is."""

TOUCH = 1e-4
"""How far a held object may be below its resting height while it is lifted or lowered [m]."""

_WORLD = 0


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
    """The bodies of a problem for motions, in two Pinocchio geometry models: object on the table and object in hand."""

    def __init__(self, problem: RegraspProblem) -> None:
        self._problem = problem
        self._model = problem.workcell.arm.robot.model
        self._data = self._model.createData()
        hull = ConvexHull(problem.object.vertices)
        self._corners = problem.object.vertices[hull.vertices]
        self._free = _Bodies(problem, self._data, held=False)
        self._held = _Bodies(problem, self._data, held=True)

    def beside(self, T_world_object: FloatArray, openings: tuple[float, float]) -> CollisionContext:
        """Return the setting with the object resting at a pose (4, 4) and the jaw at any of `openings` (low, high) [m].

        The arm keeps its clearance from the object; the gripper must not touch it.
        """
        arrangement = _Arrangement(self._problem.workcell.arm.T_base_world @ T_world_object, openings)
        return CollisionContext(self._tester(self._free, arrangement, "all"), self._free.reach_of(arrangement))

    def closing(self, T_world_object: FloatArray, openings: tuple[float, float]) -> CollisionContext:
        """Return the setting in which the jaw closes on, or lets go of, the object at (4, 4), and may touch it."""
        arrangement = _Arrangement(self._problem.workcell.arm.T_base_world @ T_world_object, openings)
        return CollisionContext(self._tester(self._free, arrangement, "touching"), self._free.reach_of(arrangement))

    def holding(self, grasp_id: int) -> CollisionContext:
        """Return the setting with the object in the hand, clear of everything but the gripper and the last link."""
        arrangement = self._in_hand(grasp_id)
        return CollisionContext(self._tester(self._held, arrangement, "all"), self._held.reach_of(arrangement))

    def lifting(self, grasp_id: int, T_world_rest: FloatArray) -> CollisionContext:
        """Return the setting of lifting from, or lowering to, a resting pose (4, 4).

        The object may touch the table: its lowest point must not be more than `TOUCH` below where it rests, or below
        the table's top where it rests higher. Everything else is as in `holding`.
        """
        arrangement = self._in_hand(grasp_id)
        tester = self._tester(self._held, arrangement, "no table")
        cell = self._problem.workcell
        lowest = float((self._corners @ T_world_rest[2, :3]).min() + T_world_rest[2, 3])
        floor = min(lowest, cell.table.height)
        up, joint = cell.arm.T_world_base[2], self._held.tip_joint

        def passes(q: FloatArray, level: int) -> bool:
            if not tester(q, level):
                return False
            T = self._data.oMi[joint].homogeneous @ arrangement.T_parent_object
            z = (self._corners @ (up[:3] @ T[:3, :3])).min() + up[:3] @ T[:3, 3] + up[3]
            return bool(z - floor >= LEVELS[level] / 2 - TOUCH)

        return CollisionContext(passes, self._held.reach_of(arrangement))

    def _in_hand(self, grasp_id: int) -> _Arrangement:
        grasps, effector = self._problem.grasps, self._problem.workcell.arm.end_effector
        width = float(grasps.width[grasp_id])
        T_flange_object = effector.T_flange_tcp @ invert(grasps.T_object_tcp[grasp_id])
        return _Arrangement(self._held.T_joint_flange @ T_flange_object, (width, width))

    def _tester(self, bodies: _Bodies, arrangement: _Arrangement, pairs: str) -> Callable[[FloatArray, int], bool]:
        model, data, checks = self._model, self._data, bodies.checks[pairs]

        def passes(q: FloatArray, level: int) -> bool:
            bodies.arrange(arrangement)
            return not (pin.computeCollisions(model, data, checks[level], q, True) or bodies.inside.found(q))

        return passes


@dataclass(frozen=True, eq=False)
class _Arrangement:
    """Where the object is, in the base or the tip joint (4, 4), and which openings (low, high) the jaw may have."""

    T_parent_object: FloatArray
    openings: tuple[float, float]


class _Bodies:
    """A geometry model of everything that can collide, with one set of required distances for each level."""

    def __init__(self, problem: RegraspProblem, data: Any, *, held: bool) -> None:
        cell, robot, effector = problem.workcell, problem.workcell.arm.robot, problem.workcell.arm.end_effector
        self._robot, self._effector = robot, effector
        self._data: list[pin.GeometryData] = []  # a manager does not keep its data alive
        self.geometry = robot.collision.copy()
        arm = range(self.geometry.ngeoms)
        tip = robot.model.frames[robot.model.getFrameId(robot.tip_frame)]
        self.tip_joint, self.T_joint_flange = int(tip.parentJoint), tip.placement.homogeneous
        self._arrangement: _Arrangement | None = None

        palm = [self._add(s.name, shape_geometry(s), self.T_joint_flange @ s.pose, True) for s in effector.body]
        self._boxes = [shape_geometry(s) for s in effector.finger_boxes(0.0)]
        fingers = [self._add(f"finger {i}", box, np.eye(4), True) for i, box in enumerate(self._boxes)]
        self._fingers = fingers
        mesh = mesh_geometry(problem.object.vertices, problem.object.faces)
        self._object = self._add("object", mesh, np.eye(4), held)
        table = cell.table.shape
        fixed = [self._add(s.name, shape_geometry(s), cell.arm.T_base_world @ s.pose, False) for s in cell.obstacles]
        top = self._add(table.name, shape_geometry(table), cell.arm.T_base_world @ table.pose, False)

        near = cell.clearance
        gripper, moving, own = [*palm, *fingers], [i for i in arm if self._joint(i) != _WORLD], arm_pairs(cell)
        pairs = [(i, j, near.gripper) for i in gripper for j in (top, *fixed)]
        pairs += [(i, j, near.arm) for i in reversed(moving) for j in (top, *fixed)]
        pairs += [(i, j, distance) for i in gripper for j, distance in own.tool]
        pairs += own.links
        if held:
            pairs += [(self._object, i, distance) for i, distance in own.held]
            pairs += [(self._object, i, near.gripper) for i in fixed]
            pairs += [(self._object, top, near.gripper)]
        else:
            pairs += [(i, self._object, near.arm) for i in reversed(moving)]
            pairs += [(i, self._object, 0.0) for i in gripper]
        for i, j, _ in pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.inside = Containment(robot.model, data, self.geometry, [(i, j) for i, j, _ in pairs])
        self.required = np.array([distance for _, _, distance in pairs])
        self.checks = {"all": [self._check(size) for size in LEVELS]}
        contact = ("no table", 1) if held else ("touching", len(gripper))  # the last pairs of the list
        self.checks[contact[0]] = [self._check(size, without=contact[1]) for size in LEVELS]

    def _joint(self, index: int) -> int:
        return int(self.geometry.geometryObjects[index].parentJoint)

    def _add(self, name: str, geometry: Any, T_parent_shape: FloatArray, on_tip: bool) -> int:
        joint = self.tip_joint if on_tip else _WORLD
        return int(self.geometry.addGeometryObject(pin.GeometryObject(name, joint, pin.SE3(T_parent_shape), geometry)))

    def _check(self, size: float, without: int = 0) -> Any:
        """Return the test of one level, which leaves out the last pairs; see `LEVELS`.

        Bounding boxes, grown by these distances, are tested before bodies.
        """
        data = self.geometry.createData()
        margins = np.maximum(self.required, FLOOR * self.required + size / 2)
        settle_queries(data, margins)
        for last in range(1, without + 1):
            data.deactivateCollisionPair(len(self.required) - last)
        self._data.append(data)
        return pin.BroadPhaseManager_NaiveCollisionManager(self._robot.model, self.geometry, data)

    def arrange(self, arrangement: _Arrangement) -> None:
        """Put object and fingers where they belong, unless they are there already."""
        if self._arrangement is arrangement:
            return
        self._arrangement = arrangement
        low, high = arrangement.openings
        items = self.geometry.geometryObjects
        items[self._object].placement = pin.SE3(arrangement.T_parent_object)
        swept = self._effector.finger_boxes(low, (high - low) / 2)
        for index, box, shape in zip(self._fingers, self._boxes, swept, strict=True):
            box.halfSide = shape.size / 2
            box.computeLocalAABB()
            items[index].placement = pin.SE3(self.T_joint_flange @ shape.pose)
        for index in (self._object, *self._fingers):
            self.inside.moved(index)

    def reach_of(self, arrangement: _Arrangement) -> FloatArray:
        """Return how far any point beyond a joint can be from its axis (dof,) [m]."""
        self.arrange(arrangement)
        chain = self._robot.chain
        slides = np.maximum(np.abs(self._robot.lower), np.abs(self._robot.upper)) * chain.prismatic
        radius = np.zeros(chain.dof)  # of what hangs on each joint, about its origin
        for item in self.geometry.geometryObjects:
            if item.parentJoint == _WORLD:
                continue
            item.geometry.computeLocalAABB()
            center = item.placement.act(np.array(item.geometry.aabb_center))
            radius[item.parentJoint - 1] = max(
                radius[item.parentJoint - 1], float(np.linalg.norm(center)) + float(item.geometry.aabb_radius)
            )
        reach = radius.copy()
        for j in range(chain.dof - 2, -1, -1):
            step = float(np.linalg.norm(chain.placements[j + 1, :3, 3])) + slides[j + 1]
            reach[j] = max(radius[j], step + reach[j + 1])
        return np.where(chain.prismatic, 1.0, reach)
