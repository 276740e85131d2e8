"""URDF files made ready for Pinocchio: XML read, limits checked, the chain to the tip picked.

First step of `load_robot`. Pinocchio gets links and joints only: joints that do not lead to the tip are fixed at their
neutral position, continuous joints have limits, and bodies (`regrasp_opt.robots.bodies`) are read apart from it.
"""

from __future__ import annotations

import difflib
import logging
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

import pinocchio as pin

from regrasp_opt.errors import WorkcellError

logger = logging.getLogger(__name__)

PREFERRED_TIPS = ("tool0", "flange", "ee_link")
"""Link names taken as the tip, the first one present, when none is asked for."""

MOVING = {"revolute", "continuous", "prismatic"}

JAW = re.compile("grip|finger|jaw|claw|knuckle", re.IGNORECASE)
"""What joints of grippers, or the links that they move, are called."""

NAMED = 5
"""How many joints or links a message names."""

LARGEST_OFFSET = 100.0
"""How far from each other joints are believed to be, and how far a joint to slide [m]."""

TWO_TURNS = 2 * math.tau + 0.1
MOST_TURNS = 10
"""Joints turn no farther from zero. Limits beyond are taken for degrees, as are whole numbers beyond two turns."""

SPEEDS = {"revolute": math.pi, "prismatic": 0.25}
"""Largest speed of a joint whose URDF states none [rad/s, m/s]."""

FAST = {"revolute": 20.0, "prismatic": 10.0}
"""Speeds beyond which another unit may be meant [rad/s, m/s]."""


def parse_xml(content: bytes) -> ET.Element:
    """Return the root element of `content`, read as leniently as urdfdom does.

    Prefixes need no declaration, comments may hold ``--``, and blank lines may come first.

    Raises
    ------
    ValueError
        If it is not XML.
    """
    content = re.sub(rb"<!--.*?-->", lambda comment: b"\n" * comment[0].count(b"\n"), content, flags=re.DOTALL)
    tree, parser = ET.TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = tree.start, tree.end
    parser.CharacterDataHandler = tree.data
    try:
        parser.Parse(content.lstrip() if content.lstrip().startswith(b"<?xml") else content, True)
    except (expat.ExpatError, LookupError) as error:
        raise ValueError(str(error)) from error
    return tree.close()


def read_urdf(path: Path, content: bytes | None = None) -> ET.Element:
    """Return the root element of the URDF file at `path`, with quaternions of joints as roll, pitch and yaw.

    `content` is what was made of the file, where it is not a URDF itself.

    Raises
    ------
    WorkcellError
        If the file is missing, is not XML, holds no robot, or a joint has a malformed quaternion.
    """
    try:
        content = path.read_bytes() if content is None else content
    except (OSError, ValueError) as error:
        raise WorkcellError(f"robot file {path} cannot be read; give the path of a URDF file") from error
    try:
        root = parse_xml(content)
    except ValueError as error:
        raise WorkcellError(f"robot file {path} is not valid XML: {error}") from error
    if root.tag != "robot" or root.find("link") is None:
        raise WorkcellError(f"robot file {path} has no <robot> with links; give a URDF file, or a .xacro file")
    for joint in root.iterfind("joint"):
        for origin in joint.iterfind("origin[@quat_xyzw]"):
            _turn_to_rpy(origin, f"{path}: joint '{joint.get('name')}'")
    return root


def _turn_to_rpy(origin: ET.Element, where: str) -> None:
    """Write the quaternion of `origin` (URDF 1.2), which Pinocchio and most simulators pass over, as ``rpy``."""
    text = origin.attrib.pop("quat_xyzw")
    turn = [_number(word) for word in text.split()]
    length = math.hypot(*turn)
    if len(turn) != 4 or not 0 < length < math.inf:
        raise WorkcellError(f'{where}: <origin> has quat_xyzw="{text}"; give 4 numbers that are not all zero')
    x, y, z, w = (value / length for value in turn)
    rpy = pin.rpy.matrixToRpy(pin.Quaternion(w, x, y, z).normalized().matrix())
    origin.set("rpy", " ".join(map(repr, rpy.tolist())))


def joint_of_child(root: ET.Element, path: Path) -> dict[str, ET.Element]:
    """Return the joint that carries each link, by link name; the root link has none.

    Raises
    ------
    WorkcellError
        If a joint names a link that does not exist, a link hangs from two joints, or there is a loop.
    """
    links = {link.get("name", "") for link in root.iterfind("link")}
    joints: dict[str, ET.Element] = {}
    for joint in root.iterfind("joint"):
        parent, child = (link_name(joint, tag) for tag in ("parent", "child"))
        for name in (parent, child):
            if name not in links:
                raise WorkcellError(
                    f"{path}: joint '{joint.get('name')}' names the link '{name}', which does not exist"
                )
        if child in joints:
            raise WorkcellError(f"{path}: link '{child}' has two parent joints; a robot must be a tree")
        joints[child] = joint
    if len(links) - len(joints) != 1:
        raise WorkcellError(f"{path}: {len(links) - len(joints)} links have no parent; a robot must be one tree")
    return joints


