"""A proof of plans that shares no code with the package.

Robot, gripper, table and clearances are read from the data files by hand; forward kinematics is a product of URDF
joint transforms; every pair of bodies gets its own `coal.distance`, the fingers where they stand at the grasp width
and where they stand while approaching.
"""

import math
import sys
import xml.etree.ElementTree as ET
from importlib.resources import files

import coal
import numpy as np

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

DATA = files("regrasp_opt") / "data"
TOLERANCE = 1e-4


def rotation(axis, angle):
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * K @ K


def frame(xyz, rpy=(0.0, 0.0, 0.0)):
    T = np.eye(4)
    T[:3, :3] = rotation((0, 0, 1), rpy[2]) @ rotation((0, 1, 0), rpy[1]) @ rotation((1, 0, 0), rpy[0])
    T[:3, 3] = xyz
    return T


def origin(element):
    found = element.find("origin")
    values = {} if found is None else found.attrib
    xyz, rpy = ([float(v) for v in values.get(key, "0 0 0").split()] for key in ("xyz", "rpy"))
    return frame(xyz, rpy)


def solid(collision):
    shape = collision.find("geometry")[0]
    size = {key: value for key, value in shape.attrib.items()}
    if shape.tag == "cylinder":
        return coal.Cylinder(float(size["radius"]), float(size["length"]))
    if shape.tag == "sphere":
        return coal.Sphere(float(size["radius"]))
    assert shape.tag == "box"
    return coal.Box(*(float(v) for v in size["size"].split()))


def slab(box):
    """Return a box given by intervals in x, y, z and its pose."""
    low, high = np.array([box[axis] for axis in "xyz"], dtype=np.float64).T
    return coal.Box(*(high - low).tolist()), frame((low + high) / 2)


def distance(a, b):
    (shape_a, T_a), (shape_b, T_b) = a, b
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return float(coal.distance(shape_a, coal.Transform3s(T_a[:3, :3], T_a[:3, 3]),
                               shape_b, coal.Transform3s(T_b[:3, :3], T_b[:3, 3]), request, result))  # fmt: skip


