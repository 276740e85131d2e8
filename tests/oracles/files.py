"""Readers of workcell, end-effector, mesh and URDF files that share nothing with the package's own."""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field, replace
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

# The data of the package under test, wherever it is installed; finding a package runs none of it.
_PACKAGE = find_spec("regrasp_opt")
assert _PACKAGE is not None and _PACKAGE.origin is not None, "regrasp_opt is not installed"
DATA = Path(_PACKAGE.origin).parent / "data"
EXAMPLES = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
TIPS = "tool0", "flange", "ee_link"
MOVING = "revolute", "continuous", "prismatic"


def frame(xyz=(0.0, 0.0, 0.0), rpy=(0.0, 0.0, 0.0)):
    """Return the pose (4, 4) of a position [m] and URDF's roll, pitch, yaw [rad]."""
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", rpy).as_matrix()
    T[:3, 3] = xyz
    return T


def read_mesh(path, scale=1.0):
    """Return vertices (V, 3) [m] and triangles (F, 3) of a mesh file; vertices of equal position are one."""
    if str(path).lower().endswith(".stl") and (corners := _binary_stl(Path(path))) is not None:
        vertices, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    else:
        loaded = trimesh.load_mesh(path, process=False)  # of a DAE file, in metres
        loaded = loaded.to_geometry() if isinstance(loaded, trimesh.Scene) else loaded
        vertices, faces = np.asarray(loaded.vertices, dtype=np.float64), np.asarray(loaded.faces)
    vertices, index = np.unique(vertices, axis=0, return_inverse=True)
    faces = index.reshape(-1)[faces]
    proper = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return vertices * np.asarray(scale, dtype=np.float64), faces[proper]


def _binary_stl(path):
    content = path.read_bytes()
    count = int.from_bytes(content[80:84], "little")
    if len(content) < 84 + 50 * count or count == 0:
        return None
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
    return np.frombuffer(content, record, count, 84)["corners"].astype(np.float64)


def read_object(reference):
    """Return vertices (V, 3) [m] and triangles (F, 3) of the object that a plan file names."""
    options = {key: reference[key] for key in ("scale", "repair", "thickness") if key in reference}
    if reference["source"] == "built-in" or reference.get("repair") or reference.get("thickness"):
        from regrasp_opt.objects import load_object  # no file holds these meshes

        name = reference["name"] if reference["source"] == "built-in" else reference["source"]
        body = load_object(name, **options)
        return np.array(body.vertices), np.array(body.faces)
    return read_mesh(reference["source"], reference.get("scale", 1.0))


@dataclass
class Shape:
    """A body in the frame of what carries it: ``kind`` is box (full edges), cylinder (radius, length) or mesh."""

    name: str
    kind: str
    T: np.ndarray
    size: Any = None
    vertices: Any = None
    faces: Any = None


@dataclass
class Tool:
    """An end-effector file; fingers are (low, high) corners at zero opening, the pad (low, high) in x and z."""

    kind: str
    tcp_offset: float
    pre_opening: float
    cup_radius: float
    max_opening: float
    body: list[Shape]
    fingers: list[np.ndarray]
    pad: np.ndarray | None


@dataclass
class Board:
    """A table, a shelf board or a tilted plate.

    Attributes
    ----------
    T : (4, 4) array
        Where the middle of its top is in the world, z along the outward normal.
    center, size : (2,)
        The middle of the top in the coordinates of its plane, and its edges [m].
    space : dict
        The workspace, low and high in ``x`` and ``y``, in the same coordinates [m].
    friction : float
        Tangent of the angle up to which it may be tilted.
    """

    name: str
    T: np.ndarray
    center: Any
    size: Any
    thickness: float
    space: dict[str, Any]
    friction: float = 0.5

    def seen(self, points):
        """Return world `points` (..., 3) in the coordinates of the plane, with their heights above it."""
        return (points - self.T[:3, 3]) @ self.T[:3, :3] + [*self.center, 0.0]

    @property
    def bodies(self):
        """The board itself in the world."""
        return [Shape(self.name, "box", self.T @ frame((0, 0, -self.thickness / 2)), (*self.size, self.thickness))]


@dataclass
class Nest:
    """A fixture: its bodies in the world, and for each pose (4, 4) in which it holds an object, which one or None."""

    name: str
    bodies: list[Shape]
    poses: list[tuple[np.ndarray, str | None]]


@dataclass
class Cell:
    """A workcell file, with what it names."""

    path: Path
    T_world_base: np.ndarray
    robot: RobotFile
    tool: Tool
    supports: list[Board | Nest]
    obstacles: list[Shape]
    clearance: dict[str, float]
    ignored: set[frozenset[str]] = field(default_factory=set)


