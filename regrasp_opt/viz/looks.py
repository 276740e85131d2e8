"""How robots and grippers look: the collision bodies, slimmed and rounded, in a few colours, body by body.

The moving bodies of a scene are numbered: the robot's joints 0 to dof-1, then the gripper's body, its two fingers, and
the object.
"""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import coal
import numpy as np

from regrasp_opt.conventions import FloatArray, translation
from regrasp_opt.end_effectors import EndEffector
from regrasp_opt.robots import Robot
from regrasp_opt.viz.surfaces import Patch, coal_surface, merged, rounded_cylinder, shape_surface

COLOURS = {
    "arm": "#dfe3e8",
    "joint": "#5b6673",
    "gripper": "#3f4752",
    "finger": "#7d8896",
    "object": "#e69f00",
    "table": "#f3f1ec",
    "obstacle": "#9aa4b0",
    "start": "#0072b2",
    "goal": "#009e73",
    "intermediate": "#cc79a7",
    "chosen": "#d61a1a",
}
"""Colours of the parts of a scene; those of object and poses can be told apart by colour-blind people."""

BASE = -1
SLENDER = 1.9
"""Cylinders longer than this times their diameter are drawn as tubes between joints, slimmer than they collide."""


class Part(NamedTuple):
    """A surface that moves with one body, or stands in the world frame at body ``BASE``."""

    name: str
    surface: Patch
    colour: str
    body: int


def robot_parts(robot: Robot, T_world_base: FloatArray) -> list[Part]:
    """Return the robot's parts; those of joint i in the frame of that joint, those of the base in the world."""
    found: dict[tuple[int, str], list[Patch]] = defaultdict(list)
    for item in robot.collision.geometryObjects:
        body = int(item.parentJoint) - 1
        T = item.placement.homogeneous if body != BASE else T_world_base @ item.placement.homogeneous
        for colour, surface in _rounded(item.geometry):
            found[body, colour].append(surface.placed(T))
    return [Part("robot", merged(surfaces), COLOURS[colour], body) for (body, colour), surfaces in found.items()]


def _rounded(geometry: object) -> list[tuple[str, Patch]]:
    if not isinstance(geometry, coal.Cylinder):
        return [("arm", coal_surface(geometry))]
    radius, length = float(geometry.radius), 2 * float(geometry.halfLength)
    if length > 2 * SLENDER * radius:
        return [("arm", rounded_cylinder(0.8 * radius, length, 0.0))]
    cap = rounded_cylinder(0.74 * radius, 0.008, 0.002)
    ends = [cap.placed(translation(0.0, 0.0, side * (length / 2 - 0.0025))) for side in (-1, 1)]
    return [("arm", rounded_cylinder(radius, length)), *(("joint", end) for end in ends)]


def gripper_parts(effector: EndEffector, first_body: int) -> list[Part]:
    """Return the parts of an end-effector: its body in the flange frame, and its fingers as they stand when closed."""
    body = merged([shape_surface(shape) for shape in effector.body])
    parts = [Part("gripper", body, COLOURS["gripper"], first_body)]
    boxes = effector.finger_boxes(0.0)
    half = len(boxes) // 2
    for number, side in enumerate((boxes[:half], boxes[half:])):
        if side:
            surface = merged([shape_surface(box) for box in side])
            parts.append(Part("gripper", surface, COLOURS["finger"], first_body + 1 + number))
    return parts


def body_poses(robot: Robot, T_world_base: FloatArray, q: FloatArray, width: FloatArray) -> FloatArray:
    """Return the poses (M, dof+3, 4, 4) of joints, gripper and fingers in the world.

    Parameters
    ----------
    q : (M, dof)
    width : (M,)
        Opening of the jaw [m].
    """
    flange = T_world_base @ robot.forward(q)
    fingers = []
    for side in (0.5, -0.5):
        shift = np.tile(np.eye(4), (len(q), 1, 1))
        shift[:, 1, 3] = side * width
        fingers.append(flange @ shift)
    return np.concatenate([T_world_base @ robot.link_transforms(q), np.stack([flange, *fingers], axis=1)], axis=1)


def grasp_mark(effector: EndEffector) -> Patch:
    """Return a small fork, or a cup for suction, that marks a grasp in the TCP frame."""
    if effector.kind == "suction":
        stem = rounded_cylinder(0.0025, 0.05, 0.001).placed(translation(0.0, 0.0, -0.026))
        return merged([stem, rounded_cylinder(0.009, 0.004, 0.001).placed(translation(0.0, 0.0, -0.002))])
    across = np.array([[1.0, 0, 0, 0], [0, 0, -1.0, 0], [0, 1.0, 0, 0], [0, 0, 0, 1.0]])
    reach, half = 0.03, 0.018
    bar = rounded_cylinder(0.002, 2 * half + 0.004, 0.001).placed(translation(0.0, 0.0, -reach) @ across)
    tines = [rounded_cylinder(0.002, reach, 0.001).placed(translation(0.0, y, -reach / 2)) for y in (-half, half)]
    return merged([bar, *tines, rounded_cylinder(0.002, 0.025, 0.001).placed(translation(0.0, 0.0, -reach - 0.0125))])
