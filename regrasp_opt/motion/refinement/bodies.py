"""The bodies of a workcell as capsules around them, and their distances as CasADi functions of a configuration.

Outer bounds of the exact bodies: a capsule around each link and gripper part, a capsule around the object, balls along
capsules against boxes. A program that keeps them from coming nearer than at a verified start stays near the truth; the
exact checker has the last word. The gripper's distance to the table is left out: planar motion of the object does not
change it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import casadi as ca
import coal
import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.shapes import shape_geometry
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.robots.casadi_distances import capsule_distance, point_box_distance
from regrasp_opt.robots.casadi_kinematics import joint_placements
from regrasp_opt.scene.collision_world import Body, CollisionWorld, ContactPhase

SPACING = 0.01
"""Balls along a capsule are no denser than this [m]; thicker capsules have them a radius apart."""


class Capsule(NamedTuple):
    """A capsule from `a` to `b` (3,) [m]; numbers in some frame, or expressions in the world."""

    name: str
    a: Any
    b: Any
    radius: float
    length: float

    def moved(self, T: Any) -> Capsule:
        """Return the capsule seen through the transform `T` (4, 4)."""
        a, b = (T[:3, :3] @ end + T[:3, 3] for end in (self.a, self.b))
        return self._replace(a=a, b=b)


class Rows(NamedTuple):
    """Distances less the clearance they need, as a function, and what each row is.

    Attributes
    ----------
    function : casadi.Function
        Gives a column of M distances [m].
    names : tuple of str
        The two bodies of each row.
    measured : (M,) bool
        Which rows count for the least clearance of a plan; the others are self-collision.
    required : (M,)
        The clearance that was taken off each row [m].
    """

    function: Any
    names: tuple[str, ...]
    measured: FloatArray
    required: FloatArray


def covering_capsule(name: str, geometry: Any) -> Capsule:
    """Return a capsule around a Coal geometry, in the geometry's frame; exact for spheres and capsules."""
    if isinstance(geometry, coal.Sphere):
        return Capsule(name, np.zeros(3), np.zeros(3), float(geometry.radius), 0.0)
    if isinstance(geometry, (coal.Capsule, coal.Cylinder)):
        end = np.array([0.0, 0.0, geometry.halfLength])
        return Capsule(name, -end, end, float(geometry.radius), 2 * float(geometry.halfLength))
    center, half = _box_around(geometry)
    longest = int(np.argmax(half))
    end = np.where(np.arange(3) == longest, half, 0.0)
    radius = float(np.linalg.norm(np.delete(half, longest)))
    return Capsule(name, center - end, center + end, radius, 2 * float(half[longest]))


def _box_around(geometry: Any) -> tuple[FloatArray, FloatArray]:
    """Return centre and half edge lengths (3,) of the box around a Coal geometry, along the axes of its frame."""
    geometry.computeLocalAABB()
    low, high = np.array(geometry.aabb_local.min_), np.array(geometry.aabb_local.max_)
    return (low + high) / 2, (high - low) / 2


def configuration_rows(problem: RegraspProblem) -> Rows:
    """Return the distances of arm and gripper, a function of ``q`` (dof,), ``T`` (4, 4) T_world_object, ``width``."""
    arm, world = problem.workcell.arm, CollisionWorld(problem.workcell, problem.object)
    q, T, width = ca.SX.sym("q", arm.robot.dof), ca.SX.sym("T", 4, 4), ca.SX.sym("width")
    T_world_base = ca.SX(ca.DM(arm.T_world_base))
    T_joint = [T_world_base @ placement for placement in joint_placements(arm.robot.model, q)]
    capsules = {i: _capsule(world.bodies[i]) for i in (*world.moving, *world.still, *world.palm)}
    fingers = arm.end_effector.finger_boxes(0.0, arm.end_effector.pre_opening)
    for number, (i, shape) in enumerate(zip(world.fingers, fingers, strict=True)):
        capsule = covering_capsule(world.bodies[i].name, shape_geometry(shape)).moved(shape.pose)
        aside = ca.vertcat(0, (0.5 if number < len(fingers) / 2 else -0.5) * width, 0)
        moved = capsule._replace(a=capsule.a + aside, b=capsule.b + aside)
        capsules[i] = moved.moved(ca.SX(ca.DM(arm.robot.chain.tip)))
    for i, capsule in capsules.items():
        joint = world.bodies[i].joint
        capsules[i] = capsule.moved(T_joint[joint]) if joint else capsule
    capsules[world.object] = _capsule(world.bodies[world.object]).moved(T)

    rows: list[tuple[Any, str, bool, float]] = []
    for i, j, needed in world.pairs(ContactPhase.GRASP):
        body, other = capsules[i], world.bodies[j]
        if j in world.supports:
            height = problem.workcell.supports[world.supports.index(j)].height
            distances = [end[2] - body.radius - height for end in (body.a, body.b)] if i in world.moving else []
        elif j in world.surroundings and j != world.object:
            distances = _to_obstacle(body, other)
        else:
            distances = [_between(body, capsules[j])]
        rows += [(distance, f"{body.name} and {other.name}", j in world.surroundings, needed) for distance in distances]
    return _rows("clearances", [q, T, width], ["q", "T", "width"], rows)


def object_rows(problem: RegraspProblem) -> Rows:
    """Return the distances of the object to obstacles and the robot's base, a function of ``T`` (4, 4)."""
    world, T = CollisionWorld(problem.workcell, problem.object), ca.SX.sym("T", 4, 4)
    held = _capsule(world.bodies[world.object]).moved(T)
    rows = []
    for _, j, needed in world.pairs(ContactPhase.REST):
        body = world.bodies[j]
        distances = _to_obstacle(held, body) if j in world.surroundings else [_between(held, _capsule(body))]
        rows += [(distance, f"object and {body.name}", False, needed) for distance in distances]
    return _rows("object_clearances", [T], ["T"], rows)


def _rows(name: str, inputs: list[Any], labels: list[str], rows: list[tuple[Any, str, bool, float]]) -> Rows:
    column = ca.vertcat(*[distance - needed for distance, _, _, needed in rows]) if rows else ca.SX(0, 1)
    function = ca.Function(name, inputs, [column], labels, ["margin"])
    measured, required = np.array([row[2] for row in rows], dtype=bool), np.array([row[3] for row in rows], dtype=float)
    return Rows(function, tuple(row[1] for row in rows), measured, required)


def _capsule(body: Body) -> Capsule:
    """Return a capsule around a body, in the frame of its joint."""
    return covering_capsule(body.name, body.geometry).moved(body.pose)


def _between(a: Capsule, b: Capsule) -> Any:
    return capsule_distance(a.a, a.b, a.radius, b.a, b.b, b.radius)


def _to_obstacle(body: Capsule, obstacle: Body) -> list[Any]:
    """Return distances [m] of a world capsule to an obstacle, the least of which bounds the true one from below."""
    if not isinstance(obstacle.geometry, coal.Box):
        return [_between(body, _capsule(obstacle))]
    R, p = ca.SX(ca.DM(obstacle.pose[:3, :3])), ca.SX(ca.DM(obstacle.pose[:3, 3]))
    half = ca.SX(ca.DM(np.array(obstacle.geometry.halfSide)))
    count = 1 + math.ceil(body.length / max(body.radius, SPACING))
    radius = math.hypot(body.radius, body.length / max(count - 1, 1) / 2)
    centers = [body.a + k / max(count - 1, 1) * (body.b - body.a) for k in range(count)]
    return [point_box_distance(R.T @ (center - p), half) - radius for center in centers]
