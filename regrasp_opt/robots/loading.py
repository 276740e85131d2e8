"""Robots from URDF and xacro files: those that are known by name, any other by path."""

from __future__ import annotations

import logging
import os
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.files import captured_stderr
from regrasp_opt.robots import adaptation, urdf
from regrasp_opt.robots.bodies import collision_bodies
from regrasp_opt.robots.kinematics import chain_of_model
from regrasp_opt.robots.mesh_names import settle_meshes
from regrasp_opt.robots.robot import Robot
from regrasp_opt.robots.self_test import inverse_kinematics
from regrasp_opt.robots.sizes import check_sizes
from regrasp_opt.robots.srdf import Semantics, read_srdf
from regrasp_opt.robots.xacro_files import expand_xacro

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

logger = logging.getLogger(__name__)

ROBOT_NAMES = ("nova2", "iiwa7")
"""The built-in robots."""

EXAMPLE_ROBOT_NAMES = ("ur3", "ur5", "ur10", "panda", "xarm7", "kinova", "z1")
"""Robots whose URDF files come with the package example-robot-data."""


SUFFIXES = (".urdf", ".xacro")

ALONG = 0.999
"""Cosine from which an axis counts as along another."""


@dataclass(frozen=True)
class RobotSource:
    """What a robot is made from; it travels between processes in the robot's place. `xml` has absolute mesh names."""

    name: str
    path: str
    xml: bytes
    joints: tuple[str, ...]
    tip: str
    mount: str
    locked: tuple[tuple[str, float], ...]
    home: tuple[float, ...] | None
    ignored: frozenset[frozenset[str]]


def load_robot(
    name_or_path: str | os.PathLike[str],
    *,
    tip: str | None = None,
    tip_position: Sequence[float] | None = None,
    tip_rpy: Sequence[float] | None = None,
    package_dirs: Iterable[str | os.PathLike[str]] = (),
    home: Sequence[float] | str | None = None,
    ignore_collisions: Iterable[tuple[str, str] | Sequence[str]] = (),
    srdf: str | os.PathLike[str] | None = None,
    locked: Mapping[str, float] | None = None,
    leave_out: Iterable[str] | None = None,
    xacro_args: Mapping[str, str] | None = None,
) -> Robot:
    """Return a robot by name, or any serial arm from the path of its URDF or xacro file.

    Joints that do not lead to the tip are locked where `locked` says, else at 0 or at the limit nearest to it; those
    that mimic them follow.

    Parameters
    ----------
    name_or_path : str or path
        One of `ROBOT_NAMES` or `EXAMPLE_ROBOT_NAMES`, or a URDF or xacro file. A string is a path when it ends in
        ``.urdf`` or ``.xacro``, or has a folder in it.
    tip : str, optional
        Link that carries the tool; by default ``tool0``, ``flange`` or ``ee_link``, else where the arm ends.
        A warning says so where the last joint turns about the +x of that link, so that the tool is mounted across.
    tip_position, tip_rpy : sequences of three floats, optional
        Where the tool's flange frame sits on that link [m, rad]; by default at its origin, along its +z.
    package_dirs : iterable of paths
        Where ``package://name`` is looked up besides the folders above the URDF file: packages, or folders of them.
    home : sequence of float or str, optional
        Rest configuration (dof,) [rad, m], or the name of a state in the SRDF; by default the built-in one, else 0, or
        mid-range where 0 is outside.
    ignore_collisions : iterable of pairs of str
        Pairs of links that are never tested against each other, for example because they always touch.
    srdf : path, optional
        SRDF file: its disabled pairs are not tested either, and its states may be `home`.
    locked : mapping, optional
        Values [rad, m] of joints that are locked there, by name; they may lie on the way to the tip.
    leave_out : iterable of str, optional
        Links that are not there, nor whatever hangs from them, such as the gripper of the URDF.
    xacro_args : mapping, optional
        Arguments of a xacro file, by name.

    Raises
    ------
    UnknownNameError
        If the string is neither a known name nor a path.
    WorkcellError
        If the URDF cannot be read or is not a serial arm on a fixed base, or an option does not fit it.
    """
    path, given = Path(name_or_path), dict[str, Any](tip=tip, home=home, leave_out=leave_out)
    given |= {"tip_position": tip_position, "tip_rpy": tip_rpy, "locked": locked}
    name, ignored = None, [frozenset(pair) for pair in ignore_collisions]
    if isinstance(name_or_path, str) and name_or_path in (*ROBOT_NAMES, *EXAMPLE_ROBOT_NAMES):
        name = name_or_path
        path, defaults = _named(name)
        ignored += [frozenset(pair) for pair in defaults.pop("ignore_collisions")]
        given = {**defaults, **{key: value for key, value in given.items() if value is not None}}
    elif isinstance(name_or_path, str) and path.suffix.lower() not in SUFFIXES and path.name == name_or_path:
        raise UnknownNameError("robot", name_or_path, (*ROBOT_NAMES, *EXAMPLE_ROBOT_NAMES))
    root, folders = _read(path, package_dirs, xacro_args), [Path(folder) for folder in package_dirs]
    source = _source(name, path, root, folders, None if srdf is None else Path(srdf), frozenset(ignored), **given)
    robot = build_robot(source)
    check_sizes(robot)
    if given["tip"] is None and given["tip_rpy"] is None:
        _report_mount(robot)
    _report_bare(robot, path)
    return robot


