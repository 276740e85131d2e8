"""The exact check of (pose, grasp) pairs: inverse kinematics over all branches, limits, and every collision.

A pair is feasible if some arm configuration puts the TCP on the grasp, within the joint limits, with every pair of
bodies at least its clearance apart. Tests run in the order of what rejects most for least: gripper against table and
reach (vectorised), inverse kinematics, then Coal on each branch until one is free.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import NamedTuple

import coal
import numpy as np

from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, invert
from regrasp_opt.errors import GraspError
from regrasp_opt.feasibility.scene import CollisionScene
from regrasp_opt.feasibility.standing import beside_a_board, is_above, standing_problem, support_of
from regrasp_opt.geometry.shapes import surface_points
from regrasp_opt.geometry.solids import Solid, nested
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene import Support, Workcell
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase

PAIRS_AT_ONCE = 20_000
"""Pairs that are checked together, in some ten MB of corners and branches, however many are asked for."""


class Branches(NamedTuple):
    """Arm configurations (M, dof) and the number of the (pose, grasp) pair that each belongs to (M,)."""

    q: FloatArray
    pair: IntArray


class Ball(NamedTuple):
    """A ball around the object, in the object's frame [m]."""

    middle: FloatArray
    radius: float


class _Object(NamedTuple):
    model: ObjectModel
    vertices: FloatArray
    solid: Solid


class _Still:
    """A body that stands still, as a Coal collision object in the world, and what to call it."""

    def __init__(self, world: CollisionWorld, index: int) -> None:
        body = world.bodies[index]
        self.solid, self.pose = world.solids[index], body.pose
        self.support = next((k for k, bodies in enumerate(world.by_support) if index in bodies), None)
        self.item = coal.CollisionObject(body.geometry, coal.Transform3s(body.pose[:3, :3], body.pose[:3, 3]))
        link = f"the robot's link '{body.label}'" if index in world.surroundings else "the robot's base"
        shape = "the obstacle" if self.support is None else "the support"
        self.label = f"{shape} '{body.label}'" if index in world.obstacles + world.supports else link


