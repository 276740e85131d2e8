"""The collision world of a workcell: its bodies, which of them may touch, and the clearances of all others.

The exact check, motions, the joint problem and the certificate all take their bodies and pairs from here, and measure
by themselves. Links that one joint connects may touch, and those that the workcell names. What stands still in the
robot's own file is an obstacle, with the clearances of one, but for the link in which the first joint turns: that is
the arm's own. The tool may touch what turns with the flange.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from enum import Enum, auto
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.geometry.shapes import Mesh, Shape, shape_geometry
from regrasp_opt.geometry.solids import Solid, distance
from regrasp_opt.objects import ObjectModel
from regrasp_opt.scene.workcell import Workcell

WORLD = 0
"""The joint of what stands still."""


class ContactPhase(Enum):
    """What the arm is about, which decides who may touch whom."""

    GRASP = auto()
    """Gripper at a resting object, which it may touch (the sampler of grasps keeps it clear but for the contact)."""
    MOVE = auto()
    """Empty hand beside a resting object. Its pairs begin with those of `GRASP`."""
    LIFT = auto()
    """Object in the hand; it may touch the support that it leaves or is put on."""
    CARRY = auto()
    """Object in the hand. Its pairs begin with those of `LIFT` from any support."""
    REST = auto()
    """The object alone beside what stands still, on a support."""
    HOME = auto()
    """No object. To be apart from supports and obstacles is enough."""


class Body(NamedTuple):
    """A body that can collide.

    Attributes
    ----------
    name : str
        Its name in certificates.
    label : str
        What messages call it: the link, or the shape.
    joint : int
        The joint that carries it, or `WORLD`.
    pose : (4, 4) array
        In the frame of its joint; in the world if it stands still. Fingers have zero opening; the object's depends on
        the phase and means nothing here.
    geometry : coal.CollisionGeometry
    faces : (F, 3) array, optional
        The triangles of a mesh, where they are at hand.
    """

    name: str
    label: str
    joint: int
    pose: FloatArray
    geometry: Any
    faces: IntArray | None = None


Pair = tuple[int, int, float]
"""Two bodies by index and their clearance [m]; what stands still is the second, except beside a held object."""


class CollisionWorld:
    """The bodies of a workcell, and of an object where one is given.

    Attributes
    ----------
    bodies : list of Body
        Those of the robot come first, in the order of `Robot.collision`.
    moving, still : tuple of int
        Indices of the arm's bodies that move, and of those that do not.
    palm, fingers, gripper : tuple of int
    supports, obstacles : tuple of int
    by_support : list of tuple of int
        The bodies of each support.
    object : int
    surroundings : frozenset of int
        What the clearance of a grasp is measured to: supports, obstacles, those in the robot's own file, the object.
    """

    def __init__(self, workcell: Workcell, model: ObjectModel | None = None) -> None:
        self._model = model
        self.workcell, robot, effector = workcell, workcell.arm.robot, workcell.arm.end_effector
        self.bodies: list[Body] = []
        for index, item in enumerate(robot.collision.geometryObjects):
            T = item.placement.homogeneous
            T = T if item.parentJoint else workcell.arm.T_world_base @ T
            self.bodies.append(Body(item.name, robot.link_of(index), int(item.parentJoint), T, item.geometry))
        self.moving = tuple(i for i, body in enumerate(self.bodies) if body.joint)
        self.still = tuple(i for i, body in enumerate(self.bodies) if not body.joint)
        on_flange, fixed = ("gripper ", robot.dof, robot.chain.tip), ("", WORLD, np.eye(4))
        self.palm = self._add(effector.body, *on_flange)
        self.fingers = self._add(effector.finger_boxes(0.0), *on_flange)
        self.gripper = (*self.palm, *self.fingers)
        self.by_support = [self._add(support.shapes, *fixed) for support in workcell.supports]
        self.supports = tuple(i for bodies in self.by_support for i in bodies)
        self.obstacles = self._add(workcell.obstacles, *fixed)
        self.object = len(self.bodies)
        if model is not None:
            self.bodies.append(Body("object", "object", WORLD, np.eye(4), model.solid.geometry))
        self.surroundings = frozenset((*self.supports, *self.obstacles, self.object, *robot.obstacles))

    @cached_property
    def solids(self) -> list[Solid]:
        """The bodies with their insides, each in its own frame."""
        known = {} if self._model is None else {self.object: self._model.solid}
        return [known.get(i) or Solid(body.geometry, body.faces) for i, body in enumerate(self.bodies)]

    def _add(self, shapes: Sequence[Shape], prefix: str, joint: int, T: FloatArray) -> tuple[int, ...]:
        first = len(self.bodies)
        for shape in shapes:
            faces = shape.faces if isinstance(shape, Mesh) else None
            named = prefix + shape.name, shape.name, joint, T @ shape.pose
            self.bodies.append(Body(*named, shape_geometry(shape), faces))
        return tuple(range(first, len(self.bodies)))

    def finger_poses(self, width: float) -> list[FloatArray]:
        """Return the poses (4, 4) of the fingers at a jaw width [m], in the frame of the tip's joint."""
        arm = self.workcell.arm
        return [arm.robot.chain.tip @ box.pose for box in arm.end_effector.finger_boxes(width)]

    def pairs(self, phase: ContactPhase, on: int | None = None) -> list[Pair]:
        """Return the bodies that must be apart in a phase, with their clearances.

        The object rests `on` the support of this number, leaves it, or is put there; None stands for the only one, or
        for any: then it may be near all of them.
        """
        robot, near, held = self.workcell.arm.robot, self.workcell.clearance, (self.object,)
        others = () if on is None else tuple(i for i in self.supports if i not in self.by_support[on])
        if phase is ContactPhase.REST:
            return _apart(held, (*self.obstacles, *self.still, *others), near.gripper)
        around, own = (*self.supports, *self.obstacles), robot.obstacles
        base = [i for i in self.still if i not in own]
        inner = [i for i in self.moving if self.bodies[i].joint < robot.dof]
        tool = _apart(self.gripper, (*base, *inner), near.self_collision)
        tool += _apart(self.gripper, sorted(own), near.gripper)
        links = [
            (j, i, near.arm) if i in own else (i, j, near.arm if j in own else near.self_collision)
            for i, j in robot.self_collision_pairs()
        ]
        if phase is ContactPhase.HOME:
            return links + _apart((*self.moving, *self.gripper), around, 0.0) + tool
        there = self.object < len(self.bodies)
        resting = held if there and phase in (ContactPhase.GRASP, ContactPhase.MOVE) else ()
        pairs = _apart(self.moving, (*self.supports, *resting, *self.obstacles), near.arm)
        pairs += _apart(self.gripper, around, near.gripper) + tool + links
        if phase is ContactPhase.MOVE:
            pairs += _apart(self.gripper, held, 0.0)
        if phase in (ContactPhase.LIFT, ContactPhase.CARRY):
            pairs += _apart(held, inner, near.arm) + _apart(held, (*self.still, *self.obstacles), near.gripper)
        if phase is ContactPhase.LIFT:
            pairs += _apart(held, others, near.gripper)
        if phase is ContactPhase.CARRY:
            pairs += _apart(held, self.supports, near.gripper)
        return pairs


