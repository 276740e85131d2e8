"""URDF files made ready for Pinocchio: joints checked, mesh files found, the chain to the tip picked.

First step of `load_robot`. Pinocchio ignores mimic joints, gives continuous joints two coordinates and
looks for relative mesh files in the current folder; each of these is settled here, in the XML.
"""

from __future__ import annotations

import difflib
import math
import os
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import trimesh

from regrasp_opt.errors import MeshError, WorkcellError
from regrasp_opt.files import report_outside
from regrasp_opt.mesh_files import MESH_SUFFIXES, read_triangles

PREFERRED_TIPS = ("tool0", "flange", "ee_link")
"""Link names taken as the tip, the first one present, when none is asked for."""

MOVING = {"revolute", "continuous", "prismatic"}


def read_urdf(path: Path) -> ET.Element:
    """Return the root element of the URDF file at `path`.

    Raises
    ------
    WorkcellError
        If the file is missing, is no XML, or holds no robot.
    """
    try:
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        raise WorkcellError(f"robot file {path} cannot be read; give the path of a URDF file") from error
    try:
        root = ET.fromstring(content)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise WorkcellError(f"robot file {path} is not valid XML: {error}") from error
    if root.tag != "robot" or root.find("link") is None:
        raise WorkcellError(f"robot file {path} has no <robot> with links; give a URDF file (expand xacro first)")
    return root


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
        parent, child = (_link_name(joint, tag) for tag in ("parent", "child"))
        for name in (parent, child):
            if name not in links:
                raise WorkcellError(f"{path}: joint '{joint.get('name')}' names the link '{name}', which is not there")
        if child in joints:
            raise WorkcellError(f"{path}: link '{child}' hangs from two joints; a robot must be a tree")
        joints[child] = joint
    if len(links) - len(joints) != 1:
        raise WorkcellError(f"{path}: {len(links) - len(joints)} links have no parent; a robot must be one tree")
    return joints


def _link_name(joint: ET.Element, tag: str) -> str:
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")


def default_tip(root: ET.Element, joints: dict[str, ET.Element]) -> str:
    """Return the tip when none is given: a link named as in `PREFERRED_TIPS`, else where the arm ends.

    The arm ends at the first link from which no part, or more than one part, moves on (a gripper's fingers).
    """
    links = [link.get("name", "") for link in root.iterfind("link")]
    for name in PREFERRED_TIPS:
        if name in links:
            return name
    children: dict[str, list[str]] = {name: [] for name in links}
    for child, joint in joints.items():
        children[_link_name(joint, "parent")].append(child)

    def moves(link: str) -> bool:
        return joints[link].get("type") in MOVING or any(moves(child) for child in children[link])

    here = next(name for name in links if name not in joints)
    while children[here]:
        onward = [child for child in children[here] if moves(child)] or children[here]
        if len(onward) > 1:
            break
        here = onward[0]
    return here


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
    seen = {tip}
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
        tip = _link_name(joint, "parent")
        if tip in seen:
            raise WorkcellError(f"{path}: the joints form a loop at link '{tip}'; a robot must be a tree")
        seen.add(tip)
    if not chain:
        raise WorkcellError(f"{path}: no moving joint leads to the tip; choose a link at the end of the arm as the tip")
    return chain[::-1]


def settle_joints(chain: Sequence[ET.Element], path: Path) -> None:
    """Check the limits of the `chain`; turn continuous joints into revolute ones of +-2 pi, in place.

    Raises
    ------
    WorkcellError
        If a joint has no limits, or its lower limit is not below its upper limit.
    """
    for joint in chain:
        limit = joint.find("limit")
        if joint.get("type") == "continuous":
            joint.set("type", "revolute")
            limit = ET.SubElement(joint, "limit") if limit is None else limit
            for key, value in (("lower", -math.tau), ("upper", math.tau)):
                limit.set(key, repr(value))
            for key, value in (("velocity", math.pi), ("effort", 0.0)):
                limit.set(key, limit.get(key, repr(value)))
        bounds = [math.nan if limit is None else _number(limit.get(key, "0")) for key in ("lower", "upper")]
        if not (all(map(math.isfinite, bounds)) and bounds[0] < bounds[1]):
            raise WorkcellError(
                f"{path}: joint '{joint.get('name')}' needs a <limit> with finite lower and upper, lower < upper"
            )


