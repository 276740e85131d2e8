r"""A motion for MuJoCo: a folder with one model of cell, arm, gripper and object, and what its actuators are told.

``model.xml`` is MJCF. The arm consists of the joints from base to tip, with the collision bodies of its links; a
position servo moves each joint, and another the jaw, whose fingers an equality keeps symmetric. Bodies are convex to
MuJoCo: what is not is split by approximate convex decomposition (Wei, Liu, Ling and Su, 2022).

A servo of stiffness :math:`I \omega^2` and damping :math:`2 I \omega`, with :math:`I` the largest inertia about the
joint along the motion, follows with a delay of :math:`2 / \omega`, the same for all joints, so that the arm stays on
its path.
"""

from __future__ import annotations

import csv
import os
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray, translation
from regrasp_opt.errors import OptionError
from regrasp_opt.files import atomic_path, exchanged_files
from regrasp_opt.geometry.shapes import Cylinder, Shape, mesh_faces, shape_geometry, surface_points
from regrasp_opt.io.ros_export import GRIP_FORCE, check_solved
from regrasp_opt.motion import MotionPlan
from regrasp_opt.motion.trajectory.scene_export import mass_properties, xml_names
from regrasp_opt.robots import Robot

OWN = {"world", "gripper", "left_finger", "right_finger", "cup", "object"}
"""Names of bodies that are not links of the robot."""

TOLD = {"left_finger_joint", "right_finger_joint", "object", "jaw", "vacuum", "time", "transition", "phase"}
"""Names of joints, actuators and columns of the trajectory that are not joints of the robot."""

STEP = 0.01
"""Time between rows of the trajectory [s]."""

BANDWIDTH = 100.0
"""Of the servos [rad/s]."""

ROTOR = 0.1
"""Inertia of each motor behind its gear [kg m^2; kg for one that slides]."""

JAW_STIFFNESS, JAW_DAMPING = 2e4, 200.0
"""Of the servo of the jaw [N/m, N s/m]."""

GRIPPER_DENSITY = 1000.0
"""Density of the gripper's bodies [kg/m^3]: no file states their masses."""

CONCAVITY = 0.02
"""How far the convex parts of an object may depart from it, as a share of half its size."""

SUCTION = 6e4
"""Difference of pressure under a cup [Pa]."""

COMPILER = {"angle": "radian", "balanceinertia": "true", "boundmass": "1e-6", "boundinertia": "1e-9"}
"""Inertias in URDF files are often zero, or those of no body."""

OPTIONS = {
    "timestep": "0.001",
    "integrator": "implicitfast",
    "cone": "elliptic",
    "impratio": "10",
    "noslip_iterations": "3",
}
CONTACT = {"condim": "4", "friction": "0.5 0.005 0.0001", "solref": "0.002 1", "solimp": "0.95 0.99 0.001"}
"""How the solver treats contacts; docs/other-programs.md says what was tried."""

GROUPS = {
    "arm": {"contype": "1", "conaffinity": "0", "density": f"{GRIPPER_DENSITY:g}"},
    "lip": {"contype": "1", "conaffinity": "0", "density": f"{GRIPPER_DENSITY:g}", "margin": "0.001", "gap": "0.001"},
    "cell": {"contype": "0", "conaffinity": "3"},
    "object": {"contype": "2", "conaffinity": "3"},
}
"""Bodies of the arm meet the cell and the object, but not each other."""


def save_mjcf(motion: MotionPlan, folder: str | os.PathLike[str]) -> None:
    """Write `motion` for MuJoCo into `folder`, all files at once (docs/other-programs.md).

    Raises
    ------
    PlanFileError
        If there is no motion.
    OptionError
        If the object is not convex and the package ``coacd`` is not installed.
    """
    check_solved(motion)
    with exchanged_files(Path(folder), "model.xml") as fresh:
        root = _Model(motion, fresh).root
        ET.indent(root)
        with atomic_path(fresh / "model.xml") as temporary:
            ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
        with atomic_path(fresh / "trajectory.csv") as temporary:
            _write_trajectory(motion, temporary)