def _report_mount(robot: Robot) -> None:
    """Log a line where the tool stands across the axis of the last joint, which runs along the +x of the tip."""
    along = np.abs(robot.chain.tip[:3, :3].T @ robot.chain.axes[-1])
    if along[0] > ALONG and not robot.chain.prismatic[-1]:
        logger.warning(
            "%s: the tool is mounted along +z of '%s', the tip that was taken, but '%s' turns about its x; if the arm "
            "points along that, give tip_rpy = [0, 1.5708, 0], else tip_rpy = [0, 0, 0] or another link as the tip",
            robot.urdf_path,
            robot.tip_frame,
            robot.joint_names[-1],
        )


def _report_bare(robot: Robot, path: Path) -> None:
    """Log a line where links that move have no body."""
    bare = robot.links_without_body()
    if not robot.collision.ngeoms:
        logger.warning("%s has no <collision> element; no part of the arm is tested for collision", path)
    elif bare:
        names = ", ".join(bare[: urdf.NAMED])
        names += f" and {len(bare) - urdf.NAMED} more links" if len(bare) > urdf.NAMED else ""
        logger.warning("%s has no <collision> element in %s; what has none is not tested for collision", path, names)


def _named(name: str) -> tuple[Path, dict[str, Any]]:
    """Return the URDF file of a robot with a name, and the options that its data file has for `load_robot`.

    Raises
    ------
    WorkcellError
        If the package that holds the URDF is not installed.
    """
    folder = Path(str(files("regrasp_opt"))) / "data" / "robots" / name
    options = tomllib.loads((folder / f"{name}.toml").read_text("utf-8"))
    if name in ROBOT_NAMES:
        return folder / f"{name}.urdf", options
    try:
        package = distribution("example-robot-data")
    except PackageNotFoundError as error:
        raise WorkcellError(f"the URDF of '{name}' is not installed; install the extra regrasp-opt[robots]") from error
    return Path(str(package.locate_file("cmeel.prefix/share/example-robot-data/robots"))) / options.pop("urdf"), options


def _read(
    path: Path, package_dirs: Iterable[str | os.PathLike[str]], xacro_args: Mapping[str, str] | None
) -> ET.Element:
    if path.suffix.lower() == ".xacro":
        return urdf.read_urdf(path, expand_xacro(path, xacro_args or {}, map(Path, package_dirs)))
    if xacro_args:
        raise WorkcellError(f"{path} is not a .xacro file, so xacro_args mean nothing; leave them out")
    return urdf.read_urdf(path)


def _source(
    name: str | None,
    path: Path,
    root: ET.Element,
    package_dirs: Sequence[Path],
    srdf: Path | None,
    ignored: frozenset[frozenset[str]],
    *,
    tip: str | None = None,
    tip_position: Sequence[float] | None = None,
    tip_rpy: Sequence[float] | None = None,
    home: Sequence[float] | str | None = None,
    locked: Mapping[str, float] | None = None,
    leave_out: Iterable[str] | None = None,
) -> RobotSource:
    """Return the robot in `root`, which is changed as the options of `load_robot` ask."""
    adaptation.leave_out(root, leave_out or (), path)
    held = adaptation.lock(root, locked or {}, path)
    parents = urdf.joint_of_child(root, path)
    if tip is None:
        found = urdf.default_tip(root, parents)
        urdf.report_tip(found, path)
        tip = found.link
    chain, mount = urdf.chain_to(tip, root, parents, path), tip
    joints = tuple(joint.get("name", "") for joint in chain)
    beside = adaptation.settle(root, joints, path)
    if tip_position is not None or tip_rpy is not None:
        tip = adaptation.seat_tool(root, tip, tip_position or (0.0, 0.0, 0.0), tip_rpy or (0.0, 0.0, 0.0))
    urdf.report_limits(chain, path)
    settle_meshes(root, path, package_dirs)
    links = [link.get("name", "") for link in root.iterfind("link")]
    for pair in ignored:
        for link in sorted(pair):
            if link not in links:
                known = ", ".join(urdf.closest(link, links))
                raise WorkcellError(f"{path}: no link '{link}' to ignore collisions of; known: {known}")
    said = Semantics(frozenset(), {}, {}) if srdf is None else read_srdf(srdf, links, joints)
    try:
        xml = ET.tostring(root)
    except RecursionError as error:
        raise WorkcellError(f"robot file {path} has elements nested too deeply; give a plain URDF file") from error
    return RobotSource(
        name=name or root.get("name") or path.stem,
        path=str(path),
        xml=xml,
        joints=joints,
        tip=tip,
        mount=mount,
        locked=tuple((beside | held).items()),
        home=_rest(home, said, joints, srdf or path),
        ignored=ignored | said.ignored,
    )


def _rest(
    home: Sequence[float] | str | None, said: Semantics, joints: Sequence[str], path: Path
) -> tuple[float, ...] | None:
    """Return `home` as numbers, those of a state where it is the name of one."""
    if not isinstance(home, str):
        return None if home is None else tuple(map(float, home))
    name = home
    if name not in said.states:
        known = f"known: {', '.join(urdf.closest(name, said.states))}" if said.states else "give an SRDF that has it"
        raise WorkcellError(f"{path}: no state '{name}' to be at home in; {known}")
    if name in said.disputed:
        raise WorkcellError(
            f"{path}: several groups have a state '{name}', and put {said.disputed[name]} in different places; give "
            "home as numbers"
        )
    missing = [joint for joint in joints if joint not in said.states[name]]
    if missing:
        raise WorkcellError(f"{path}: state '{name}' does not say where {', '.join(missing)} is; give home as numbers")
    return tuple(said.states[name][joint] for joint in joints)


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
        mount=source.mount,
        locked=dict(source.locked),
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