def link_name(joint: ET.Element, tag: str) -> str:
    """Return the name of the link that `joint` has as its ``"parent"`` or ``"child"``."""
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


class Tip(NamedTuple):
    """The link at which an arm ends, those that are fixed to it, and the joints of a gripper that move beyond it."""

    link: str
    rigid: tuple[str, ...] = ()
    beyond: tuple[str, ...] = ()


def default_tip(root: ET.Element, joints: dict[str, ET.Element]) -> Tip:
    """Return the tip when none is given: a link named as in `PREFERRED_TIPS`, else where the arm ends.

    The arm ends at the first link from which no part, more than one part, or the jaw of a gripper moves on.
    """
    links = [link.get("name", "") for link in root.iterfind("link")]
    for name in PREFERRED_TIPS:
        if name in links:
            return Tip(name)
    children: dict[str, list[str]] = {name: [] for name in links}
    for child, joint in joints.items():
        children[link_name(joint, "parent")].append(child)

    def beyond(link: str) -> list[str]:
        """Return the joints that move in what hangs from `link`, its own among them."""
        own = [joints[link].get("name", "")] if joints[link].get("type") in MOVING else []
        return own + [name for child in children[link] for name in beyond(child)]

    here, rigid, passed = next(name for name in links if name not in joints), list[str](), False
    while True:
        rigid.append(here)
        onward = [child for child in children[here] if beyond(child)]
        ahead = onward or children[here]
        if len(ahead) != 1 or (passed and _is_jaw(joints[ahead[0]])):
            break
        (here,) = ahead
        if joints[here].get("type") in MOVING:
            rigid, passed = [], passed or not _is_jaw(joints[here])
    fixed = [child for child in children[here] if child not in onward]
    moving = [name for child in onward for name in beyond(child)] if passed else []
    return Tip(here, (*rigid, *fixed), tuple(moving))


def _is_jaw(joint: ET.Element) -> bool:
    """Return whether `joint` looks like one of a gripper: by its name, or as it follows another."""
    named = JAW.search(f"{joint.get('name')} {link_name(joint, 'child')}") is not None
    return joint.get("type") in MOVING and (named or joint.find("mimic") is not None)


def chain_to(tip: str, root: ET.Element, joints: dict[str, ET.Element], path: Path) -> list[ET.Element]:
    """Return the moving joints from the root link to `tip`, in that order.

    Raises
    ------
    WorkcellError
        If there is no such link, or a joint on the way is floating, planar, a mimic, or of unknown type.
    """
    links = [link.get("name", "") for link in root.iterfind("link")]
    if tip not in links:
        raise WorkcellError(f"{path}: no link '{tip}' for the tip; known: {', '.join(closest(tip, links))}")
    chain: list[ET.Element] = []
    seen, end = {tip}, tip
    while tip in joints:
        joint = joints[tip]
        name, kind = joint.get("name"), joint.get("type")
        if kind not in MOVING | {"fixed"}:
            raise WorkcellError(
                f"{path}: joint '{name}' on the way to the tip is {kind}; "
                "use revolute, continuous, prismatic or fixed joints on a fixed base"
            )
        if joint.find("mimic") is not None:
            raise WorkcellError(f"{path}: joint '{name}' on the way to the tip mimics another; choose a tip before it")
        chain += [joint] if kind != "fixed" else []
        tip = link_name(joint, "parent")
        if tip in seen:
            raise WorkcellError(f"{path}: the joints form a loop at link '{tip}'; a robot must be a tree")
        seen.add(tip)
    if not chain:
        raise WorkcellError(
            f"{path}: no moving joint leads to the tip '{end}'; choose a link at the end of the arm as the tip"
        )
    return chain[::-1]


def kinematics(root: ET.Element, chain: Iterable[str], path: Path) -> bytes:
    """Return links and joints of the robot as XML for Pinocchio, all joints fixed but those named in `chain`."""
    plain = ET.Element("robot", {"name": path.stem, **root.attrib})
    for link in root.iterfind("link"):
        ET.SubElement(plain, "link", name=link.get("name", "")).extend(link.iterfind("inertial"))
    for joint in root.iterfind("joint"):
        kind = "prismatic" if joint.get("type") == "prismatic" else "revolute"
        moves = joint.get("name", "") in chain
        copy = ET.SubElement(plain, "joint", name=joint.get("name", ""), type=kind if moves else "fixed")
        tags = ("parent", "child", "origin", "axis") if moves else ("parent", "child", "origin")
        copy.extend(part for tag in tags for part in joint.iterfind(tag))
        if moves:
            ET.SubElement(copy, "limit", {key: repr(value) for key, value in limits(joint, path).items()})
    return ET.tostring(plain)