def _apart(bodies: Sequence[int], others: Sequence[int], clearance: float) -> list[Pair]:
    return [(i, j, clearance) for i in bodies for j in others]


def collision_at_home(workcell: Workcell, among: Collection[str] | None = None) -> tuple[str, str] | None:
    """Return the names of two bodies that collide while the robot rests at home, the jaw wide open, or None.

    Parameters
    ----------
    among : collection of str, optional
        Names of obstacles: only these are tested, against the arm.
    """
    world, arm = CollisionWorld(workcell), workcell.arm
    frames = [np.eye(4), *arm.T_world_base @ arm.robot.link_transforms(arm.robot.home)]
    poses = [body.pose for body in world.bodies]
    for i, T in zip(world.fingers, world.finger_poses(arm.end_effector.max_opening), strict=True):
        poses[i] = T
    joints = [body.joint for body in world.bodies]
    placed = [(solid, frames[j] @ T) for solid, j, T in zip(world.solids, joints, poses, strict=True)]
    asked = None if among is None else {i for i in world.obstacles if world.bodies[i].label in among}
    balls = [(T[:3, :3] @ solid.box.mean(axis=0) + T[:3, 3], solid.radius) for solid, T in placed]
    for i, j, clearance in world.pairs(ContactPhase.HOME):
        if asked is not None and j not in asked:
            continue
        (a, T_a), (b, T_b), (ball_a, radius_a), (ball_b, radius_b) = placed[i], placed[j], balls[i], balls[j]
        if math.dist(ball_a, ball_b) - radius_a - radius_b > clearance:
            continue
        if distance(a, b, T_a, T_b) <= clearance:
            return world.bodies[i].label, world.bodies[j].label
    return None
