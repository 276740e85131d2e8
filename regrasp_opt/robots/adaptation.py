"""What is asked for besides a URDF, done to its XML: links left out, joints locked, a seat for the tool.

Whatever reads the robot afterwards knows nothing of it. Once the chain is known, the joints beside it are settled, too.
"""

from __future__ import annotations

import logging
import math
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray, rotation_rpy, rpy_angles, translation
from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import urdf

logger = logging.getLogger(__name__)


def leave_out(root: ET.Element, links: Iterable[str], path: Path) -> None:
    """Remove `links`, and whatever hangs from them, in place.

    Raises
    ------
    WorkcellError
        If there is no such link, or it is the base.
    """
    joints = urdf.joint_of_child(root, path)
    known = [link.get("name", "") for link in root.iterfind("link")]
    for name in links:
        if name not in joints:
            reason = "it carries the whole robot" if name in known else "there is none"
            raise WorkcellError(
                f"{path}: link '{name}' cannot be left out, {reason}; known: {', '.join(urdf.closest(name, joints))}"
            )
    gone, more = set[str](), set(links)
    while more:
        gone |= more
        more = {child for child, joint in joints.items() if urdf.link_name(joint, "parent") in gone} - gone
    for element in [*root.iterfind("link"), *root.iterfind("joint")]:
        if (element.get("name") if element.tag == "link" else urdf.link_name(element, "child")) in gone:
            root.remove(element)


def lock(root: ET.Element, values: Mapping[str, float], path: Path) -> dict[str, float]:
    """Fix joints at `values` [rad, m], and those that mimic them where these put them, in place; return all of these.

    Raises
    ------
    WorkcellError
        If there is no such joint, it cannot move, or the value is outside its limits.
    """
    joints = {joint.get("name", ""): joint for joint in root.iterfind("joint")}
    moving = [name for name, joint in joints.items() if joint.get("type") in urdf.MOVING]
    for name, value in values.items():
        if name not in moving:
            reason = f"is {joints[name].get('type')}" if name in joints else "does not exist"
            known = ", ".join(urdf.closest(name, moving))
            raise WorkcellError(f"{path}: joint '{name}' cannot be locked, it {reason}; joints that move: {known}")
        limits = urdf.limits(joints[name], path)
        if not limits["lower"] <= value <= limits["upper"] and joints[name].get("type") != "continuous":
            raise WorkcellError(
                f"{path}: joint '{name}' cannot be locked at {value:g}, its limits are {limits['lower']:g} to "
                f"{limits['upper']:g}; give a value within them"
            )
        if not math.isfinite(value):
            raise WorkcellError(f"{path}: joint '{name}' cannot be locked at {value}; give a finite number")
    held = _with_mimics(joints, values, path)
    for name, value in held.items():
        _fix(joints[name], value, f"{path}: joint '{name}'")
    return held


def settle(root: ET.Element, chain: Sequence[str], path: Path) -> dict[str, float]:
    """Fix the joints beside `chain` where they rest, in place: at 0, or at the limit nearest to it; mimics follow.

    Return where those rest that mimic none [rad, m].

    Raises
    ------
    WorkcellError
        If a joint beside the chain moves bodies as a joint of the chain does, which it mimics, or its <mimic> has wrong
        numbers.
    """
    joints = {joint.get("name", ""): joint for joint in root.iterfind("joint")}
    leaders = {name: _leader(joint, joints) for name, joint in joints.items()}
    solid = {link.get("name") for link in root.iterfind("link") if link.find("collision") is not None}
    for name in joints:
        leader = _first_leader(name, leaders, chain)
        child = urdf.link_name(joints[name], "child")
        moved = [] if leader is None else [link for link in _below(child, joints.values()) if link in solid]
        if moved:
            raise WorkcellError(
                f"{path}: joint '{name}' mimics joint '{leader}' of the arm and moves link '{moved[0]}', which has "
                "<collision>, but plans move nothing except the joints that lead to the tip; leave out "
                f"'{child}' (leave_out), or lock '{name}' (locked) if it stands still"
            )
    beside = {name: joint for name, joint in joints.items() if joint.get("type") in urdf.MOVING and name not in chain}
    rest = {name: _rest(joint) for name, joint in beside.items() if leaders[name] is None}
    away = [f"{name} at {value:g}" for name, value in rest.items() if value]
    if away:
        text = "%s: 0 is outside the limits of joints beside the arm, which are locked at the nearest value (%s); give"
        logger.warning(f"{text} as locked where they are", path, ", ".join(away))
    for name, value in _with_mimics(joints, rest, path).items():
        if value:
            _fix(joints[name], value, f"{path}: joint '{name}'")
    return rest


