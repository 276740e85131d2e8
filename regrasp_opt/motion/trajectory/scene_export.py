"""A plan's scene for other simulators: robot, gripper, surroundings and object as URDF, their places as JSON."""

from __future__ import annotations

import json
import logging
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray, invert, rpy_angles
from regrasp_opt.files import atomic_path, exchanged_files
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning import RegraspPlan
from regrasp_opt.robots import Robot
from regrasp_opt.robots.urdf import parse_xml

logger = logging.getLogger(__name__)

SCHEMA = 1

DENSITY = 500.0
"""Density of an object of unknown mass in its URDF [kg/m^3]: a stand-in, since nothing else here depends on masses."""

FORBIDDEN = re.compile("[^\\x20-\\ud7ff\\ue000-\\ufffd\\U00010000-\\U0010ffff]")
"""What no name in an XML file can hold."""


def xml_names(names: Iterable[str], taken: Iterable[str] = ()) -> list[str]:
    """Return `names` as XML can hold them, each unlike the others and those `taken`: underscores do both."""
    found, used = list[str](), set(taken)
    for name in names:
        name = FORBIDDEN.sub("_", name)
        while name in used:
            name += "_"
        used.add(name)
        found.append(name)
    return found


def save_scene(plan: RegraspPlan, folder: str | os.PathLike[str]) -> None:
    """Write the scene of `plan` into `folder`, all files at once.

    All names of meshes are absolute. ``robot.urdf`` is the robot as the workcell has it; ``gripper.urdf`` has a
    prismatic joint for each finger, whose position is half the opening; ``surroundings.urdf`` holds table and obstacles
    in the world frame; ``object.urdf`` and ``object.stl`` are the object. ``scene.json`` says how they are put together
    and where the object stands.
    """
    folder, meshes = Path(folder).resolve(), dict[Path, Mesh]()
    problem = plan.problem
    cell, robot = problem.workcell, problem.workcell.arm.robot
    fixed = [*(shape for support in cell.supports for shape in support.shapes), *cell.obstacles]
    files = {
        "robot.urdf": _robot(robot),
        "gripper.urdf": _gripper(plan, folder, meshes),
        "surroundings.urdf": _surroundings(fixed, folder, meshes),
        "object.urdf": _object(problem.object, folder),
    }
    meshes[folder / "object.stl"] = Mesh("object", problem.object.vertices, problem.object.faces, np.eye(4))
    content = {
        "schema": SCHEMA,
        "joint_names": list(robot.joint_names),
        "flange_link": robot.tip_frame,
        "T_world_base": cell.arm.T_world_base.tolist(),
        "T_flange_gripper": np.eye(4).tolist(),
        "T_gripper_tcp": cell.arm.end_effector.T_flange_tcp.tolist(),
        "home": robot.home.tolist(),
        "object_poses": plan.poses.tolist(),
        "object_in_hand": [
            {"grasp_id": g, "T_tcp_object": invert(problem.grasps.T_object_tcp[g]).tolist()}
            for g in sorted({int(g) for t in plan.transitions for g in t.grasp_ids})
        ],
    }
    with exchanged_files(folder, "scene.json") as fresh:
        for name, root in files.items():
            _write_xml(root, fresh / name)
        for path, mesh in meshes.items():
            _write_mesh(mesh, fresh / path.name)
        with atomic_path(fresh / "scene.json") as temporary:
            temporary.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")


def _robot(robot: Robot) -> ET.Element:
    """Return the robot's URDF with absolute mesh names, less visuals without their mesh and what xacro left behind."""
    root = parse_xml(robot.urdf)
    for parent in list(root.iter()):
        for child in [child for child in parent if ":" in child.tag]:
            parent.remove(child)
    root.attrib.setdefault("name", *xml_names([robot.name]))
    for link in root.iterfind("link"):
        for visual in link.findall("visual"):
            lost = [m.get("filename", "") for m in visual.iter("mesh") if not os.path.isfile(m.get("filename", ""))]
            if lost:
                logger.warning("mesh '%s' of %s is not found; robot.urdf goes without it", lost[0], robot.urdf_path)
                link.remove(visual)
    return root