class _Model:
    """The model of a motion; meshes go into `folder` as they are met."""

    def __init__(self, motion: MotionPlan, folder: Path) -> None:
        self._motion, self._problem, self._folder = motion, motion.plan.problem, folder
        self.root = ET.Element("mujoco", model=xml_names([self._problem.workcell.name])[0])
        ET.SubElement(self.root, "compiler", COMPILER)
        ET.SubElement(ET.SubElement(self.root, "option", OPTIONS), "flag", multiccd="enable")
        default = ET.SubElement(self.root, "default")
        ET.SubElement(default, "geom", CONTACT)
        for group, about in GROUPS.items():
            ET.SubElement(ET.SubElement(default, "default", {"class": group}), "geom", about)
        self._asset = ET.SubElement(self.root, "asset")
        self._world = ET.SubElement(self.root, "worldbody")
        ET.SubElement(self._world, "light", pos="0 0 3", dir="0 0 -1")
        self._tendon, self._equality = (ET.SubElement(self.root, tag) for tag in ("tendon", "equality"))
        self._actuator = ET.SubElement(self.root, "actuator")
        cell = self._problem.workcell
        for shape in (*(shape for support in cell.supports for shape in support.shapes), *cell.obstacles):
            self._add(self._world, shape, "cell")
        palm = self._arm()
        suction = cell.arm.end_effector.kind == "suction"
        (self._cup if suction else self._jaw)(palm)
        self._object()
        first, T = motion.segments[0], motion.plan.poses[0]
        q, fingers = first.trajectory.positions[0], [] if suction else [first.jaw[0] / 2] * 2
        state = [*q, *fingers, *T[:3, 3], *_quaternion(T)]
        key = {"name": "start", "qpos": _text(state), "ctrl": _text([*q, first.jaw[0]])}
        ET.SubElement(ET.SubElement(self.root, "keyframe"), "key", key)

    def _arm(self) -> ET.Element:
        """Add the arm, its servos, and what of its tool does not move; return the body of that."""
        arm, robot = self._problem.workcell.arm, self._problem.workcell.arm.robot
        chain, stiffness = robot.chain, _inertias(self._motion) * BANDWIDTH**2
        links = _links(robot)
        body = ET.SubElement(self._world, "body", {"name": links[0], **_place(arm.T_world_base)})
        self._collision_bodies(body, 0)
        for number, name in enumerate(_joints(robot), start=1):
            T, inertia = chain.placements[number - 1], robot.model.inertias[number]
            body = ET.SubElement(body, "body", {"name": links[number], "gravcomp": "1", **_place(T)})
            _inertial(body, inertia.mass, inertia.lever, inertia.inertia)
            limits = robot.lower[number - 1], robot.upper[number - 1]
            kind = "slide" if chain.prismatic[number - 1] else "hinge"
            about = {"name": name, "type": kind, "axis": _text(chain.axes[number - 1]), "range": _text(limits)}
            ET.SubElement(body, "joint", about, armature=str(ROTOR))
            self._collision_bodies(body, number)
            k = float(stiffness[number - 1])
            ET.SubElement(
                self._actuator, "position", name=name, joint=name, kp=f"{k:.6g}", kv=f"{2 * k / BANDWIDTH:.6g}"
            )
        palm = ET.SubElement(body, "body", {"name": "gripper", "gravcomp": "1", **_place(chain.tip)})
        for shape in arm.end_effector.body:
            self._add(palm, shape, "arm")
        return palm

    def _collision_bodies(self, body: ET.Element, joint: int) -> None:
        for item in self._problem.workcell.arm.robot.collision.geometryObjects:
            if item.parentJoint == joint:
                self._geometry(body, item.geometry, item.placement.homogeneous, "arm")

    def _jaw(self, palm: ET.Element) -> None:
        """Add two fingers with a servo for the opening between them, and an equality that keeps them symmetric."""
        effector = self._problem.workcell.arm.end_effector
        tendon = ET.SubElement(self._tendon, "fixed", name="jaw")
        boxes, names = effector.finger_boxes(0.0), ("left_finger", "right_finger")
        for name, axis, side in zip(names, ("0 1 0", "0 -1 0"), np.split(np.arange(len(boxes)), 2), strict=True):
            finger = ET.SubElement(palm, "body", name=name, gravcomp="1")
            slide = {"type": "slide", "axis": axis, "range": _text([0.0, effector.max_opening / 2])}
            ET.SubElement(finger, "joint", {"name": f"{name}_joint", **slide}, armature=str(ROTOR))
            for index in side:
                self._add(finger, boxes[index], "arm")
            ET.SubElement(tendon, "joint", joint=f"{name}_joint", coef="1")
        joints = {f"joint{k}": f"{name}_joint" for k, name in enumerate(names, start=1)}
        ET.SubElement(self._equality, "joint", joints, polycoef="0 1 0 0 0", solref="0.002 1")
        force = self._motion.squeeze.force or GRIP_FORCE
        servo = {"kp": f"{JAW_STIFFNESS:g}", "kv": f"{JAW_DAMPING:g}", "forcerange": f"{-force:g} {force:g}"}
        ET.SubElement(self._actuator, "position", {"name": "jaw", "tendon": "jaw", **servo})

    def _cup(self, palm: ET.Element) -> None:
        """Add the lip of a suction cup, which reaches to the TCP, and the vacuum."""
        effector = self._problem.workcell.arm.end_effector
        top = max(float(surface_points(shape)[:, 2].max()) for shape in effector.body)
        height = effector.tcp_offset - top
        cup = ET.SubElement(palm, "body", name="cup", gravcomp="1")
        pose = translation(0.0, 0.0, top + height / 2)
        self._add(cup, Cylinder("lip", effector.cup_radius, height, pose), "lip")
        force = {"gain": f"{SUCTION * np.pi * effector.cup_radius**2:.6g}", "ctrlrange": "0 1"}
        ET.SubElement(self._actuator, "adhesion", {"name": "vacuum", "body": "cup", **force})

    def _object(self) -> None:
        poses, model = self._motion.plan.poses, self._problem.object
        body = ET.SubElement(self._world, "body", {"name": "object", **_place(poses[0])})
        ET.SubElement(body, "freejoint", name="object")
        mass, inertia = mass_properties(model)
        _inertial(body, mass, model.center_of_mass, inertia)
        self._mesh(body, model.mesh, np.eye(4), "object")
        for number, T in enumerate(poses):
            ET.SubElement(self._world, "site", {"name": f"pose{number}", "size": "0.005", **_place(T)})

    def _add(self, body: ET.Element, shape: Shape, group: str) -> None:
        self._geometry(body, shape_geometry(shape), shape.pose, group)

    def _geometry(self, body: ET.Element, geometry: Any, T: FloatArray, group: str) -> None:
        """Add a Coal geometry at `T` (4, 4)."""
        if isinstance(geometry, coal.Box):
            kind, size = "box", list(geometry.halfSide)
        elif isinstance(geometry, coal.Sphere):
            kind, size = "sphere", [geometry.radius]
        elif isinstance(geometry, (coal.Cylinder, coal.Capsule)):
            kind, size = type(geometry).__name__.lower(), [geometry.radius, geometry.halfLength]
        else:
            self._mesh(body, trimesh.Trimesh(geometry.vertices(), mesh_faces(geometry)), T, group)
            return
        ET.SubElement(body, "geom", {"class": group, "type": kind, "size": _text(size), **_place(T)})

    def _mesh(self, body: ET.Element, mesh: trimesh.Trimesh, T: FloatArray, group: str) -> None:
        """Add a mesh at `T` (4, 4), in convex parts unless it belongs to the arm, whose links become their hulls."""
        for part in [mesh] if group == "arm" else convex_parts(mesh):
            name = f"mesh{len(self._asset)}"
            with atomic_path(self._folder / f"{name}.obj") as temporary:
                part.export(temporary, digits=12, header=None)
            ET.SubElement(self._asset, "mesh", name=name, file=f"{name}.obj", inertia="convex")
            ET.SubElement(body, "geom", {"class": group, "type": "mesh", "mesh": name, **_place(T)})


