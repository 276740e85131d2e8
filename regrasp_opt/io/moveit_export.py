"""The scenes of a motion for MoveIt: ``moveit_msgs/msg/PlanningScene`` in YAML, one document for each.

A scene is what is there while the arm rests at a grasp: the object where it stands, or in the hand. Poses are in the
frame of the robot's root link, those of attached bodies in the frame of the link that carries the tool. All names are
those of the robot's own file. Who may touch whom is what the collision world says, by which the motion was verified.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray, invert
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.io.ros_export import check_solved, write_yaml
from regrasp_opt.motion import MotionPlan, Phase, Segment
from regrasp_opt.scene.collision_world import CollisionWorld, ContactPhase, Pair

BOX, CYLINDER = 1, 3
"""Kinds of ``shape_msgs/msg/SolidPrimitive``."""


def save_moveit(motion: MotionPlan, path: str | os.PathLike[str]) -> None:
    """Write the planning scenes of `motion` to `path` as YAML, atomically (docs/other-programs.md).

    Raises
    ------
    PlanFileError
        If there is no motion.
    """
    write_yaml(planning_scenes(motion), path)


def planning_scenes(motion: MotionPlan) -> list[dict[str, Any]]:
    """Return the scenes: for each transition with the object at rest and in the hand, then at rest at the goal.

    Raises
    ------
    PlanFileError
        If there is no motion.
    """
    check_solved(motion)
    segments = [segment for segment in motion.segments if segment.phase in (Phase.GRASP, Phase.RELEASE)]
    scenes = []
    for segment in segments[::2]:
        name = f"transition {segment.transition}"
        scenes.append(_scene(motion, f"{name}, object at rest", segment, segment.transition))
        scenes.append(_scene(motion, f"{name}, object in the hand", segment, None))
    return [*scenes, _scene(motion, "object at the goal", segments[-1], -1)]


def _scene(motion: MotionPlan, name: str, jaw: Segment, at: int | None) -> dict[str, Any]:
    """Return the scene while the jaw moves, with the object in the hand or resting `at` the pose of this number."""
    problem, poses = motion.plan.problem, motion.plan.poses
    cell, arm, robot = problem.workcell, problem.workcell.arm, problem.workcell.arm.robot
    world, names = problem.checker.world, _names(problem.checker.world)
    shapes: list[Shape] = [*(shape for support in cell.supports for shape in support.shapes), *cell.obstacles]
    fixed = [(names[i], shape) for i, shape in zip((*world.supports, *world.obstacles), shapes, strict=True)]
    body = Mesh(names[world.object], problem.object.vertices, problem.object.faces, np.eye(4))
    tool = (*arm.end_effector.body, *arm.end_effector.finger_boxes(min(jaw.jaw) if at is None else max(jaw.jaw)))
    attached = [_collision_object(names[world.gripper[0]], robot.mount, robot.T_mount_tip, tool)]
    if at is None:
        T_tip_object = arm.end_effector.T_flange_tcp @ invert(problem.grasps.T_object_tcp[jaw.grasp_id])
        attached.append(_collision_object(body.name, robot.mount, robot.T_mount_tip @ T_tip_object, [body]))
        ends = [problem.checker.support_below(T) for T in poses[jaw.transition : jaw.transition + 2]]
        pairs = set(world.pairs(ContactPhase.LIFT, ends[0])) & set(world.pairs(ContactPhase.LIFT, ends[1]))
    else:
        fixed.append((body.name, replace(body, pose=poses[at])))
        pairs = set(world.pairs(ContactPhase.MOVE))
    root = str(robot.model.frames[1].name)
    last = [f.name for f in robot.model.frames if f.type == pin.FrameType.BODY and f.parentJoint == robot.dof]
    touched = [name for name in last if name == robot.mount or name != robot.tip_frame]
    joints = dict(zip(robot.joint_names, jaw.trajectory.positions[0].tolist(), strict=True)) | robot.locked
    return {
        "name": name,
        "robot_state": {
            "joint_state": {"name": list(joints), "position": list(joints.values())},
            "attached_collision_objects": [
                {"link_name": robot.mount, "object": each, "touch_links": touched} for each in attached
            ],
        },
        "robot_model_name": robot.name,
        "allowed_collision_matrix": _allowed(names, pairs),
        "world": {
            "collision_objects": [
                _collision_object(name, root, arm.T_base_world @ shape.pose, [replace(shape, pose=np.eye(4))])
                for name, shape in fixed
            ]
        },
        "is_diff": False,
    }


def _names(world: CollisionWorld) -> list[str]:
    """Return what each body is called: its link, gripper and object, and one name for each shape of the cell."""
    names = [body.label for body in world.bodies]
    taken = {str(frame.name) for frame in world.workcell.arm.robot.model.frames}
    for i in (*world.supports, *world.obstacles, world.gripper[0], world.object):
        names[i] = "gripper" if i == world.gripper[0] else names[i]
        while names[i] in taken:
            names[i] += "_"
        taken.add(names[i])
    for i in world.gripper:
        names[i] = names[world.gripper[0]]
    return names


def _allowed(names: list[str], pairs: set[Pair]) -> dict[str, Any]:
    """Return the matrix of who may touch whom: all but `pairs`, which are kept apart."""
    apart = {frozenset((names[i], names[j])) for i, j, _ in pairs}
    entries = list(dict.fromkeys(names))
    rows = [[frozenset((a, b)) not in apart for b in entries] for a in entries]
    return {"entry_names": entries, "entry_values": [{"enabled": row} for row in rows]}


def _collision_object(name: str, frame: str, T: FloatArray, shapes: Sequence[Shape]) -> dict[str, Any]:
    """Return a collision object at `T` (4, 4) in `frame`, of `shapes` in its own frame."""
    solids = [shape for shape in shapes if not isinstance(shape, Mesh)]
    meshes = [shape for shape in shapes if isinstance(shape, Mesh)]
    parts: dict[str, Any] = {}
    if solids:
        parts |= {"primitives": [_solid(s) for s in solids], "primitive_poses": [_pose(s.pose) for s in solids]}
    if meshes:
        parts |= {"meshes": [_mesh(mesh) for mesh in meshes], "mesh_poses": [_pose(mesh.pose) for mesh in meshes]}
    return {"header": {"frame_id": frame}, "pose": _pose(T), "id": name, **parts, "operation": 0}


def _solid(shape: Box | Cylinder) -> dict[str, Any]:
    if isinstance(shape, Box):
        return {"type": BOX, "dimensions": np.asarray(shape.size, dtype=np.float64).tolist()}
    return {"type": CYLINDER, "dimensions": [float(shape.length), float(shape.radius)]}


def _mesh(mesh: Mesh) -> dict[str, Any]:
    return {
        "triangles": [{"vertex_indices": face} for face in mesh.faces.tolist()],
        "vertices": [_point(vertex) for vertex in mesh.vertices],
    }


def _pose(T: FloatArray) -> dict[str, Any]:
    turn = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return {"position": _point(T[:3, 3]), "orientation": dict(zip("xyzw", turn, strict=True))}


def _point(p: FloatArray) -> dict[str, float]:
    return dict(zip("xyz", p.tolist(), strict=True))