def _leader(joint: ET.Element, joints: Mapping[str, ET.Element]) -> str | None:
    """Return which of `joints` moves `joint`, which mimics it, if any."""
    mimic = joint.find("mimic") if joint.get("type") in urdf.MOVING else None
    leader = None if mimic is None else mimic.get("joint", "")
    return leader if leader in joints else None


def _first_leader(name: str, leaders: Mapping[str, str | None], chain: Sequence[str]) -> str | None:
    """Return the joint of `chain` that moves the joint `name`, directly or through others, if any."""
    passed: list[str] = []
    leader = leaders[name]
    while leader is not None and leader not in chain and leader not in passed:
        passed.append(leader)
        leader = leaders[leader]
    return leader if leader in chain else None


def _below(link: str, joints: Iterable[ET.Element]) -> list[str]:
    """Return `link` and the links that hang from it, the nearest first."""
    found, pairs = [link], [(urdf.link_name(joint, "parent"), urdf.link_name(joint, "child")) for joint in joints]
    for parent in found:
        found += [child for above, child in pairs if above == parent and child not in found]
    return found


def _rest(joint: ET.Element) -> float:
    """Return the value within the limits of `joint` that is nearest to 0; limits that make no sense have no say."""
    limit = joint.find("limit") if joint.get("type") in ("revolute", "prismatic") else None
    if limit is None:
        return 0.0
    found = urdf.numbers(f"{limit.get('lower', '0')} {limit.get('upper', '0')}", 2)
    return min(max(0.0, found[0]), found[1]) if found and found[0] <= found[1] else 0.0


def _with_mimics(joints: Mapping[str, ET.Element], values: Mapping[str, float], path: Path) -> dict[str, float]:
    """Return `values` and those of the joints that mimic these, directly or through others."""
    found = dict(values)
    while True:
        more = {}
        for name, joint in joints.items():
            mimic = joint.find("mimic")
            leader = None if mimic is None else mimic.get("joint", "")
            if mimic is not None and leader in found and name not in found and joint.get("type") in urdf.MOVING:
                factor, offset = (
                    _vector(mimic, key, default, 1, f"{path}: joint '{name}'")[0]
                    for key, default in (("multiplier", "1"), ("offset", "0"))
                )
                more[name] = float(factor) * found[leader] + float(offset)
                if not math.isfinite(more[name]):
                    raise WorkcellError(
                        f"{path}: joint '{name}' mimics joint '{leader}' to {more[name]}; give its <mimic> a smaller "
                        "multiplier and offset"
                    )
        if not more:
            return found
        found |= more


def _fix(joint: ET.Element, value: float, where: str) -> None:
    """Make `joint` a fixed one, where it is at `value`."""
    axis, origin = (joint.find(tag) for tag in ("axis", "origin"))
    direction = _vector(axis, "xyz", "1 0 0", 3, where)
    direction /= np.linalg.norm(direction)
    T = translation(*_vector(origin, "xyz", "0 0 0", 3, where))
    T[:3, :3] = rotation_rpy(*_vector(origin, "rpy", "0 0 0", 3, where))
    moved = np.eye(4)
    if joint.get("type") == "prismatic":
        moved[:3, 3] = value * direction
    else:
        moved[:3, :3] = pin.exp3(value * direction)
    T = T @ moved
    for element in [element for element in joint if element.tag not in ("parent", "child")]:
        joint.remove(element)
    joint.set("type", "fixed")
    ET.SubElement(joint, "origin", xyz=_text(T[:3, 3].tolist()), rpy=_text(rpy_angles(T[:3, :3]).tolist()))


def _vector(element: ET.Element | None, key: str, default: str, count: int, where: str) -> FloatArray:
    text = default if element is None else element.get(key, default)
    found = urdf.numbers(text, count)
    if not found or (element is not None and element.tag == "axis" and not any(found)):
        wanted = "1 number" if count == 1 else f"{count} numbers"
        raise WorkcellError(f'{where} has {key}="{text}"; give {wanted}')
    return np.array(found)


def _text(numbers: Sequence[float]) -> str:
    return " ".join(repr(float(number)) for number in numbers)


def seat_tool(root: ET.Element, tip: str, position: Sequence[float], rpy: Sequence[float]) -> str:
    """Add a link that is fixed to `tip` at a pose [m, rad], in place; return its name."""
    name, taken = f"{tip}_tool", {element.get("name") for element in root}
    while name in taken:
        name += "_"
    ET.SubElement(root, "link", name=name)
    joint = ET.SubElement(root, "joint", name=name, type="fixed")
    ET.SubElement(joint, "parent", link=tip)
    ET.SubElement(joint, "child", link=name)
    ET.SubElement(joint, "origin", xyz=_text(position), rpy=_text(rpy))
    return name
