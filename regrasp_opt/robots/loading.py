"""Robots from URDF files: the built-in ones by name, any other by path."""

from __future__ import annotations

import logging
import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.files import captured_stderr
from regrasp_opt.robots import urdf
from regrasp_opt.robots.bodies import collision_bodies
from regrasp_opt.robots.kinematics import chain_of_model
from regrasp_opt.robots.mesh_names import settle_meshes
from regrasp_opt.robots.robot import Robot
from regrasp_opt.robots.self_test import inverse_kinematics
from regrasp_opt.robots.sizes import check_sizes

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

logger = logging.getLogger(__name__)

ROBOT_NAMES = ("nova2",)
"""The built-in robots."""

NAMED = 5
"""How many links without a body are named."""


@dataclass(frozen=True)
class RobotSource:
    """What a robot is made from; it travels between processes in the robot's place. `xml` has absolute mesh names."""

    name: str
    path: str
    xml: bytes
    joints: tuple[str, ...]
    tip: str
    home: tuple[float, ...] | None
    ignored: frozenset[frozenset[str]]


def load_robot(
    name_or_path: str | os.PathLike[str],
    *,
    tip: str | None = None,
    package_dirs: Iterable[str | os.PathLike[str]] = (),
    home: Sequence[float] | None = None,
    ignore_collisions: Iterable[tuple[str, str] | Sequence[str]] = (),
) -> Robot:
    """Return a built-in robot by name, or any serial arm from the path of its URDF file.

    Joints that do not lead to the tip are locked at their neutral position.

    Parameters
    ----------
    name_or_path : str or path
        One of `ROBOT_NAMES`, or a URDF file. A string is a path when it ends in ``.urdf`` or has a folder
        in it.
    tip : str, optional
        Link that carries the tool; by default ``tool0``, ``flange`` or ``ee_link``, else where the arm ends.
    package_dirs : iterable of paths
        Where ``package://name`` is looked up besides the folders above the URDF file: packages, or folders of them.
    home : sequence of float, optional
        Rest configuration (dof,) [rad, m]; by default the built-in one, else 0, or mid-range where 0 is
        outside.
    ignore_collisions : iterable of pairs of str
        Pairs of links that are never tested against each other, for example because they always touch.

    Raises
    ------
    UnknownNameError
        If the string is neither a built-in name nor a path.
    WorkcellError
        If the URDF cannot be read or is not a serial arm on a fixed base, or `tip`, `home` or a link does not
        fit it.
    """
    ignored = frozenset(frozenset(pair) for pair in ignore_collisions)
    name = None
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and name_or_path in ROBOT_NAMES:
        name = name_or_path
        folder = Path(str(files("regrasp_opt"))) / "data" / "robots" / name
        defaults = tomllib.loads((folder / f"{name}.toml").read_text("utf-8"))
        path, tip = folder / f"{name}.urdf", tip or defaults["tip"]
        home = defaults["home"] if home is None else home
        ignored |= frozenset(frozenset(pair) for pair in defaults["ignore_collisions"])
    elif isinstance(name_or_path, str) and path.suffix.lower() != ".urdf" and path.name == name_or_path:
        raise UnknownNameError("robot", name_or_path, ROBOT_NAMES)
    robot = build_robot(_source(name, path, tip, package_dirs, home, ignored))
    check_sizes(robot)
    bare = robot.links_without_body()
    if not robot.collision.ngeoms:
        logger.warning("%s has no <collision> element; no part of the arm is tested for collision", path)
    elif bare:
        names = ", ".join(bare[:NAMED]) + (f" and {len(bare) - NAMED} more links" if len(bare) > NAMED else "")
        logger.warning("%s has no <collision> element in %s; what has none is not tested for collision", path, names)
    return robot


def _source(
    name: str | None,
    path: Path,
    tip: str | None,
    package_dirs: Iterable[str | os.PathLike[str]],
    home: Sequence[float] | None,
    ignored: frozenset[frozenset[str]],
) -> RobotSource:
    root = urdf.read_urdf(path)
    parents = urdf.joint_of_child(root, path)
    tip = tip or urdf.default_tip(root, parents)
    chain = urdf.chain_to(tip, root, parents, path)
    urdf.report_limits(chain, path)
    settle_meshes(root, path, package_dirs)
    links = [link.get("name", "") for link in root.iterfind("link")]
    for pair in ignored:
        for link in sorted(pair):
            if link not in links:
                known = ", ".join(urdf.closest(link, links))
                raise WorkcellError(f"{path}: no link '{link}' to ignore collisions of; known: {known}")
    try:
        xml = ET.tostring(root)
    except RecursionError as error:
        raise WorkcellError(f"robot file {path} has elements nested too deeply; give a plain URDF file") from error
    return RobotSource(
        name=name or root.get("name") or path.stem,
        path=str(path),
        xml=xml,
        joints=tuple(joint.get("name", "") for joint in chain),
        tip=tip,
        home=None if home is None else tuple(map(float, home)),
        ignored=ignored,
    )


def build_robot(source: RobotSource) -> Robot:
    """Return the robot described by `source`."""
    root, path = urdf.parse_xml(source.xml), Path(source.path)
    model = _pinocchio_model(urdf.kinematics(root, source.joints, path), path)
    lower, upper = np.array(model.lowerPositionLimit), np.array(model.upperPositionLimit)
    home = _home(source, lower, upper)
    chain = chain_of_model(model, source.tip)
    farthest = float(np.abs(np.append(chain.placements[:, :3, 3], chain.tip[:3, 3])).max())
    if farthest > urdf.LARGEST_OFFSET:
        raise WorkcellError(f"robot file {source.path} has joints {farthest:.3g} m apart; give its lengths in metres")
    return Robot(
        name=source.name,
        urdf_path=source.path,
        urdf=source.xml,
        model=model,
        collision=collision_bodies(root, model, path),
        tip_frame=source.tip,
        chain=chain,
        ik=inverse_kinematics(source.name, chain, lower, upper),
        lower=lower,
        upper=upper,
        velocity_limits=np.array(model.velocityLimit),
        home=home,
        ignored=source.ignored,
        rebuild=(build_robot, (source,)),
    )


def _pinocchio_model(xml: bytes, path: Path) -> pin.Model:
    with captured_stderr() as said:
        try:
            model = pin.buildModelFromXML(xml.decode())
        except (ValueError, RuntimeError) as error:
            model, reason = None, error
    if model is not None:
        links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
        for frame in model.frames:  # links are looked up by name alone, and a joint may have the same
            if frame.type != pin.FrameType.BODY and frame.name in links:
                frame.name += " (joint)"
        return model
    told = [line.split("Error:")[1] for line in said if "Error:" in line] or [str(reason)]
    text = "; ".join(" ".join(part.split()) for part in told)
    raise WorkcellError(f"robot file {path} is not a URDF that Pinocchio can read: {text}") from reason


def _home(source: RobotSource, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """Return the rest configuration, checked against number of joints and limits."""
    if source.home is None:
        return np.where((lower <= 0) & (upper >= 0), 0.0, (lower + upper) / 2)
    home = np.array(source.home)
    if home.shape != lower.shape:
        raise WorkcellError(
            f"home of robot '{source.name}' has {len(home)} values; give {len(lower)}, for {', '.join(source.joints)}"
        )
    outside = np.flatnonzero(~((home >= lower) & (home <= upper)))
    if len(outside):
        i = int(outside[0])
        raise WorkcellError(
            f"home of robot '{source.name}' puts {source.joints[i]} at {home[i]:g}, outside its limits "
            f"{lower[i]:g} to {upper[i]:g}; give a value within them"
        )
    return home
