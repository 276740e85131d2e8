"""The bodies of a robot: every ``<collision>`` element of its URDF as a Coal geometry, or an error that names it.

They are not left to Pinocchio, which skips elements that it does not know or cannot read.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import MeshError, WorkcellError
from regrasp_opt.geometry.mesh_files import read_triangles
from regrasp_opt.geometry.shapes import mesh_geometry

SIZES = {
    "box": {"size": 3},
    "cylinder": {"radius": 1, "length": 1},
    "capsule": {"radius": 1, "length": 1},
    "sphere": {"radius": 1},
}
"""Attributes of the primitives of URDF 1.1, and of how many numbers each consists."""


def collision_bodies(root: ET.Element, model: pin.Model, path: Path) -> pin.GeometryModel:
    """Return a body for each collision element of the robot in `root`, on the joints of `model`.

    Raises
    ------
    WorkcellError
        If an element has no geometry or several, one of an unknown kind, or one with numbers or a mesh that cannot be
        used.
    """
    bodies = pin.GeometryModel()
    for link in root.iterfind("link"):
        name = link.get("name", "")
        index = model.getFrameId(name, pin.FrameType.BODY)
        frame = model.frames[index]
        for number, element in enumerate(link.iterfind("collision")):
            where = f"{path}: link '{name}', <collision> number {number + 1}"
            placement = frame.placement * _origin(element, where)
            body = pin.GeometryObject(f"{name}_{number}", frame.parentJoint, index, placement, _shape(element, where))
            bodies.addGeometryObject(body)
    return bodies


def _shape(element: ET.Element, where: str) -> Any:
    """Return the Coal geometry of a collision element."""
    shapes = [shape for geometry in element.iterfind("geometry") for shape in geometry]
    if len(shapes) != 1:
        raise WorkcellError(f"{where} has {len(shapes)} shapes; give it one <geometry> with one shape")
    (shape,) = shapes
    if shape.tag == "mesh":
        return _mesh(shape, where)
    if shape.tag not in SIZES:
        raise WorkcellError(f"{where} is a <{shape.tag}>; use {', '.join(SIZES)} or mesh")
    sizes = [_numbers(shape, key, count, where) for key, count in SIZES[shape.tag].items()]
    if not all((size > 0).all() for size in sizes):
        raise WorkcellError(f"{where}: the {shape.tag} has a size that is not positive; give its sizes in metres")
    return getattr(coal, shape.tag.capitalize())(*np.concatenate(sizes).tolist())


def _mesh(shape: ET.Element, where: str) -> Any:
    file, scale = Path(shape.get("filename", "")), _numbers(shape, "scale", 3, where, "1 1 1")
    if not scale.all():
        raise WorkcellError(f"{where} has a mesh of scale 0; give the factor to metres")
    try:
        vertices, faces = read_triangles(file)
    except MeshError as error:
        raise WorkcellError(f"{where}: its mesh cannot be used: {error}") from error
    return mesh_geometry(vertices * scale, faces if scale.prod() > 0 else faces[:, ::-1])


def _origin(element: ET.Element, where: str) -> pin.SE3:
    origin = element.find("origin")
    origin = ET.Element("origin") if origin is None else origin
    xyz = _numbers(origin, "xyz", 3, where, "0 0 0")
    if "quat_xyzw" in origin.attrib:  # URDF 1.2
        x, y, z, w = _numbers(origin, "quat_xyzw", 4, where)
    else:  # as urdfdom, which goes through a quaternion too
        (r, p, h), half = _numbers(origin, "rpy", 3, where, "0 0 0") / 2, (math.sin, math.cos)
        (sr, sp, sh), (cr, cp, ch) = ([turn(angle) for angle in (r, p, h)] for turn in half)
        x, y = sr * cp * ch - cr * sp * sh, cr * sp * ch + sr * cp * sh
        z, w = cr * cp * sh - sr * sp * ch, cr * cp * ch + sr * sp * sh
    return pin.SE3(pin.Quaternion(w, x, y, z).normalized().matrix(), xyz)


def _numbers(element: ET.Element, key: str, count: int, where: str, default: str | None = None) -> FloatArray:
    """Return the numbers (count,) of an attribute, or raise a WorkcellError."""
    text = element.get(key, default)
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        given = f'has {key}="{text}"' if text is not None else f"lacks {key}"
        raise WorkcellError(
            f"{where}: <{element.tag}> {given}; give {'a number' if count == 1 else f'{count} numbers'}"
        )
    return values
