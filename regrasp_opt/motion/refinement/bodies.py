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
from regrasp_opt.geometry.shapes import Shape, mesh_geometry, shape_geometry
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.robots import Robot
from regrasp_opt.robots.casadi_distances import capsule_distance, point_box_distance
from regrasp_opt.robots.casadi_kinematics import joint_placements
from regrasp_opt.scene.pairs import arm_pairs

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
    cell = problem.workcell
    robot, effector, clearance, near = cell.arm.robot, cell.arm.end_effector, cell.clearance, arm_pairs(cell)
    q, T, width = ca.SX.sym("q", robot.dof), ca.SX.sym("T", 4, 4), ca.SX.sym("width")
    T_world_base = ca.SX(ca.DM(cell.arm.T_world_base))
    T_joint = [T_world_base @ placement for placement in joint_placements(robot.model, q)]
    arm, joints = _arm_capsules(robot)
    arm = [capsule.moved(T_joint[joint]) for capsule, joint in zip(arm, joints, strict=True)]
    tip = robot.model.frames[robot.model.getFrameId(robot.tip_frame)]
    T_world_flange = T_joint[tip.parentJoint] @ ca.SX(ca.DM(tip.placement.homogeneous))
    gripper = [_of_shape(shape).moved(T_world_flange) for shape in effector.body]
    fingers = effector.finger_boxes(0.0, effector.pre_opening)
    for number, shape in enumerate(fingers):
        capsule = _of_shape(shape)
        aside = ca.vertcat(0, (0.5 if number < len(fingers) / 2 else -0.5) * width, 0)
        gripper.append(capsule._replace(a=capsule.a + aside, b=capsule.b + aside).moved(T_world_flange))
    moving = [capsule for capsule, joint in zip(arm, joints, strict=True) if joint > 0]
    held = covering_capsule("object", mesh_geometry(problem.object.vertices, problem.object.faces)).moved(T)

    rows: list[tuple[Any, str, bool, float]] = []
    for body in moving:
        for end in (body.a, body.b):
            rows.append((end[2] - body.radius - cell.table.height, f"{body.name} and table", True, clearance.arm))
        rows.append((_between(body, held), f"{body.name} and object", True, clearance.arm))
    for bodies, needed in ((moving, clearance.arm), (gripper, clearance.gripper)):
        for body in bodies:
            for obstacle in map(_solid, cell.obstacles):
                name = f"{body.name} and {obstacle.name}"
                rows += [(distance, name, True, needed) for distance in _to_obstacle(body, obstacle)]
    still = _own_obstacles(problem)
    for a, j, needed in [(a, j, c) for a in gripper for j, c in near.tool] + [(arm[i], j, c) for i, j, c in near.links]:
        distances = _to_obstacle(a, still[j]) if j in still else [_between(a, arm[j])]
        rows += [(distance, f"{a.name} and {arm[j].name}", j in still, needed) for distance in distances]
    return _rows("clearances", [q, T, width], ["q", "T", "width"], rows)


def object_rows(problem: RegraspProblem) -> Rows:
    """Return the distances of the object to obstacles and the robot's base, a function of ``T`` (4, 4)."""
    cell = problem.workcell
    T = ca.SX.sym("T", 4, 4)
    held = covering_capsule("object", mesh_geometry(problem.object.vertices, problem.object.faces)).moved(T)
    T_world_base = ca.SX(ca.DM(cell.arm.T_world_base))
    capsules, joints = _arm_capsules(cell.arm.robot)
    needed, still = cell.clearance.gripper, _own_obstacles(problem)
    base = [c.moved(T_world_base) for i, c in enumerate(capsules) if joints[i] == 0 and i not in still]
    rows = [(_between(held, body), f"object and {body.name}", False, needed) for body in base]
    for obstacle in (*still.values(), *map(_solid, cell.obstacles)):
        rows += [(d, f"object and {obstacle.name}", False, needed) for d in _to_obstacle(held, obstacle)]
    return _rows("object_clearances", [T], ["T"], rows)


def _rows(name: str, inputs: list[Any], labels: list[str], rows: list[tuple[Any, str, bool, float]]) -> Rows:
    column = ca.vertcat(*[distance - needed for distance, _, _, needed in rows]) if rows else ca.SX(0, 1)
    function = ca.Function(name, inputs, [column], labels, ["margin"])
    measured, required = np.array([row[2] for row in rows], dtype=bool), np.array([row[3] for row in rows], dtype=float)
    return Rows(function, tuple(row[1] for row in rows), measured, required)


def _arm_capsules(robot: Robot) -> tuple[list[Capsule], list[int]]:
    """Return a capsule around each collision body, in its joint's frame, and the joint; 0 is the base."""
    bodies = robot.collision.geometryObjects
    capsules = [covering_capsule(body.name, body.geometry).moved(body.placement.homogeneous) for body in bodies]
    return capsules, [int(body.parentJoint) for body in bodies]


def _of_shape(shape: Shape) -> Capsule:
    return covering_capsule(f"gripper {shape.name}", shape_geometry(shape)).moved(shape.pose)


def _between(a: Capsule, b: Capsule) -> Any:
    return capsule_distance(a.a, a.b, a.radius, b.a, b.b, b.radius)


class _Solid(NamedTuple):
    name: str
    geometry: Any
    pose: FloatArray


def _solid(shape: Shape) -> _Solid:
    return _Solid(shape.name, shape_geometry(shape), shape.pose)


def _own_obstacles(problem: RegraspProblem) -> dict[int, _Solid]:
    """Return the bodies of the robot that count as obstacles, in the world, by their index."""
    cell = problem.workcell
    items = {i: cell.arm.robot.collision.geometryObjects[i] for i in sorted(cell.arm.robot.obstacles)}
    poses = {i: cell.arm.T_world_base @ item.placement.homogeneous for i, item in items.items()}
    return {i: _Solid(item.name, item.geometry, poses[i]) for i, item in items.items()}


def _to_obstacle(body: Capsule, obstacle: _Solid) -> list[Any]:
    """Return distances [m] of a world capsule to an obstacle, the least of which bounds the true one from below."""
    if not isinstance(obstacle.geometry, coal.Box):
        return [_between(body, covering_capsule(obstacle.name, obstacle.geometry).moved(obstacle.pose))]
    R, p = ca.SX(ca.DM(obstacle.pose[:3, :3])), ca.SX(ca.DM(obstacle.pose[:3, 3]))
    half = ca.SX(ca.DM(np.array(obstacle.geometry.halfSide)))
    count = 1 + math.ceil(body.length / max(body.radius, SPACING))
    radius = math.hypot(body.radius, body.length / max(count - 1, 1) / 2)
    centers = [body.a + k / max(count - 1, 1) * (body.b - body.a) for k in range(count)]
    return [point_box_distance(R.T @ (center - p), half) - radius for center in centers]