def read_cell(reference):
    """Return the cell that a plan file names by ``source``, ``name`` and ``end_effector``, with what it adds."""
    built_in = reference["source"] == "built-in"
    path = DATA / "workcells" / f"{reference['name']}.toml" if built_in else Path(reference["source"])
    content = _toml(path)
    if content["schema"] == 1:
        section, tool = content["robot"], content["end_effector"]["model"]
        model = section["model"]
        supports = [_board({"name": "table", **content["table"], "workspace": content["workspace"]})]
    else:
        (section,) = content["arms"]
        model, tool = section["robot"], section["end_effector"]
        supports = [_support(part, path.parent) for part in content["supports"]]
    ignored = [*section.get("ignore_collisions", []), *_disabled(section, path.parent)]
    if _bare(model):
        defaults = _toml(DATA / "robots" / model / f"{model}.toml")
        urdf = EXAMPLES / defaults["urdf"] if "urdf" in defaults else DATA / "robots" / model / f"{model}.urdf"
        section, ignored = {**defaults, **section}, ignored + defaults["ignore_collisions"]
    else:
        urdf = path.parent / model
    packages = [path.parent / folder for folder in section.get("package_dirs", [])]
    tool = reference.get("end_effector") or tool
    tool_path = DATA / "end_effectors" / f"{tool}.toml" if _bare(tool) else path.parent / tool
    added = [part for part in reference.get("obstacles", []) if part["added"]]
    return Cell(
        path,
        frame(section.get("position", (0, 0, 0)), section.get("rpy", (0, 0, 0))),
        read_urdf(urdf, section.get("tip"), packages, changes=section),
        read_tool(tool_path),
        supports,
        [_obstacle(part, path.parent) for part in [*content.get("obstacles", []), *added]],
        {"arm": 0.005, "gripper": 0.003, "self_collision": 0.0, **content.get("clearance", {})},
        {frozenset(pair) for pair in ignored},
    )


def _disabled(section, folder):
    """Return the pairs of links that the SRDF file of a robot's section says are never tested."""
    if "srdf" not in section:
        return []
    pairs = ET.parse(folder / section["srdf"]).getroot().iterfind("disable_collisions")
    return [(pair.get("link1"), pair.get("link2")) for pair in pairs]


def _toml(path):
    return tomllib.loads(Path(path).read_text("utf-8"))


def _bare(name):
    return "/" not in name and "\\" not in name and "." not in name


def _support(part, folder):
    if part.get("kind", "board") == "board":
        return _board(part)
    T = frame(part["position"], part.get("rpy", (0, 0, 0)))
    bodies = [_obstacle(body, folder) for body in part.get("bodies", [])]
    bodies = [replace(body, name=f"{part['name']} {body.name}", T=T @ body.T) for body in bodies]
    poses = [(T @ frame(held["position"], held.get("rpy", (0, 0, 0))), held.get("object")) for held in part["poses"]]
    return Nest(part["name"], bodies, poses)


def _board(part):
    """Return the board that turns about the middle of its top; without a workspace 5 cm, or a quarter, are kept."""
    center, size = np.array(part["center"], dtype=float), np.array(part["size"], dtype=float)
    T = frame((*center, part.get("height", 0.0)), part.get("rpy", (0, 0, 0)))
    free = size / 2 - np.minimum(0.05, size / 4)
    whole = dict(zip("xy", np.column_stack([center - free, center + free]), strict=True))
    space, friction = part.get("workspace", whole), part.get("friction", 0.5)
    return Board(part["name"], T, center, size, part.get("thickness", 0.05), space, friction)


def _obstacle(part, folder):
    T = frame(part["position"], part.get("rpy", (0, 0, 0)))
    if part["type"] == "box":
        return Shape(part["name"], "box", T, part["size"])
    if part["type"] == "cylinder":
        return Shape(part["name"], "cylinder", T, (part["radius"], part["length"]))
    if "vertices" in part:
        return Shape(part["name"], "mesh", T, None, np.array(part["vertices"]), np.array(part["faces"]))
    vertices, faces = read_mesh(folder / part["file"], part.get("scale", 1.0))
    return Shape(part["name"], "mesh", T, None, vertices, faces)


