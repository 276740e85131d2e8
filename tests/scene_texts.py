"""Scene files as MoveIt and MuJoCo write them, made after their documentation, of one list of bodies."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation


class Body(NamedTuple):
    """A body of a `kind` with full sizes [m] (box x y z; sphere r; cylinder and cone r, length), or a mesh, at T."""

    name: str
    kind: str
    size: tuple[float, ...]
    T: np.ndarray
    mesh: trimesh.Trimesh | None = None


def pose(position: tuple[float, float, float], rotation: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Return a pose (4, 4) from a position [m] and a rotation vector [rad]."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = position, Rotation.from_rotvec(rotation).as_matrix()
    return T


def wedge() -> trimesh.Trimesh:
    """Return a body that is not convex and has no symmetry."""
    foot = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [0.1, 0.05, 0.02]])
    wall = trimesh.creation.box(bounds=[[0.0, 0.0, 0.0], [0.02, 0.05, 0.08]])
    return trimesh.boolean.union([foot, wall], engine="manifold")


BODIES = (
    Body("crate one", "box", (0.2, 0.1, 0.3), pose((0.4, 0.1, 0.15), (0.0, 0.0, 0.7))),
    Body("post", "cylinder", (0.03, 0.4), pose((-0.4, 0.2, 0.2), (0.3, -0.2, 0.1))),
    Body("bracket", "mesh", (), pose((0.1, 0.6, 0.05), (0.5, 0.1, 1.2)), wedge()),
    Body("ball", "sphere", (0.05,), pose((0.0, 0.7, 0.3))),
)


def scene_text(bodies: tuple[Body, ...] = BODIES, *, old: bool = False, T_object: np.ndarray | None = None) -> str:
    """Return a ``.scene`` file: each body an object at `T_object`, or in the old format without a pose of objects."""
    T_object = np.eye(4) if T_object is None or old else T_object
    lines = ["(noname)+"]
    for body in bodies:
        lines.append(f"* {body.name}")
        lines += [] if old else _pose_lines(T_object)
        lines += ["1", body.kind]
        if body.mesh is None:
            lines.append(" ".join(repr(float(x)) for x in body.size))
        else:
            lines.append(f"{len(body.mesh.vertices)} {len(body.mesh.faces)}")
            lines += [" ".join(repr(float(x)) for x in row) for row in body.mesh.vertices]
            lines += [" ".join(str(int(x)) for x in row) for row in body.mesh.faces]
        lines += [*_pose_lines(np.linalg.inv(T_object) @ body.T), "0 0 0 0"]
        lines += [] if old else ["1", "handle", *_pose_lines(np.eye(4))]
    return "\n".join([*lines, "."]) + "\n"


def _pose_lines(T: np.ndarray) -> list[str]:
    turn = Rotation.from_matrix(T[:3, :3]).as_quat()
    return [" ".join(repr(float(x)) for x in values) for values in (T[:3, 3], turn)]


def message_pose(T: np.ndarray) -> dict[str, Any]:
    """Return a ``geometry_msgs/Pose``."""
    turn = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {
        "position": dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
        "orientation": dict(zip("xyzw", turn.tolist(), strict=True)),
    }


def collision_object(body: Body, frame: str = "world", T_object: np.ndarray | None = None) -> dict[str, Any]:
    """Return a ``moveit_msgs/CollisionObject``."""
    T_object = np.eye(4) if T_object is None else T_object
    at = [message_pose(np.linalg.inv(T_object) @ body.T)]
    parts: dict[str, Any] = {"primitives": [], "primitive_poses": [], "meshes": [], "mesh_poses": [], "planes": []}
    if body.mesh is None:
        number = {"box": 1, "sphere": 2, "cylinder": 3, "cone": 4}[body.kind]
        size = body.size if body.kind in ("box", "sphere") else body.size[::-1]  # the height comes first
        parts |= {"primitives": [{"type": number, "dimensions": list(size)}], "primitive_poses": at}
    else:
        vertices = [dict(zip("xyz", row, strict=True)) for row in body.mesh.vertices.tolist()]
        triangles = [{"vertex_indices": row} for row in body.mesh.faces.tolist()]
        parts |= {"meshes": [{"triangles": triangles, "vertices": vertices}], "mesh_poses": at}
    header = {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": frame}
    kind = {"key": "", "db": ""}
    return {"header": header, "pose": message_pose(T_object), "id": body.name, "type": kind, **parts, "operation": 0}


def planning_scene(objects: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    """Return a ``moveit_msgs/PlanningScene``."""
    octomap = {"header": {"frame_id": ""}, "octomap": {"id": "", "resolution": 0.0, "data": []}}
    return {
        "name": "(noname)+",
        "robot_state": {"joint_state": {"name": [], "position": []}, "attached_collision_objects": []},
        "world": {"collision_objects": objects, "octomap": octomap},
        "is_diff": False,
        **more,
    }


def mjcf(bodies: tuple[Body, ...] = BODIES) -> str:
    """Return a model of MuJoCo's with these bodies, the geoms of a mesh in the file ``NAME.obj``."""
    geoms, meshes = [], []
    for body in bodies:
        x, y, z, w = Rotation.from_matrix(body.T[:3, :3]).as_quat()
        place = f'pos="{" ".join(map(repr, body.T[:3, 3].tolist()))}" quat="{w!r} {x!r} {y!r} {z!r}"'.replace(
            "np.float64(", ""
        )
        place = place.replace(")", "")
        if body.mesh is not None:
            meshes.append(f'<mesh name="{body.name}" file="{body.name}.obj"/>')
            geoms.append(f'<geom name="{body.name}" type="mesh" mesh="{body.name}" {place}/>')
            continue
        half = np.array(body.size) / (1 if body.kind == "sphere" else (1, 2) if body.kind == "cylinder" else 2)
        size = " ".join(repr(float(value)) for value in half)
        geoms.append(f'<geom name="{body.name}" type="{body.kind}" size="{size}" {place}/>')
    return f"<mujoco><asset>{''.join(meshes)}</asset><worldbody>{''.join(geoms)}</worldbody></mujoco>"
