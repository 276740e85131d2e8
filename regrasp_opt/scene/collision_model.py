"""A collision world in a phase as a Pinocchio geometry model, in which the object and the jaw are moved by hand."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import BoolArray, FloatArray
from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.geometry.solids import Containment
from regrasp_opt.scene.collision_world import WORLD, CollisionWorld, ContactPhase


class CollisionModel:
    """The bodies of a world and the pairs of one phase.

    Attributes
    ----------
    world : CollisionWorld
    geometry : pin.GeometryModel
        Bodies have the indices of the world's; collision pairs are in the order of `CollisionWorld.pairs`.
    required : (P,) array
        The clearance of each pair [m].
    inside : Containment
        Which bodies are inside others.
    """

    def __init__(self, world: CollisionWorld, phase: ContactPhase) -> None:
        arm = world.workcell.arm
        self.world, self.model, self.geometry = world, arm.robot.model, arm.robot.collision.copy()
        self.data = self.model.createData()
        self._arm, self._T_base_world = arm, arm.T_base_world
        self._boxes = [shape_geometry(box) for box in arm.end_effector.finger_boxes(0.0)]  # they are resized
        own = dict(zip(world.fingers, self._boxes, strict=True))
        for index, body in enumerate(world.bodies[self.geometry.ngeoms :], start=self.geometry.ngeoms):
            held = index == world.object and phase in (ContactPhase.LIFT, ContactPhase.CARRY)
            joint = arm.robot.dof if held else body.joint
            T = pin.SE3(body.pose if joint else self._T_base_world @ body.pose)
            self.geometry.addGeometryObject(pin.GeometryObject(body.name, joint, T, own.get(index, body.geometry)))
        pairs = world.pairs(phase)
        self.pairs, self.required = [(i, j) for i, j, _ in pairs], np.array([clearance for *_, clearance in pairs])
        for i, j in self.pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(i, j))
        self.inside = Containment(self.model, self.data, self.geometry, self.pairs, world.solids)
        self._jaws: dict[tuple[float, float], list[tuple[FloatArray, pin.SE3]]] = {}

    def place_object(self, T: FloatArray) -> None:
        """Put the object at a pose (4, 4) in the world, or, where it is held, in the frame of the tip's joint."""
        item = self.geometry.geometryObjects[self.world.object]
        item.placement = pin.SE3(T if item.parentJoint != WORLD else self._T_base_world @ T)
        self.inside.moved(self.world.object)

    def open_jaw(self, low: float, high: float) -> None:
        """Let the fingers cover every opening between `low` and `high` [m]."""
        if (low, high) not in self._jaws:
            boxes = self._arm.end_effector.finger_boxes(low, (high - low) / 2)
            self._jaws[low, high] = [(box.size / 2, pin.SE3(self._arm.robot.chain.tip @ box.pose)) for box in boxes]
        for index, box, (half, placement) in zip(self.world.fingers, self._boxes, self._jaws[low, high], strict=True):
            box.halfSide = half
            box.computeLocalAABB()
            self.geometry.geometryObjects[index].placement = placement
            self.inside.moved(index)

    def test(self, margins: FloatArray, asked: BoolArray | None = None) -> tuple[Any, Any]:
        """Return a test for `pin.computeCollisions`, and its queries, which it does not keep alive.

        It asks the pairs that are `asked` (P,), by default all, for distances of at least `margins` (P,) [m]. It looks
        at bounding boxes, grown by these, before bodies: exact, and three to four times faster than all pairs.
        """
        queries = self.geometry.createData()
        settle_queries(queries, margins)
        for pair in [] if asked is None else np.flatnonzero(~asked).tolist():
            queries.deactivateCollisionPair(pair)
        return pin.BroadPhaseManager_NaiveCollisionManager(self.model, self.geometry, queries), queries


def settle_queries(data: Any, margins: FloatArray) -> None:
    """Set up all queries of a `pin.GeometryData` for the least allowed distances `margins`, one a pair [m].

    Two defaults are changed. GJK would start from the last result, so that answers depend on the order of questions.
    And bodies that overlap by up to a millimetre would sometimes pass for apart: where GJK ends because they are
    nearer than its tolerance, its distance is a little above zero; with contacts asked for, EPA measures the overlap.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for request in (*data.collisionRequests, *data.distanceRequests):
            request.enable_cached_gjk_guess = False
        for request, margin in zip(data.collisionRequests, margins, strict=True):
            request.enable_contact = True
            request.security_margin = float(margin)
