"""How a workcell and an object were understood, as data that JSON can hold: SI units, radians.

`regrasp-opt inspect` prints it. Nothing is decided here: that is up to the functions that it asks.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import coal
import numpy as np
import trimesh

from regrasp_opt.conventions import FloatArray
from regrasp_opt.geometry.mesh_files import read_triangles
from regrasp_opt.geometry.shapes import Shape, shape_geometry
from regrasp_opt.objects import ObjectModel
from regrasp_opt.objects.changes import compare
from regrasp_opt.objects.placements import rejected_placements
from regrasp_opt.objects.rolling import LEAST_MARGIN
from regrasp_opt.planning.problem import RegraspProblem
from regrasp_opt.robots import Robot, urdf
from regrasp_opt.scene import Fixture, Support, Workcell

Data = dict[str, Any]


def describe_workcell(workcell: Workcell) -> Data:
    """Return the robot, the end-effector, supports, obstacles and clearances of `workcell`."""
    return {
        "name": workcell.name,
        "source": workcell.source,
        "robot": describe_robot(workcell.arm.robot) | {"position": workcell.arm.T_world_base[:3, 3].tolist()},
        "end_effector": _describe_end_effector(workcell),
        "supports": [_support(support) for support in workcell.supports],
        "obstacles": [_shape(shape) | {"position": shape.pose[:3, 3].tolist()} for shape in workcell.obstacles],
        "clearance": {
            "arm": workcell.clearance.arm,
            "gripper": workcell.clearance.gripper,
            "self_collision": workcell.clearance.self_collision,
        },
    }


def _support(support: Support | Fixture) -> Data:
    common = {"name": support.name, "height": support.height, "weight": support.weight}
    if isinstance(support, Fixture):
        return {**common, "poses": [pose.name for pose in support.poses], "bodies": list(map(_shape, support.shapes))}
    space = {"x": list(support.workspace.x), "y": list(support.workspace.y)}
    sizes = {"center": support.center.tolist(), "size": support.size.tolist(), "thickness": support.thickness}
    return {**common, **sizes, "tilt": float(np.degrees(np.arctan(support.slope))), "workspace": space}


def describe_robot(robot: Robot) -> Data:
    """Return joints, links with their bodies, the tip, inverse kinematics and untested pairs of `robot`."""
    keys = ("name", "slides", "lower", "upper", "speed", "home")
    values = (robot.chain.prismatic, robot.lower, robot.upper, robot.velocity_limits, robot.home)
    columns = (robot.joint_names, *(array.tolist() for array in values))
    joints = [dict(zip(keys, row, strict=True)) for row in zip(*columns, strict=True)]
    return {
        "name": robot.name,
        "file": robot.urdf_path,
        "joints": joints,
        "reach": robot.max_reach,
        "tip": {"link": robot.tip_frame, "why": _why_tip(robot)},
        "bodies": _bodies(robot),
        "links_without_body": robot.links_without_body(),
        "inverse_kinematics": robot.ik_test._asdict(),
        "never_tested": _never_tested(robot),
    }


def _why_tip(robot: Robot) -> str:
    root = urdf.parse_xml(robot.urdf)
    if robot.tip_frame != urdf.default_tip(root, urdf.joint_of_child(root, Path(robot.urdf_path))).link:
        return "it was asked for"
    return "a link of that name is taken as the tip" if robot.tip_frame in urdf.PREFERRED_TIPS else "the arm ends there"


def _bodies(robot: Robot) -> list[Data]:
    """Return each link that has bodies: what moves it, and their kinds and sizes."""
    links: dict[str, Data] = {}
    for index, item in enumerate(robot.collision.geometryObjects):
        name = robot.link_of(index)
        if index in robot.obstacles:
            moved_by = "stands still, an obstacle"
        else:
            moved_by = robot.model.names[item.parentJoint] if item.parentJoint else "stands still, carries the arm"
        link = links.setdefault(name, {"link": name, "moved_by": moved_by, "bodies": []})
        link["bodies"].append(_geometry(item.geometry))
    return list(links.values())


def _never_tested(robot: Robot) -> list[Data]:
    """Return the pairs of links with bodies on different joints that are never tested, and why."""
    items = robot.collision.geometryObjects
    tested = {frozenset(map(robot.link_of, pair)) for pair in robot.self_collision_pairs()}
    joint_of = {robot.link_of(index): item.parentJoint for index, item in enumerate(items)}
    links = list(joint_of)
    found = []
    for k, a in enumerate(links):
        for b in links[k + 1 :]:
            if joint_of[a] == joint_of[b] or frozenset((a, b)) in tested:
                continue
            named = frozenset((a, b)) in robot.ignored
            why = "ignore_collisions or the SRDF names them" if named else "a joint connects them"
            found.append({"links": [a, b], "why": why})
    return found


def _describe_end_effector(workcell: Workcell) -> Data:
    effector = workcell.arm.end_effector
    data: Data = {
        "name": effector.name,
        "kind": effector.kind,
        "source": effector.source,
        "tcp_offset": effector.tcp_offset,
        "bodies": [_shape(shape) for shape in (*effector.body, *effector.finger_boxes(effector.max_opening))],
    }
    if effector.kind == "suction":
        return data | {"cup_radius": effector.cup_radius}
    pad = {"x": list(effector.pad.x), "z": list(effector.pad.z)}
    return data | {"max_opening": effector.max_opening, "pre_opening": effector.pre_opening, "pad": pad}


def describe_object(model: ObjectModel) -> Data:
    """Return size, mass properties, what was changed, and the ways of resting of `model`."""
    mesh = model.mesh
    radii = np.sqrt(np.linalg.eigvalsh(mesh.moment_inertia) / mesh.mass)
    if model.mass is not None and model.inertia is not None:
        radii = np.sqrt(np.linalg.eigvalsh(model.inertia) / model.mass)
    rejected = rejected_placements(mesh, center_of_mass=model.center_of_mass)
    return {
        "name": model.name,
        "source": model.source,
        "scale": model.scale,
        "size": mesh.extents.tolist(),
        "vertices": len(mesh.vertices),
        "faces": len(mesh.faces),
        "volume": float(mesh.volume),
        "center_of_mass": model.center_of_mass.tolist(),
        "mass": model.mass,
        "inertia": None if model.inertia is None else model.inertia.tolist(),
        "mass_properties_given": sorted(model.given.given()),
        "radii_of_gyration": radii.tolist(),
        "repair": model.repair,
        "thickness": model.thickness,
        "changes": _changes(model),
        "placements": [
            _placement(model, p.pose) | {"number": i, "margin": p.margin} for i, p in enumerate(model.placements)
        ],
        "rejected": [
            _placement(model, r.placement.pose) | {"margin": r.placement.margin, "why": r.reason} for r in rejected
        ],
        "least_margin": LEAST_MARGIN,
    }


def _placement(model: ObjectModel, pose: FloatArray) -> Data:
    heights = model.vertices @ pose[2, :3]
    return {"height": float(np.ptp(heights)), "center_height": float(model.center_of_mass @ pose[2, :3] + pose[2, 3])}


def _changes(model: ObjectModel) -> Data | None:
    """Return what became of the surfaces in the object's file; None if they were taken as they are."""
    if model.source == "built-in":
        return None
    vertices, faces = read_triangles(Path(model.source))
    found = compare(trimesh.Trimesh(vertices * model.scale, faces), model.mesh)
    return None if found is None else found._asdict()