def read_tool(path):
    """Return the end-effector in the file `path`."""
    content = _toml(path)
    body = []
    for part in content["body"]:
        if "box" in part:
            low, high = np.array([part["box"][axis] for axis in "xyz"], dtype=float).T
            body.append(Shape(part["name"], "box", frame((low + high) / 2), high - low))
        else:
            low, high = part["cylinder"]["z"]
            size = part["cylinder"]["radius"], high - low
            body.append(Shape(part["name"], "cylinder", frame((0, 0, (low + high) / 2)), size))
    fingers = [np.array([part["box"][axis] for axis in "xyz"], dtype=float).T for part in content.get("finger", [])]
    parallel = content["kind"] == "parallel"
    pre_opening = content.get("pre_opening", 0.005) if parallel else 0.0
    lengths = content.get("cup_radius", 0.0), content.get("max_opening", 0.0)
    pad = content.get("pad")
    area = np.array([pad["x"], pad["z"]], dtype=float).T if pad else _fingertip(fingers)
    return Tool(content["kind"], content["tcp_offset"], pre_opening, *lengths, body, fingers, area)


def _fingertip(fingers):
    """Return (low, high) in x and z of the inner faces of the boxes that reach farthest, those nearest the middle."""
    if not fingers:
        return None
    far = [box for box in fingers if box[1, 2] >= max(box[1, 2] for box in fingers) - 1e-9]
    inner = [box for box in far if box[0, 1] <= min(box[0, 1] for box in far) + 1e-9]
    return np.array([np.min([box[0, ::2] for box in inner], axis=0), np.max([box[1, ::2] for box in inner], axis=0)])


@dataclass
class RobotFile:
    """A URDF that MuJoCo can read, with its meshes beside it.

    Attributes
    ----------
    xml : str
        Links, joints and collision bodies; meshes are called ``0.stl``, ``1.stl``, ...
    meshes : list of (vertices, faces)
        These meshes in metres, scaled.
    joints : list of str
        The moving joints from the base to the tip.
    group : dict of str to int
        For each link the number of the last of these joints that moves it; 0 for what never moves.
    seat : str
        The link in which the first of them turns.
    joined : set of frozenset
        The two links that each of them connects.
    """

    xml: str
    meshes: list[Any]
    tip: str
    joints: list[str]
    group: dict[str, int]
    seat: str
    joined: set[frozenset[str]]
    limits: np.ndarray
    speeds: np.ndarray


def read_urdf(path, tip=None, packages=(), content=None, changes=None):
    """Return the robot in the URDF file `path`, or what was made of it, made ready for MuJoCo.

    `changes` has the keys `leave_out`, `locked`, `tip_position` and `tip_rpy` of a workcell's robot.
    """
    root = ET.fromstring(Path(path).read_text("utf-8") if content is None else content)
    tip = _change(root, tip, changes or {})
    kept = ET.Element("robot", name=root.get("name") or "robot")
    options = {"strippath": "false", "fusestatic": "false", "discardvisual": "true", "balanceinertia": "true"}
    options |= {"boundmass": "0.001", "boundinertia": "1e-6"}
    ET.SubElement(ET.SubElement(kept, "mujoco"), "compiler", options)
    meshes: list[Any] = []
    for link in root.iterfind("link"):
        copy = ET.SubElement(kept, "link", name=_link(link.get("name")))
        for collision in link.iterfind("collision"):
            collision.attrib.pop("name", None)
            mesh = collision.find("geometry/mesh")
            if mesh is not None:
                scale = [float(v) for v in mesh.get("scale", "1 1 1").split()]
                meshes.append(read_mesh(_mesh_file(mesh.attrib["filename"], Path(path), packages), scale))
                mesh.attrib.clear()
                mesh.set("filename", f"{len(meshes) - 1}.stl")
            copy.append(collision)
    for joint in root.iterfind("joint"):
        for tag in ("parent", "child"):
            joint.find(tag).set("link", _link(joint.find(tag).get("link")))
        for tag in ("mimic", "dynamics", "safety_controller", "calibration"):
            for element in joint.findall(tag):
                joint.remove(element)
        kept.append(joint)
    carrier = {joint.find("child").get("link"): joint for joint in kept.iterfind("joint")}
    chain, here = [], _link(tip)
    while here in carrier:
        chain[:0] = [carrier[here]] if carrier[here].get("type") in MOVING else []
        here = carrier[here].find("parent").get("link")
    number = {joint.get("name"): n for n, joint in enumerate(chain, start=1)}

    def group(link):
        while link in carrier:
            if carrier[link].get("name") in number:
                return number[carrier[link].get("name")]
            link = carrier[link].find("parent").get("link")
        return 0

    groups = {link.get("name"): group(link.get("name")) for link in kept.iterfind("link")}
    return RobotFile(
        ET.tostring(kept, encoding="unicode"),
        meshes,
        _link(tip),
        [joint.get("name") for joint in chain],
        groups,
        chain[0].find("parent").get("link"),
        {frozenset(joint.find(tag).get("link") for tag in ("parent", "child")) for joint in chain},
        np.array([_limits(joint) for joint in chain]),
        np.array([_number(joint, "velocity", np.pi) for joint in chain]),
    )