def _gripper(plan: RegraspPlan, folder: Path, meshes: dict[Path, Mesh]) -> ET.Element:
    effector = plan.problem.workcell.arm.end_effector
    root = ET.Element("robot", name=xml_names([effector.name])[0])
    palm = ET.SubElement(root, "link", name="gripper")
    for number, shape in enumerate(effector.body):
        _add_shape(palm, shape, folder / f"gripper-{number}.stl", meshes)
    for side, sign in (("left", 1.0), ("right", -1.0)) if effector.finger else ():
        link = ET.SubElement(root, "link", name=f"{side}_finger")
        shapes = effector.finger_boxes(0.0)
        half = len(shapes) // 2
        for number, shape in enumerate(shapes[:half] if sign > 0 else shapes[half:]):
            _add_shape(link, shape, folder / f"{side}_finger-{number}.stl", meshes)
        joint = ET.SubElement(root, "joint", name=f"{side}_finger_joint", type="prismatic")
        ET.SubElement(joint, "parent", link="gripper")
        ET.SubElement(joint, "child", link=f"{side}_finger")
        ET.SubElement(joint, "axis", xyz=f"0 {sign:g} 0")
        limits = {"lower": "0", "upper": f"{effector.max_opening / 2:.9g}", "velocity": "0.1", "effort": "50"}
        ET.SubElement(joint, "limit", limits)
    return root


def _surroundings(shapes: list[Shape], folder: Path, meshes: dict[Path, Mesh]) -> ET.Element:
    root = ET.Element("robot", name="surroundings")
    ET.SubElement(root, "link", name="world")
    names = xml_names((shape.name for shape in shapes), ["world"])
    for number, (name, shape) in enumerate(zip(names, shapes, strict=True)):
        link = ET.SubElement(root, "link", name=name)
        _add_shape(link, shape, folder / f"surrounding-{number}.stl", meshes)
        joint = ET.SubElement(root, "joint", name=f"world_to_{name}", type="fixed")
        ET.SubElement(joint, "parent", link="world")
        ET.SubElement(joint, "child", link=name)
    return root


def mass_properties(model: ObjectModel) -> tuple[float, FloatArray]:
    """Return mass [kg] and inertia (3, 3) about the centre of mass [kg m^2]: what was given, else at `DENSITY`."""
    if model.mass is not None and model.inertia is not None:
        return model.mass, model.inertia
    return float(model.mesh.volume) * DENSITY, model.mesh.moment_inertia * DENSITY


def _object(model: ObjectModel, folder: Path) -> ET.Element:
    root = ET.Element("robot", name="object")
    link = ET.SubElement(root, "link", name="object")
    mass, inertia = mass_properties(model)
    inertial = ET.SubElement(link, "inertial")
    ET.SubElement(inertial, "origin", xyz=_numbers(model.center_of_mass), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=f"{mass:.9g}")
    cells = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    ET.SubElement(inertial, "inertia", {name: f"{inertia[cell]:.9g}" for name, cell in cells.items()})
    for tag in ("visual", "collision"):
        ET.SubElement(ET.SubElement(ET.SubElement(link, tag), "geometry"), "mesh", filename=str(folder / "object.stl"))
    return root


def _add_shape(link: ET.Element, shape: Shape, path: Path, meshes: dict[Path, Mesh]) -> None:
    """Add `shape` to `link`; if it is a mesh, its file is to be `path`, and it goes to `meshes`."""
    for tag in ("visual", "collision"):
        part = ET.SubElement(link, tag)
        ET.SubElement(part, "origin", xyz=_numbers(shape.pose[:3, 3]), rpy=_numbers(rpy_angles(shape.pose[:3, :3])))
        geometry = ET.SubElement(part, "geometry")
        if isinstance(shape, Box):
            ET.SubElement(geometry, "box", size=_numbers(shape.size))
        elif isinstance(shape, Cylinder):
            ET.SubElement(geometry, "cylinder", radius=f"{shape.radius:.9g}", length=f"{shape.length:.9g}")
        else:
            meshes[path] = shape
            ET.SubElement(geometry, "mesh", filename=str(path))


def _numbers(values: Any) -> str:
    return " ".join(f"{value:.12g}" for value in values)


def _write_mesh(mesh: Mesh, path: Path) -> None:
    with atomic_path(path) as temporary:
        trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).export(temporary)


def _write_xml(root: ET.Element, path: Path) -> None:
    ET.indent(root)
    with atomic_path(path) as temporary:
        ET.ElementTree(root).write(temporary, encoding="utf-8", xml_declaration=True)
