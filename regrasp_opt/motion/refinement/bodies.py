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

    `function` gives a column of M distances [m], `names` are the two bodies of each row, `measured` (M,) says which
    rows count for the least clearance of a plan (the others are self-collision), `required` (M,) is the clearance that
    was taken off each row [m].
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
    geometry.computeLocalAABB()
    low, high = np.array(geometry.aabb_local.min_), np.array(geometry.aabb_local.max_)
    center, half = (low + high) / 2, (high - low) / 2
    longest = int(np.argmax(half))
    end = np.where(np.arange(3) == longest, half, 0.0)
    radius = float(np.linalg.norm(np.delete(half, longest)))
    return Capsule(name, center - end, center + end, radius, 2 * float(half[longest]))


def configuration_rows(problem: RegraspProblem) -> Rows:
    """Return the distances of arm and gripper, a function of ``q`` (dof,), ``T`` (4, 4) T_world_object, ``width``."""
    arm, world = problem.workcell.arm, problem.checker.world
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

    return _rows(world, ContactPhase.GRASP, capsules, {"q": q, "T": T, "width": width})


def object_rows(problem: RegraspProblem) -> Rows:
    """Return the distances of the object to obstacles and the robot's base, a function of ``T`` (4, 4)."""
    world, T = problem.checker.world, ca.SX.sym("T", 4, 4)
    capsules = {i: _capsule(world.bodies[i]) for i in (world.object, *world.still)}
    capsules[world.object] = capsules[world.object].moved(T)
    return _rows(world, ContactPhase.REST, capsules, {"T": T})


def _rows(world: CollisionWorld, phase: ContactPhase, capsules: dict[int, Capsule], inputs: dict[str, Any]) -> Rows:
    """Return the distances of the pairs of a phase, `capsules` being all bodies of these but obstacles and supports."""
    distances, names, measured, required = [], [], [], []
    for i, j, needed in world.pairs(phase):
        body, other = capsules[i], world.bodies[j]
        if j in world.supports:
            found = _to_support(body, world, j) if i in world.moving else []
        elif j in world.surroundings and j != world.object:
            found = _to_obstacle(body, other)
        else:
            found = [_between(body, capsules[j])]
        distances += [distance - needed for distance in found]
        names += [f"{body.name} and {other.name}"] * len(found)
        measured += [j in world.surroundings] * len(found)
        required += [needed] * len(found)
    column = ca.vertcat(*distances) if distances else ca.SX(0, 1)
    function = ca.Function("clearances", [*inputs.values()], [column], [*inputs], ["margin"])
    return Rows(function, tuple(names), np.array(measured, dtype=bool), np.array(required, dtype=float))


def _capsule(body: Body) -> Capsule:
    """Return a capsule around a body, in the frame of its joint."""
    return covering_capsule(body.name, body.geometry).moved(body.pose)


def _between(a: Capsule, b: Capsule) -> Any:
    return capsule_distance(a.a, a.b, a.radius, b.a, b.b, b.radius)


def _to_support(body: Capsule, world: CollisionWorld, index: int) -> list[Any]:
    """Return distances [m] of a world capsule to a support: to the plane of the only one, else to its body."""
    if len(world.workcell.supports) > 1:
        return _to_obstacle(body, world.bodies[index])
    T = world.workcell.table.T_world_support
    return [ca.dot(ca.DM(T[:3, 2]), end - ca.DM(T[:3, 3])) - body.radius for end in (body.a, body.b)]


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