def describe_grasps(problem: RegraspProblem) -> Data:
    """Return the number of grasps, their widths, and how many of them the table leaves at each placement."""
    grasps = problem.grasps
    left = np.isnan(problem.table_rule.point[..., 0]).sum(axis=1)
    return {
        "count": len(grasps),
        "source": "sampled now" if problem.model_folder is None else str(problem.model_folder),
        "widths": [float(grasps.width.min()), float(grasps.width.max())],
        "left_by_table": left.tolist(),
    }


def _shape(shape: Shape) -> Data:
    """Return name, kind and size [m] of a shape."""
    return {"name": shape.name} | _geometry(shape_geometry(shape))


def _geometry(geometry: Any) -> Data:
    """Return kind and size [m] of a Coal geometry."""
    kind = type(geometry).__name__.lower()
    if isinstance(geometry, coal.Box):
        return {"kind": kind, "size": (2 * np.array(geometry.halfSide)).tolist()}
    if isinstance(geometry, coal.Sphere):
        return {"kind": kind, "radius": float(geometry.radius)}
    if isinstance(geometry, (coal.Cylinder, coal.Capsule)):
        return {"kind": kind, "radius": float(geometry.radius), "length": 2 * float(geometry.halfLength)}
    size = np.ptp(np.array(geometry.vertices()), axis=0).tolist()
    return {"kind": "mesh", "triangles": int(geometry.num_tris), "size": size}


def counted_bodies(bodies: list[Data]) -> str:
    """Return `bodies` in words, equal ones counted; lengths in millimetres."""
    texts = Counter(_body_text(body) for body in bodies)
    return ", ".join(text if count == 1 else f"{count} x {text}" for text, count in texts.items())


def _body_text(body: Data) -> str:
    if "radius" in body:
        length = f" x {1e3 * body['length']:.0f}" if "length" in body else ""
        return f"{body['kind']} r {1e3 * body['radius']:.0f}{length}"
    size = " x ".join(f"{1e3 * edge:.0f}" for edge in body["size"])
    return f"{body['kind']} {size}" + (f" ({body['triangles']} triangles)" if "triangles" in body else "")