def limits(joint: ET.Element, path: Path) -> dict[str, float]:
    """Return lower, upper, velocity and effort of a moving joint; a continuous one gets +-2 pi.

    Raises
    ------
    WorkcellError
        If a joint has no limits, its lower limit is not below its upper limit, or they are in another unit.
    """
    where, kind = f"{path}: joint '{joint.get('name')}'", joint.get("type")
    limit, axis = joint.find("limit"), joint.find("axis")
    if axis is not None and not any(map(_number, axis.get("xyz", "1 0 0").split())):
        raise WorkcellError(f"{where} has no axis; give it a direction")
    given = {} if limit is None else {key: _number(value) for key, value in limit.attrib.items()}
    speed = given.get("velocity", SPEEDS[_motion(joint)])
    low, high = (-math.tau, math.tau) if kind == "continuous" else (given.get(key, 0.0) for key in ("lower", "upper"))
    if not (math.isfinite(low) and math.isfinite(high) and low < high):
        raise WorkcellError(f"{where} needs a <limit> with finite lower and upper, lower < upper")
    if not math.isfinite(speed):
        raise WorkcellError(f"{where} has a velocity limit that is not a finite number; give rad/s or m/s")
    far = max(abs(low), abs(high))
    if kind == "prismatic" and far > LARGEST_OFFSET:
        raise WorkcellError(f"{where} slides from {low:g} to {high:g} m; give its limits in metres")
    if kind == "revolute" and far > TWO_TURNS and (far.is_integer() or far > MOST_TURNS * math.tau):
        raise WorkcellError(
            f"{where} turns from {low:g} to {high:g} rad: are these degrees? Give radians ({math.radians(low):.4g} to "
            f'{math.radians(high):.4g}), or type="continuous" if nothing stops it'
        )
    return {"lower": low, "upper": high, "velocity": speed, "effort": 0.0}


def report_limits(chain: Sequence[ET.Element], path: Path) -> None:
    """Log a line where limits may be meant in degrees, one where speeds may, and one where no speed is given."""
    known = {str(joint.get("name")): limits(joint, path) for joint in chain}
    turning = [str(joint.get("name")) for joint in chain if joint.get("type") == "revolute"]
    far = [name for name in turning if max(-known[name]["lower"], known[name]["upper"]) > TWO_TURNS]
    if far:
        text = "%s: joints may turn by more than two turns (%s); if their limits are degrees, give radians"
        logger.warning(text, path, ", ".join(far))
    speeds = [(joint, known[str(joint.get("name"))]["velocity"]) for joint in chain]
    fast = [f"{joint.get('name')} at {speed:g}" for joint, speed in speeds if speed > FAST[_motion(joint)]]
    if fast:
        text = "%s: joints may move faster than %g rad/s or %g m/s (%s); if their URDF has degrees or millimetres, "
        text += "give rad/s or m/s"
        logger.warning(text, path, FAST["revolute"], FAST["prismatic"], ", ".join(fast))
    silent = [str(joint.get("name")) for joint in chain if joint.find("limit[@velocity]") is None]
    if silent:
        text = "%s states no velocity limit (%s); %.3g rad/s is assumed for turning and %.3g m/s for sliding joints"
        logger.warning(text, path, ", ".join(silent), SPEEDS["revolute"], SPEEDS["prismatic"])


def _motion(joint: ET.Element) -> str:
    """Return the key of `joint` in `SPEEDS` and `FAST`."""
    return "prismatic" if joint.get("type") == "prismatic" else "revolute"


def report_tip(tip: Tip, path: Path) -> None:
    """Log a line where a gripper of the URDF itself is beyond the tip that was taken."""
    if tip.beyond:
        logger.warning(
            "%s: the arm is taken to end at '%s', before %s; give as the tip the link that carries the tool (one of "
            "%s), and leave out the URDF's own gripper where it is not there",
            path,
            tip.link,
            ", ".join(tip.beyond[:NAMED]) + (f" and {len(tip.beyond) - NAMED} more" if len(tip.beyond) > NAMED else ""),
            ", ".join(tip.rigid),
        )


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def numbers(text: str, count: int) -> list[float]:
    """Return the `count` finite numbers in `text`; none if it holds anything else."""
    found = [_number(word) for word in text.split()]
    return found if len(found) == count and all(map(math.isfinite, found)) else []


def closest(name: str, known: Iterable[str]) -> list[str]:
    """Return the `known` names, those most like `name` first."""
    return sorted(known, key=lambda other: -difflib.SequenceMatcher(None, name.lower(), other.lower()).ratio())