def convex_parts(mesh: trimesh.Trimesh) -> list[trimesh.Trimesh]:
    """Return `mesh` if it is convex, else convex solids that together are nearly `mesh`.

    Raises
    ------
    OptionError
        If it is not convex and the package ``coacd`` is not installed.
    """
    if mesh.is_convex:
        return [mesh]
    try:
        import coacd
    except ImportError as error:
        raise OptionError(
            "an object that is not convex needs the package 'coacd' for MuJoCo; install regrasp-opt[mujoco]"
        ) from error
    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(np.array(mesh.vertices), np.array(mesh.faces)), threshold=CONCAVITY, seed=0)
    return [trimesh.Trimesh(vertices, faces).convex_hull for vertices, faces in parts]


def _inertias(motion: MotionPlan) -> FloatArray:
    """Return the largest inertia about each joint along the motion (dof,) with motors and object [kg m^2, kg]."""
    problem, arm = motion.plan.problem, motion.plan.problem.workcell.arm
    tcp = (arm.robot.chain.tip @ arm.end_effector.T_flange_tcp)[:3, 3]
    model = arm.robot.model.copy()
    load = pin.Inertia(mass_properties(problem.object)[0], tcp, np.zeros((3, 3)))
    model.appendBodyToJoint(arm.robot.dof, load, pin.SE3.Identity())
    data, found = model.createData(), np.zeros(model.nv)
    for segment in motion.segments:
        for q in segment.trajectory.positions:
            found = np.maximum(found, np.diag(pin.crba(model, data, q)))
    return found + ROTOR