class Cell:
    """The built-in workcell nova2-w, from its files."""

    def __init__(self):
        self.cell = tomllib.loads((DATA / "workcells" / "nova2-w.toml").read_text("utf-8"))
        self.tool = tomllib.loads((DATA / "end_effectors" / "w.toml").read_text("utf-8"))
        robot = ET.fromstring((DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8"))
        carrier = {joint.find("child").get("link"): joint for joint in robot.iterfind("joint")}
        link, self.joints = "flange", []
        while link in carrier:
            self.joints.insert(0, carrier[link])
            link = carrier[link].find("parent").get("link")
        chain = [link, *(joint.find("child").get("link") for joint in self.joints)]
        bodies = {part.get("name"): part.findall("collision") for part in robot.iterfind("link")}
        self.bodies = [(n, solid(c), origin(c)) for n, name in enumerate(chain) for c in bodies[name]]
        limits = [joint.find("limit") for joint in self.joints if joint.get("type") == "revolute"]
        self.limits = np.array([[float(limit.get(side)) for side in ("lower", "upper")] for limit in limits])
        table = self.cell["table"]
        middle = (*table["center"], table["height"] - table["thickness"] / 2)
        self.table = (coal.Box(*table["size"], table["thickness"]), frame(middle))
        assert "obstacles" not in self.cell and self.cell["robot"]["position"] == [0.0, 0.0, 0.0]

    def link_frames(self, q):
        """Return the pose of every link of the chain, the flange last."""
        frames, angles = [np.eye(4)], iter(q)
        for joint in self.joints:
            T = frames[-1] @ origin(joint)
            if joint.get("type") == "revolute":
                turn = np.eye(4)
                turn[:3, :3] = rotation([float(v) for v in joint.find("axis").get("xyz").split()], next(angles))
                T = T @ turn
            frames.append(T)
        return frames

    def fingers(self, opening):
        """Return the two fingers in the flange frame, their inner faces `opening` apart."""
        parts = []
        for finger in self.tool["finger"]:
            box = finger["box"]
            low, high = box["y"]
            parts.append(slab({**box, "y": [opening / 2 + low, opening / 2 + high]}))
            parts.append(slab({**box, "y": [-opening / 2 - high, -opening / 2 - low]}))
        return parts


class Recheck:
    """The bodies of one object in the built-in workcell, and its grasps."""

    def __init__(self, problem):
        self.cell, self.grasps = Cell(), problem.grasps
        self.placements = [placement.pose for placement in problem.placements]
        self.vertices = np.array(problem.object.mesh.vertices)
        self.mesh = coal.BVHModelOBBRSS()
        faces = np.array(problem.object.mesh.faces, dtype=np.int64)
        self.mesh.beginModel(len(faces), len(self.vertices))
        self.mesh.addVertices(self.vertices)
        self.mesh.addTriangles(faces)
        self.mesh.endModel()

    def problems(self, plan, grasps_of_transition):
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

    def pose_problems(self, T):
        lowest = (self.vertices @ T[2, :3] + T[2, 3]).min() - self.cell.cell["table"]["height"]
        if abs(lowest) > 1e-3:
            yield f"it is {lowest:.4f} m above the table"
        base = [(shape, placement) for link, shape, placement in self.cell.bodies if link == 0]
        if min(distance((self.mesh, T), body) for body in base) <= 0:
            yield "it overlaps the robot's base"

    def is_stable_and_inside(self, T):
        space = self.cell.cell["workspace"]
        for placement in self.placements:
            R = T[:3, :3] @ placement[:3, :3].T
            about_z = abs(R[2, 2] - 1) < 1e-9
            x, y, z = T[:3, 3] - R @ placement[:3, 3]
            inside = all(low - 1e-9 <= v <= high + 1e-9 for v, (low, high) in ((x, space["x"]), (y, space["y"])))
            if about_z and inside and abs(z) < 1e-6:
                return True
        return False

    def grasp_problems(self, T, grasp_id, q):
        cell, margins = self.cell, self.cell.cell["clearance"]
        if (q < cell.limits[:, 0] - 1e-9).any() or (q > cell.limits[:, 1] + 1e-9).any():
            yield "a joint is beyond its limit"
        frames = cell.link_frames(q)
        error = frames[-1] @ frame((0, 0, cell.tool["tcp_offset"])) - T @ self.grasps.T_object_tcp[grasp_id]
        if np.abs(error).max() > 2e-6:
            yield f"the arm misses the grasp by {np.abs(error).max():.2g}"
        least = min((distance(a, b) - margin, what) for a, b, margin, what in self.pairs(frames, T, grasp_id, margins))
        if least[0] < -TOLERANCE:
            yield f"{least[1]} are {-least[0]:.2g} m nearer than they may be"

    def pairs(self, frames, T, grasp_id, margins):
        cell, width = self.cell, float(self.grasps.width[grasp_id])
        arm = [(link, (shape, frames[link] @ placement)) for link, shape, placement in cell.bodies]
        last = len(frames) - 2  # the flange moves with the last link

        def placed(parts):
            return [(shape, frames[-1] @ pose) for shape, pose in parts]

        palm = placed([slab(part["box"]) for part in cell.tool["body"]])
        closed, opened = placed(cell.fingers(width)), placed(cell.fingers(width + 2 * cell.tool["pre_opening"]))
        held = (self.mesh, T)
        for body in (*palm, *closed, *opened):
            yield body, cell.table, margins["gripper"], "gripper and table"
            for link, other in arm:
                if link < last:
                    yield body, other, margins["self_collision"], f"gripper and link {link}"
        for body in (*palm, *opened):
            yield body, held, 0.0, "gripper and object"
        for link, body in arm:
            if link > 0:
                yield body, cell.table, margins["arm"], f"link {link} and table"
                yield body, held, margins["arm"], f"link {link} and object"
            for other_link, other in arm:
                if other_link + 1 < link:
                    yield body, other, margins["self_collision"], f"links {other_link} and {link}"