def _change(root, tip, changes):
    """Leave out links, lock joints and add the seat of the tool, in place; return the tip."""
    gone = set(changes.get("leave_out", ()))
    for _ in root.findall("link"):  # until nothing more hangs from what is gone
        gone |= {j.find("child").get("link") for j in root.iterfind("joint") if j.find("parent").get("link") in gone}
    for element in [*root.findall("link"), *root.findall("joint")]:
        if (element.get("name") if element.tag == "link" else element.find("child").get("link")) in gone:
            root.remove(element)
    for name, value in changes.get("locked", {}).items():
        joint = next(joint for joint in root.iterfind("joint") if joint.get("name") == name)
        at, axis = joint.find("origin"), joint.find("axis")
        at = {} if at is None else at.attrib
        T = frame(*(np.array(at.get(key, "0 0 0").split(), dtype=float) for key in ("xyz", "rpy")))
        way = np.array([1.0, 0.0, 0.0] if axis is None else axis.get("xyz").split(), dtype=float)
        way *= value / np.linalg.norm(way)
        moved = np.eye(4)
        if joint.get("type") == "prismatic":
            moved[:3, 3] = way
        else:
            moved[:3, :3] = Rotation.from_rotvec(way).as_matrix()
        T = T @ moved
        for element in [element for element in joint if element.tag not in ("parent", "child")]:
            joint.remove(element)
        joint.set("type", "fixed")
        rpy = Rotation.from_matrix(T[:3, :3]).as_euler("xyz")
        ET.SubElement(joint, "origin", xyz=" ".join(map(str, T[:3, 3])), rpy=" ".join(map(str, rpy)))
    tip = tip or _default_tip(root, {joint.find("child").get("link"): joint for joint in root.iterfind("joint")})
    if "tip_position" in changes or "tip_rpy" in changes:
        seat = ET.SubElement(root, "joint", name="seat of the tool", type="fixed")
        ET.SubElement(seat, "parent", link=tip)
        tip = ET.SubElement(root, "link", name="seat of the tool").get("name")
        ET.SubElement(seat, "child", link=tip)
        xyz, rpy = (" ".join(map(str, changes.get(key, (0, 0, 0)))) for key in ("tip_position", "tip_rpy"))
        ET.SubElement(seat, "origin", xyz=xyz, rpy=rpy)
    return tip


def _link(name):
    return "the_world" if name == "world" else name  # MuJoCo keeps this name for itself


def _number(joint, key, default):
    limit = joint.find("limit")
    return default if limit is None else float(limit.get(key, default))


def _limits(joint):
    if joint.get("type") == "continuous":
        return -np.inf, np.inf
    return _number(joint, "lower", 0.0), _number(joint, "upper", 0.0)


def _default_tip(root, carrier):
    links = [link.get("name") for link in root.iterfind("link")]
    for name in TIPS:
        if name in links:
            return name

    def children(link):
        return [child for child, joint in carrier.items() if joint.find("parent").get("link") == link]

    def moves(link):
        return carrier[link].get("type") in MOVING or any(moves(child) for child in children(link))

    def jaw(link):
        joint = carrier[link]
        named = re.search("grip|finger|jaw|claw|knuckle", f"{joint.get('name')} {link}", re.IGNORECASE)
        return joint.get("type") in MOVING and (named is not None or joint.find("mimic") is not None)

    here, arm = next(link for link in links if link not in carrier), False
    while children(here):
        onward = [child for child in children(here) if moves(child)] or children(here)
        if len(onward) > 1 or (arm and jaw(onward[0])):
            break
        here = onward[0]
        arm = arm or (carrier[here].get("type") in MOVING and not jaw(here))
    return here


def _mesh_file(name, urdf, packages):
    if not name.startswith(("package://", "model://")):
        return urdf.parent / name.removeprefix("file://")
    package, _, rest = name.split("://", 1)[1].partition("/")
    for folder in [*packages, *urdf.resolve().parents]:
        for candidate in (folder / package / rest, folder / rest):
            named = candidate == folder / package / rest or _package_name(folder) == package
            if named and candidate.is_file():
                return candidate
    raise FileNotFoundError(f"{name} of {urdf}")


def _package_name(folder):
    manifest = folder / "package.xml"
    return ET.parse(manifest).getroot().findtext("name") if manifest.is_file() else None