def settle_names(root: ET.Element, chain: Sequence[ET.Element], path: Path) -> None:
    """Rename joints beside the `chain` that are called like a link, in place: Pinocchio looks both up by name alone.

    Raises
    ------
    WorkcellError
        If a joint of the chain is called like a link.
    """
    links = {link.get("name") for link in root.iterfind("link")}
    taken = links | {joint.get("name") for joint in root.iterfind("joint")}
    for joint in root.iterfind("joint"):
        name = joint.get("name", "")
        if name not in links:
            continue
        if joint in chain:
            raise WorkcellError(f"{path}: a link and a joint of the arm are both called '{name}'; rename one of them")
        new = name
        while new in taken:
            new += "_joint"
        taken.add(new)
        joint.set("name", new)
        for mimic in root.iterfind("joint/mimic"):
            if mimic.get("joint") == name:
                mimic.set("joint", new)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def settle_meshes(root: ET.Element, path: Path, package_dirs: Iterable[str | os.PathLike[str]]) -> None:
    """Make the file names of all collision meshes absolute, in place.

    ``package://name/...`` is looked up in `package_dirs` and in every folder above the URDF file, a
    relative name beside the URDF file. Meshes elsewhere than in the folder of the URDF file, in its own
    package and in `package_dirs` are reported in one warning.

    Raises
    ------
    WorkcellError
        If a mesh file is not found or broken.
    """
    folders = [*map(Path, package_dirs), *path.resolve().parents]
    found: dict[Path, None] = {}
    for mesh in root.iterfind("link/collision/geometry/mesh"):
        file = _mesh_file(mesh.get("filename", ""), path, folders)
        mesh.set("filename", str(file.resolve()))
        found[file] = None
    own = [folder for folder in path.resolve().parents if (folder / "package.xml").is_file()][:1]
    report_outside(path, found, [*map(Path, package_dirs), *own])
    for file in found:
        if file.suffix.lower() in MESH_SUFFIXES:
            _check_mesh(file, path)


def _mesh_file(name: str, path: Path, folders: Sequence[Path]) -> Path:
    """Return the file that `name` means in the URDF file at `path`; packages are looked up in `folders`."""
    scheme, _, rest = name.rpartition("://")
    relative = Path(rest)
    if scheme in ("package", "model") and relative.parts:
        inner = Path(*relative.parts[1:])
        candidates = [folder / relative for folder in folders]
        candidates += [folder / inner for folder in folders if folder.name == relative.parts[0]]
    else:
        candidates = [path.resolve().parent / relative]
    found = next((candidate for candidate in candidates if os.path.isfile(candidate)), None)
    if found is None:
        raise WorkcellError(f"{path}: mesh '{name}' is not found; name the folder of its package in package_dirs")
    return found


def _check_mesh(file: Path, path: Path) -> None:
    """Raise a WorkcellError if a mesh is broken."""
    try:
        read_triangles(file)
    except MeshError as error:
        raise WorkcellError(f"{path}: a collision mesh cannot be used: {error}") from error


@contextmanager
def meshes_written_anew(xml: bytes) -> Iterator[str]:
    """Yield `xml`, whose mesh files `settle_meshes` has checked, with copies of them that hold sound triangles only.

    The library that reads meshes for Pinocchio takes other lines of a damaged file for good than we do, and may then
    read memory that is not its own. Formats that we cannot read stay as they are.
    """
    root = ET.fromstring(xml)
    with tempfile.TemporaryDirectory() as folder:
        for number, mesh in enumerate(root.iterfind("link/collision/geometry/mesh")):
            file = Path(mesh.get("filename", ""))
            if file.suffix.lower() in MESH_SUFFIXES:
                copy = Path(folder) / f"{number}.stl"
                trimesh.Trimesh(*read_triangles(file), process=False).export(copy)
                mesh.set("filename", str(copy))
        yield ET.tostring(root, encoding="unicode")


def closest(name: str, known: Iterable[str]) -> list[str]:
    """Return the `known` names, those most like `name` first."""
    return sorted(known, key=lambda other: -difflib.SequenceMatcher(None, name.lower(), other.lower()).ratio())
