"""A proof of plans that shares no code with the planner and none with `RegraspPlan.residuals`.

Robot, end-effector, table, obstacles and clearances are read from the data files by hand; forward kinematics is a
product of URDF joint transforms; every pair of bodies gets its own `coal.distance`, the fingers where they stand at the
grasp width and where they stand while approaching. Of the problem only the mesh, the grasps and the placements are
taken. Robots with primitive bodies and obstacles that are boxes or cylinders are understood.
"""

from __future__ import annotations

import math
import sys
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import coal
import numpy as np
from scipy.optimize import nnls

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError
from regrasp_opt.planning import RegraspPlan, RegraspProblem, Transition

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DATA = Path(str(files("regrasp_opt"))) / "data"
TOLERANCE = 1e-4
"""How far a distance may fall short of its clearance [m]."""
RESTS = 1e-3
"""How far above the table the object may be where it touches it [m]."""
MISS = 2e-6
"""Largest entry of the difference between the tool pose that is reached and the one wanted [m or 1]."""

Solid = tuple[Any, FloatArray]
"""A Coal shape and its pose (4, 4)."""


def rotation(axis: Sequence[float], angle: float) -> FloatArray:
    """Return the rotation (3, 3) about the unit vector `axis` by `angle` [rad] (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K)


def frame(xyz: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)) -> FloatArray:
    """Return the pose (4, 4) of URDF coordinates [m] and roll, pitch, yaw [rad]."""
    T = np.eye(4)
    T[:3, :3] = rotation((0, 0, 1), rpy[2]) @ rotation((0, 1, 0), rpy[1]) @ rotation((1, 0, 0), rpy[0])
    T[:3, 3] = xyz
    return T


def _origin(element: ET.Element) -> FloatArray:
    found = element.find("origin")
    values = {} if found is None else found.attrib
    xyz, rpy = ([float(v) for v in values.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    return frame(xyz, rpy)


def _solid(collision: ET.Element) -> Any:
    shape = collision.find("geometry/*")
    if shape is not None and shape.tag == "cylinder":
        return coal.Cylinder(float(shape.attrib["radius"]), float(shape.attrib["length"]))
    if shape is not None and shape.tag == "sphere":
        return coal.Sphere(float(shape.attrib["radius"]))
    if shape is not None and shape.tag == "box":
        return coal.Box(*(float(v) for v in shape.attrib["size"].split()))
    raise OptionError("the second proof of plans knows robots of boxes, cylinders and spheres only")


def _slab(box: dict[str, Any]) -> Solid:
    """Return a box given by intervals in x, y, z."""
    low, high = np.array([box[axis] for axis in "xyz"], dtype=np.float64).T
    return coal.Box(*(high - low).tolist()), frame((low + high) / 2)


def _tool_body(part: dict[str, Any]) -> Solid:
    if "box" in part:
        return _slab(part["box"])
    low, high = part["cylinder"]["z"]
    return coal.Cylinder(part["cylinder"]["radius"], high - low), frame((0, 0, (low + high) / 2))


def _obstacle(part: dict[str, Any]) -> Solid:
    pose = frame(part["position"], part.get("rpy", (0.0, 0.0, 0.0)))
    if part["type"] == "box":
        return coal.Box(*part["size"]), pose
    if part["type"] == "cylinder":
        return coal.Cylinder(part["radius"], part["length"]), pose
    raise OptionError("the second proof of plans knows obstacles that are boxes or cylinders only")


def distance(a: Solid, b: Solid) -> float:
    """Return the distance of two bodies [m], negative or zero where they overlap."""
    (shape_a, T_a), (shape_b, T_b) = a, b
    transforms = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in (T_a, T_b)]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(shape_a, transforms[0], shape_b, transforms[1], request, result))


def _toml(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text("utf-8"))


class _Cell:
    """A workcell, from its files."""

    def __init__(self, name: str, source: str, override: str | None) -> None:
        path = DATA / "workcells" / f"{name}.toml" if source == "built-in" else Path(source)
        self.content = _toml(path)
        self.tool = _toml(_data_file(override or self.content["end_effector"]["model"], "end_effectors", path))
        section = self.content["robot"]
        model = section["model"]
        robot = ET.fromstring(_data_file(model, f"robots/{model}", path, ".urdf").read_text("utf-8"))
        self.T_world_base = frame(section.get("position", (0, 0, 0)), section.get("rpy", (0, 0, 0)))
        carrier = {_name(joint.find("child")): joint for joint in robot.iterfind("joint")}
        link, self.joints = section.get("tip", "flange"), list[ET.Element]()
        while link in carrier:
            self.joints.insert(0, carrier[link])
            link = _name(carrier[link].find("parent"))
        chain = [link, *(_name(joint.find("child")) for joint in self.joints)]
        bodies = {part.get("name"): part.findall("collision") for part in robot.iterfind("link")}
        self.bodies = [(n, _solid(c), _origin(c)) for n, name in enumerate(chain) for c in bodies[name]]
        limits = [joint.find("limit") for joint in self.joints if joint.get("type") == "revolute"]
        sides = ("lower", "upper")
        self.limits = np.array([[float(x.attrib[side]) for side in sides] for x in limits if x is not None])
        table = self.content["table"]
        thickness, self.height = table.get("thickness", 0.05), table.get("height", 0.0)
        middle = (*table["center"], self.height - thickness / 2)
        self.table: Solid = (coal.Box(*table["size"], thickness), frame(middle))
        self.obstacles = [_obstacle(part) for part in self.content.get("obstacles", ())]
        self.margins = {"arm": 0.005, "gripper": 0.003, "self_collision": 0.0, **self.content.get("clearance", {})}
        self.pre_opening = float(self.tool.get("pre_opening", 0.005))

    def link_frames(self, q: FloatArray) -> list[FloatArray]:
        """Return the world pose of every link of the chain, the flange last."""
        frames, angles = [self.T_world_base], iter(q)
        for joint in self.joints:
            T = frames[-1] @ _origin(joint)
            axis = joint.find("axis")
            if joint.get("type") == "revolute" and axis is not None:
                turn = np.eye(4)
                turn[:3, :3] = rotation([float(v) for v in axis.attrib["xyz"].split()], next(angles))
                T = T @ turn
            frames.append(T)
        return frames

    def fingers(self, opening: float) -> list[Solid]:
        """Return the two fingers in the flange frame, their inner faces `opening` [m] apart."""
        parts = []
        for finger in self.tool.get("finger", ()):
            box = finger["box"]
            low, high = box["y"]
            parts.append(_slab({**box, "y": [opening / 2 + low, opening / 2 + high]}))
            parts.append(_slab({**box, "y": [-opening / 2 - high, -opening / 2 - low]}))
        return parts


def _data_file(name: str, folder: str, beside: Path, suffix: str = ".toml") -> Path:
    path = DATA / folder / f"{name}{suffix}"
    return path if path.is_file() else beside.parent / name


def _name(element: ET.Element | None) -> str:
    return "" if element is None else element.get("link", "")


class Recheck:
    """The bodies of one object in its workcell, and its grasps."""

    def __init__(self, problem: RegraspProblem) -> None:
        cell = problem.workcell
        self.cell, self.grasps = _Cell(cell.name, cell.source, cell.end_effector_override), problem.grasps
        self.placements = [placement.pose for placement in problem.placements]
        self.vertices = np.array(problem.object.mesh.vertices)
        self.center_of_mass = np.array(problem.object.mesh.center_mass)
        self.mesh = coal.BVHModelOBBRSS()
        faces = np.array(problem.object.mesh.faces, dtype=np.int64)
        self.mesh.beginModel(len(faces), len(self.vertices))
        self.mesh.addVertices(self.vertices)
        self.mesh.addTriangles(faces)
        self.mesh.endModel()

    def problems(self, plan: RegraspPlan, grasps_of_transition: Callable[[Transition], Iterable[int]]) -> list[str]:
        """Return what is wrong with a solved plan; `grasps_of_transition` picks which rows of each are looked at."""
        wrong = [f"pose {i}: {text}" for i, T in enumerate(plan.poses) for text in self.pose_problems(T)]
        for i, T in enumerate(plan.poses[1:-1], start=1):
            if not self.is_stable_and_inside(T):
                wrong.append(f"pose {i} is no stable placement in the workspace")
        if len(plan.transitions) != len(plan.poses) - 1:
            wrong.append("a transition is missing")
        for i, transition in enumerate(plan.transitions):
            if len(transition.grasp_ids) == 0:
                wrong.append(f"transition {i} has no grasp")
            for k in grasps_of_transition(transition):
                g = int(transition.grasp_ids[k])
                for T, q in ((plan.poses[i], transition.q_pick[k]), (plan.poses[i + 1], transition.q_place[k])):
                    wrong += [f"transition {i}, grasp {g}: {text}" for text in self.grasp_problems(T, g, q)]
        return wrong

    def pose_problems(self, T: FloatArray) -> Iterator[str]:
        """Yield what keeps the object from standing at `T` (4, 4)."""
        lowest = (self.vertices @ T[2, :3] + T[2, 3]).min() - self.cell.height
        if abs(lowest) > RESTS:
            yield f"it is {lowest:.4f} m above the table"
        yield from self._support_problems(T, lowest)
        base = [(shape, self.cell.T_world_base @ placement) for link, shape, placement in self.cell.bodies if link == 0]
        for what, bodies in (("the robot's base", base), ("an obstacle", self.cell.obstacles)):
            if any(distance((self.mesh, T), body) <= 0 for body in bodies):
                yield f"it overlaps {what}"

    def _support_problems(self, T: FloatArray, lowest: float) -> Iterator[str]:
        """Yield whether the object stands beyond the table's edge, or its centre of mass beyond what it stands on."""
        points, table = self.vertices @ T[:3, :3].T + T[:3, 3], self.cell.content["table"]
        support = points[points[:, 2] - self.cell.height <= max(lowest + MISS, RESTS), :2]
        beyond = np.abs(support - table["center"]) - np.array(table["size"]) / 2
        if beyond.max() > MISS:
            yield "it stands over the edge of the table"
        center = T[:3, :3] @ self.center_of_mass + T[:3, 3]
        weights = np.vstack([support.T, np.ones(len(support))])
        if nnls(weights, np.array([*center[:2], 1.0]))[1] > MISS:  # no mean of these points
            yield "it would tip over"

    def is_stable_and_inside(self, T: FloatArray) -> bool:
        """Return whether `T` (4, 4) is a stable placement moved within the workspace."""
        space = self.cell.content["workspace"]
        for placement in self.placements:
            R = T[:3, :3] @ placement[:3, :3].T
            about_z = abs(R[2, 2] - 1) < 1e-9
            x, y, z = T[:3, 3] - R @ placement[:3, 3]
            inside = all(low - 1e-9 <= v <= high + 1e-9 for v, (low, high) in ((x, space["x"]), (y, space["y"])))
            if about_z and inside and abs(z) < 1e-6:
                return True
        return False

    def grasp_problems(self, T: FloatArray, grasp_id: int, q: FloatArray) -> Iterator[str]:
        """Yield what is wrong with holding the object at `T` (4, 4) by a grasp at configuration `q` (dof,)."""
        cell = self.cell
        if (q < cell.limits[:, 0] - 1e-9).any() or (q > cell.limits[:, 1] + 1e-9).any():
            yield "a joint is beyond its limit"
        frames = cell.link_frames(q)
        error = frames[-1] @ frame((0, 0, cell.tool["tcp_offset"])) - T @ self.grasps.T_object_tcp[grasp_id]
        if np.abs(error).max() > MISS:
            yield f"the arm misses the grasp by {np.abs(error).max():.2g}"
        least = min((distance(a, b) - margin, what) for a, b, margin, what in self._pairs(frames, T, grasp_id))
        if least[0] < -TOLERANCE:
            yield f"{least[1]} are {-least[0]:.2g} m nearer than they may be"

    def _pairs(
        self, frames: list[FloatArray], T: FloatArray, grasp_id: int
    ) -> Iterator[tuple[Solid, Solid, float, str]]:
        cell, margins, width = self.cell, self.cell.margins, float(self.grasps.width[grasp_id])
        arm = [(link, (shape, frames[link] @ placement)) for link, shape, placement in cell.bodies]
        last = len(frames) - 2  # the flange moves with the last link
        surroundings = [("table", cell.table), *(("obstacle", body) for body in cell.obstacles)]

        def placed(parts: list[Solid]) -> list[Solid]:
            return [(shape, frames[-1] @ pose) for shape, pose in parts]

        palm = placed([_tool_body(part) for part in cell.tool["body"]])
        closed, opened = placed(cell.fingers(width)), placed(cell.fingers(width + 2 * cell.pre_opening))
        held = (self.mesh, T)
        for body in (*palm, *closed, *opened):
            for name, fixed in surroundings:
                yield body, fixed, margins["gripper"], f"gripper and {name}"
            for link, other in arm:
                if link < last:
                    yield body, other, margins["self_collision"], f"gripper and link {link}"
        for body in (*palm, *opened):
            yield body, held, 0.0, "gripper and object"
        for body in cell.obstacles:
            yield held, body, margins["gripper"], "object and obstacle"
        for link, body in arm:
            if link == 0:
                yield held, body, margins["gripper"], "object and base"
            else:
                for name, fixed in surroundings:
                    yield body, fixed, margins["arm"], f"link {link} and {name}"
                yield body, held, margins["arm"], f"link {link} and object"
            for other_link, other in arm:
                if other_link + 1 < link:
                    yield body, other, margins["self_collision"], f"links {other_link} and {link}"