class FeasibilityChecker:
    """Exact feasibility of the grasps of one set on one object in one workcell.

    Parameters
    ----------
    model : ObjectModel or None
        None: tool poses alone are checked, as grasps of an object that is not there.
    workcell : Workcell
    grasps : GraspSet
        G grasps; their numbers are the grasp ids of plans.

    Raises
    ------
    GraspError
        If `grasps` is empty, or their widths are not known yet.
    """

    def __init__(self, model: ObjectModel | None, workcell: Workcell, grasps: GraspSet) -> None:
        grasps.need_widths()
        if len(grasps) == 0:
            raise GraspError("the grasp set is empty; sample or load at least one grasp")
        self.workcell = workcell
        self.grasps = grasps
        self._lock = threading.RLock()  # the scene is arranged for one pose and grasp at a time
        self.world = world = CollisionWorld(workcell, model)
        self.scene = CollisionScene(world, grasps)
        effector = workcell.arm.end_effector
        self._object = None if model is None else _Object(model, model.vertices, model.solid)
        self._still = [_Still(world, i) for _, i, _ in world.pairs(ContactPhase.REST)]
        self._supports = [_Still(world, i) for i in world.supports]
        self._T_object_flange = grasps.T_object_tcp @ effector.T_tcp_flange
        fingers = [surface_points(box) for box in effector.finger_boxes(0.0, effector.pre_opening)]
        fixed = [surface_points(shape) for shape in effector.body]
        self._corners = effector.points_at_widths(fixed, fingers, grasps.width)  # (G, P, 3) flange frame

    def feasible(self, T: FloatArray, grasp_ids: IntArray | None = None) -> BoolArray:
        """Return which grasps are feasible at object pose `T` (4, 4) T_world_object.

        Parameters
        ----------
        T : (4, 4)
        grasp_ids : (K,), optional
            Check these only; all G by default.

        Returns
        -------
        (G,) or (K,) bool
        """
        ids = np.arange(len(self.grasps)) if grasp_ids is None else np.asarray(grasp_ids, dtype=np.int64)
        return self.feasible_pairs(np.broadcast_to(T, (len(ids), 4, 4)), ids)

    def feasible_pairs(self, T: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return the feasibility (M,) of M pairs of object poses `T` (M, 4, 4) and `grasp_ids` (M,)."""
        parts = [slice(first, first + PAIRS_AT_ONCE) for first in range(0, len(grasp_ids), PAIRS_AT_ONCE)]
        with self._lock:
            found = [self._feasible_pairs(T[part], grasp_ids[part]) for part in parts]
        return np.concatenate(found) if found else np.zeros(0, dtype=bool)

    def _feasible_pairs(self, T: FloatArray, grasp_ids: IntArray) -> BoolArray:
        result = np.zeros(len(grasp_ids), dtype=bool)
        open_pairs = np.flatnonzero(~self._blocked(T))
        if len(open_pairs) < len(result):
            if len(open_pairs):
                result[open_pairs] = self._feasible_pairs(T[open_pairs], grasp_ids[open_pairs])
            return result
        for branches in self._branches_of_open(T, grasp_ids, result):
            pair_before = -1
            for q, pair in zip(branches.q, branches.pair.tolist(), strict=True):
                if result[pair]:
                    continue
                if pair != pair_before:
                    self._arrange(T[pair], int(grasp_ids[pair]))
                    pair_before = pair
                result[pair] = not self.scene.collides(q)
        return result

    def configurations(self, T: FloatArray, grasp_ids: IntArray) -> list[FloatArray]:
        """Return all feasible arm configurations (M, dof) [rad] of each grasp (K,) at object pose `T` (4, 4)."""
        branches = self.branches(np.broadcast_to(T, (len(grasp_ids), 4, 4)), grasp_ids)
        apart = not self.object_collides(T)
        found = []
        for k, grasp_id in enumerate(grasp_ids.tolist()):
            free = [q for q in branches.q[branches.pair == k] if apart and self.is_free(T, grasp_id, q)]
            found.append(np.array(free).reshape(len(free), self.workcell.arm.robot.dof))
        return found

    def is_free(self, T: FloatArray, grasp_id: int, q: FloatArray) -> bool:
        """Return whether the arm holds the grasp at configuration `q` (dof,) without collision."""
        with self._lock:
            self._arrange(T, grasp_id)
            return not self.scene.collides(q)

    def clearance(self, T: FloatArray, grasp_id: int, q: FloatArray) -> float:
        """Return the least distance of arm and gripper to supports, obstacles and object [m]; negative on overlap."""
        with self._lock:
            self._arrange(T, grasp_id)
            return self.scene.clearance(q)

    def collisions(self, T: FloatArray, grasp_id: int, q: FloatArray) -> list[tuple[int, int]]:
        """Return the pairs of the scene's bodies that are too near each other at configuration `q` (dof,)."""
        with self._lock:
            self._arrange(T, grasp_id)
            return self.scene.collisions(q)

    @property
    def object_ball(self) -> Ball:
        """A ball around the object."""
        assert self._object is not None
        solid = self._object.solid
        return Ball(solid.box.mean(axis=0), solid.radius)

    def object_collides(self, T: FloatArray) -> bool:
        """Return whether the object at `T` (4, 4) is too near to something fixed, in the table or over its edge."""
        return self.object_problem(T) is not None

    def object_problem(self, T: FloatArray) -> str | None:
        """Return what the object at `T` (4, 4) does that it must not, or None."""
        if self._object is None:
            return None
        problem = self._standing_problem(T)
        near = None if problem else self.object_overlaps(T, self.workcell.clearance.gripper)
        return problem if near is None else f"is too near to {near}"

    def _standing_problem(self, T: FloatArray) -> str | None:
        """Return what is wrong with how the object stands on the support that it is on, or on the only one."""
        assert self._object is not None
        number = 0 if len(self.workcell.supports) == 1 else self.support_below(T)
        vertices = self._object.vertices @ T[:3, :3].T + T[:3, 3]
        if number is None:
            return beside_a_board(vertices, self.workcell)
        support = self.workcell.supports[number]
        return standing_problem(vertices, support) if isinstance(support, Support) else None

    def support_below(self, T: FloatArray) -> int | None:
        """Return the number of the support on which the object is at `T` (4, 4), or None."""
        assert self._object is not None
        return support_of(T, self._object.model, self.workcell)

    def object_overlaps(self, T: FloatArray, clearance: float) -> str | None:
        """Return what is around the object at `T` (4, 4), or nearer than `clearance` [m], or None.

        These are obstacles, the robot's base, and the supports that it neither is on nor above.
        """
        if self._object is None:
            return None
        solid = self._object.solid
        body = coal.CollisionObject(solid.geometry, coal.Transform3s(T[:3, :3], T[:3, 3]))
        request = coal.CollisionRequest()
        request.security_margin = clearance
        for still in (*self._still, *self._other_supports(T)):
            if coal.collide(body, still.item, request, coal.CollisionResult()) or (
                body.getAABB().overlap(still.item.getAABB()) and nested(solid, still.solid, invert(T) @ still.pose)
            ):
                return still.label
        return None

    def _other_supports(self, T: FloatArray) -> list[_Still]:
        if self._object is None or len(self.workcell.supports) == 1:
            return []
        own, corners = self.support_below(T), self._object.model.corners @ T[:3, :3].T + T[:3, 3]
        free = {k for k, s in enumerate(self.workcell.supports) if isinstance(s, Support) and is_above(corners, s)}
        return [still for still in self._supports if still.support != own and still.support not in free]

    def _blocked(self, T: FloatArray) -> BoolArray:
        """Return where the object itself collides (M,), for poses `T` (M, 4, 4) of which neighbours are often equal."""
        if self._object is None:
            return np.zeros(len(T), dtype=bool)
        changes = np.ones(len(T), dtype=bool)
        changes[1:] = (T[1:] != T[:-1]).any(axis=(1, 2))
        blocked = np.array([self.object_collides(pose) for pose in T[changes]], dtype=bool)
        return blocked[np.cumsum(changes) - 1]

    def _arrange(self, T: FloatArray, grasp_id: int) -> None:
        if self._object is not None:
            self.scene.place_object(T)
        self.scene.set_grasp(grasp_id)

    def branches(self, T: FloatArray, grasp_ids: IntArray) -> Branches:
        """Return the arm's configurations within limits for M pairs, less those that cannot be free of collision."""
        kept, targets = self._targets(T, grasp_ids)
        solutions = self.workcell.arm.robot.solve_ik(targets)
        return Branches(solutions.q, kept[solutions.pose_index])

    def _branches_of_open(self, T: FloatArray, grasp_ids: IntArray, done: BoolArray) -> Iterator[Branches]:
        """Yield some of the branches after the other, each time of those pairs that are not `done` (M,) by then."""
        kept, targets = self._targets(T, grasp_ids)
        for solve in self.workcell.arm.robot.ik.parts:
            left = ~done[kept]
            solutions = solve(targets[left])
            yield Branches(solutions.q, kept[left][solutions.pose_index])

    def _targets(self, T: FloatArray, grasp_ids: IntArray) -> tuple[IntArray, FloatArray]:
        """Return which of M pairs neither reach nor table rules out (K,), and their ``T_base_tip`` (K, 4, 4)."""
        T_world_flange = self.flange_poses(T, grasp_ids)
        kept = np.flatnonzero(self.in_reach(T_world_flange) & ~self.gripper_in_table(T_world_flange, grasp_ids))
        return kept, self.workcell.arm.T_base_world @ T_world_flange[kept]

    def flange_poses(self, T: FloatArray, grasp_ids: IntArray) -> FloatArray:
        """Return ``T_world_flange`` (M, 4, 4) of `grasp_ids` (M,) at object poses `T` (M, 4, 4) or (4, 4)."""
        poses: FloatArray = T @ self._T_object_flange[grasp_ids]
        return poses

    def in_reach(self, T_world_flange: FloatArray) -> BoolArray:
        """Return which flange poses (M, 4, 4) are within a bound of the arm's reach (M,)."""
        base = self.workcell.arm.T_world_base[:3, 3]
        return np.linalg.norm(T_world_flange[:, :3, 3] - base, axis=1) <= self.workcell.arm.robot.max_reach

    def gripper_in_table(self, T_world_flange: FloatArray, grasp_ids: IntArray) -> BoolArray:
        """Return where a corner of the gripper lies in a board, or nearer to its top than the clearance."""
        margin = self.workcell.clearance.gripper
        corners = self._corners[grasp_ids] @ np.swapaxes(T_world_flange[:, :3, :3], 1, 2)
        corners += T_world_flange[:, None, :3, 3]
        found = np.zeros(len(grasp_ids), dtype=bool)
        for board in (support.shape for support in self.workcell.boards):
            half = board.size / 2 + np.array([0.0, 0.0, margin])
            local = (corners - board.pose[:3, 3]) @ board.pose[:3, :3]
            found |= (np.abs(local) < half).all(axis=2).any(axis=1)
        return found