def _write_trajectory(motion: MotionPlan, path: Path) -> None:
    """Write what each actuator is told, by its name, with the phase and number of the transition."""
    arm = motion.plan.problem.workcell.arm
    names = *_joints(arm.robot), "jaw" if arm.end_effector.kind == "parallel" else "vacuum"
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["time", "transition", "phase", *names])
        for segment, start in zip(motion.segments, motion.starts.tolist(), strict=True):
            trajectory, last = segment.trajectory, segment is motion.segments[-1]
            t = np.linspace(0.0, trajectory.duration, max(2, round(trajectory.duration / STEP) + 1))
            grip = np.interp(start + t, *_grip(motion))
            rows = np.column_stack([start + t, trajectory.at(t), grip])[: None if last else -1]
            about = segment.transition, segment.phase.name.lower()
            writer.writerows([f"{time:.9g}", *about, *(f"{x:.12g}" for x in row)] for time, *row in rows.tolist())


def _grip(motion: MotionPlan) -> tuple[list[float], list[float]]:
    """Return times [s] and what the servo of the jaw [m], or the vacuum, is told then; in between evenly."""
    suction = motion.plan.problem.workcell.arm.end_effector.kind == "suction"
    times, told = [0.0], [0.0 if suction else motion.jaw_events[0].command]
    for event in motion.jaw_events[1:]:
        times += [event.time, event.time + event.duration]
        told += [told[-1], float(event.holds) if suction else event.command]
    return times, told


def _links(robot: Robot) -> list[str]:
    """Return the name of the first link that moves with each joint, from the base on, unlike those that are `OWN`."""
    links = {int(f.parentJoint): str(f.name) for f in reversed(robot.model.frames) if f.type == pin.FrameType.BODY}
    return xml_names((links[joint] for joint in range(robot.dof + 1)), OWN)


def _joints(robot: Robot) -> list[str]:
    """Return what the joints and their actuators are called."""
    return xml_names(robot.joint_names, TOLD)


def _inertial(body: ET.Element, mass: float, center: Any, inertia: FloatArray) -> None:
    cells = [inertia[cell] for cell in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    ET.SubElement(body, "inertial", pos=_text(center), mass=_text([mass]), fullinertia=_text(cells))


def _place(T: FloatArray) -> dict[str, str]:
    return {"pos": _text(T[:3, 3]), "quat": _text(_quaternion(T))}


def _quaternion(T: FloatArray) -> FloatArray:
    quaternion: FloatArray = np.roll(Rotation.from_matrix(T[:3, :3]).as_quat(), 1)
    return quaternion


def _text(values: Sequence[float] | FloatArray) -> str:
    return " ".join(f"{value:.15g}" for value in values)
