"""Obstacles from MoveIt's planning scenes: the text that RViz and MoveIt save as ``.scene``, and messages as YAML.

In both an object has shapes, with poses in the frame of the object. A message names the frame of the object, a
``.scene`` file does not.
"""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray, IntArray
from regrasp_opt.errors import WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.io.scene_shapes import ENCLOSED, ball_around, cone_around, say_left_out
from regrasp_opt.schemas import read_yaml

PRIMITIVES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone"}
"""Kinds of ``shape_msgs/msg/SolidPrimitive``."""

POSES = {"primitives": "primitive_poses", "meshes": "mesh_poses", "planes": "plane_poses"}
"""Lists of shapes in a message, and of their poses."""

FIELDS = {"header", "pose", "id", "type", "subframe_names", "subframe_poses", "operation", *POSES, *POSES.values()}
"""What a ``moveit_msgs/msg/CollisionObject`` has: a misspelt pose must not be taken for none."""

SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4, "mesh": 0}
"""How many numbers say how large each kind of shape is."""

FARTHEST = 50.0
"""Largest coordinate of an obstacle [m]. A larger one is far out of reach, or in millimetres."""

ADD, REMOVE, APPEND = 0, 1, 2
"""Operations of ``moveit_msgs/msg/CollisionObject``."""

UNIT = 1e-3
"""How far the length of a quaternion may be from 1."""

logger = logging.getLogger(__name__)


def read_scene_text(path: Path) -> list[Shape]:
    """Return the obstacles of a ``.scene`` file.

    Raises
    ------
    WorkcellError
        If it cannot be read, is cut short, or holds what no such file can hold.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise WorkcellError(f"scene {path} cannot be read; give a .scene file, as MoveIt saves it") from error
    starts = [number for number, line in enumerate(lines) if number > 0 and line.lstrip().startswith("*")]
    end = next((number for number, line in enumerate(lines) if number > 0 and line.strip() == "."), None)
    if (
        end is None
        or any(start > end for start in starts)
        or any(line.strip() for line in lines[1 : min([*starts, end])])
    ):
        raise WorkcellError(f"scene {path} is not a .scene file of MoveIt's, or is cut short; it ends with a line '.'")
    reader = _Shapes(path)
    for start, stop in zip(starts, [*starts, end][1:], strict=True):
        name, content = lines[start].lstrip()[1:].strip(), [line for line in lines[start + 1 : stop] if line.strip()]
        try:
            _read_object(reader, name, content)
        except (ValueError, IndexError, OverflowError) as error:
            raise WorkcellError(f"scene {path}: object '{name}' is not complete, or not in MoveIt's format") from error
    return reader.finished()


def _read_object(reader: _Shapes, name: str, lines: list[str]) -> None:
    tokens = iter(" ".join(lines).split())

    def numbers(count: int) -> FloatArray:
        return np.array([float(next(tokens, "")) for _ in range(count)])

    def whole(count: int) -> IntArray:
        return np.array([int(next(tokens, "")) for _ in range(count)], dtype=np.int64)

    def pose() -> FloatArray:
        position, quaternion = numbers(3), numbers(4)
        return reader.pose(position, quaternion, name)

    placed = len(lines[0].split()) > 1  # in older files an object has no pose of its own, and no subframes
    T_object = pose() if placed else np.eye(4)
    for _ in range(count := int(next(tokens, ""))):
        kind = next(tokens, "")
        mesh, size = None, np.zeros(0)
        if kind == "mesh":
            vertices, triangles = whole(2).tolist()
            mesh = numbers(3 * vertices).reshape(-1, 3), whole(3 * triangles).reshape(-1, 3)
        else:
            size = numbers(SIZES.get(kind) or reader.unknown(name, kind))
            size = size[::-1] if kind in ("cylinder", "cone") else size  # a message has the height first
        T_shape = pose()
        numbers(4)  # the colour
        reader.add(name, count, kind, size, T_object @ T_shape, mesh)
    rest = list(tokens)
    if count < 1 or len(rest) != (8 * int(rest[0]) + 1 if placed else 0):
        raise ValueError("the number of shapes or subframes is wrong")


def read_scene_yaml(path: Path, known: dict[str, FloatArray]) -> list[Shape]:
    """Return the obstacles of messages in YAML: a ``PlanningScene``, its ``world``, or ``CollisionObject`` of it.

    Raises
    ------
    WorkcellError
        If it cannot be read, holds something else, or poses are in a frame that is not `known` by its pose (4, 4).
    """
    documents = read_yaml(path, WorkcellError)
    if not documents:
        raise WorkcellError(f"scene {path} is empty; give a planning scene of MoveIt's")
    if len(documents) > 1:
        logger.warning("%s holds %d messages; the first counts", path, len(documents))
    content = documents[0]
    if isinstance(content, dict) and content.get("is_diff") not in (None, False):
        raise WorkcellError(
            f"scene {path} has is_diff: true, and lacks what did not change; give a whole scene, not a difference"
        )
    reader = _Shapes(path)
    state = content.get("robot_state") if isinstance(content, dict) else None
    attached = state.get("attached_collision_objects") if isinstance(state, dict) else None
    world = content.get("world", content) if isinstance(content, dict) else {"collision_objects": content}
    objects = world.get("collision_objects", [world] if "id" in world else None) if isinstance(world, dict) else None
    if not isinstance(objects, list) or not all(isinstance(each, dict) for each in objects):
        raise WorkcellError(f"scene {path} has no 'world' with 'collision_objects'; give a planning scene of MoveIt's")
    for each in objects:
        name = str(each.get("id", ""))
        try:
            _read_message(reader, name, each, known)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise WorkcellError(
                f"scene {path}: object '{name}' is not a CollisionObject; if 'ros2 topic echo' cut it short, use "
                "--full-length"
            ) from error
    if isinstance(attached, list):
        names = [str(each.get("object", {}).get("id")) for each in attached if isinstance(each, dict)]
        say_left_out(path, names, "left out, since it is attached to the robot")
    if isinstance(octomap := world.get("octomap"), dict) and (octomap.get("octomap") or {}).get("data"):
        say_left_out(path, ["octomap"], "left out, since it is a map of cells")
    return reader.finished()


def _read_message(reader: _Shapes, name: str, message: dict[str, Any], known: dict[str, FloatArray]) -> None:
    reader.know(message, FIELDS, name)
    operation = message.get("operation", ADD)
    operation = ord(operation) if isinstance(operation, (str, bytes)) else operation
    if operation == REMOVE:
        return
    if operation not in (ADD, APPEND):
        raise WorkcellError(f"scene {reader.path}: object '{name}' is only moved; give a whole scene, not a difference")
    frame = str((message.get("header") or {}).get("frame_id", "")).lstrip("/")
    if frame not in known:
        names = ", ".join(f"'{other}'" for other in known if other)
        raise WorkcellError(
            f"scene {reader.path}: object '{name}' is in the frame '{frame}', and known are {names}; transform it first"
        )
    T = known[frame] @ reader.message_pose(message.get("pose"), name)
    lists = {kind: message.get(kind) or [] for kind in POSES}
    count = sum(map(len, lists.values()))
    if count == 0:
        raise WorkcellError(f"scene {reader.path}: object '{name}' has no shapes; save the scene with its geometry")
    for kind, shapes in lists.items():
        poses = message.get(POSES[kind]) or []
        if len(poses) != len(shapes) and (poses or len(shapes) > 1):
            raise WorkcellError(f"scene {reader.path}: object '{name}' has {len(shapes)} {kind} and {len(poses)} poses")
        for shape, pose in zip(shapes, poses or [None] * len(shapes), strict=True):
            T_shape = T @ reader.message_pose(pose, name)
            if kind == "meshes":
                reader.add(name, count, "mesh", np.zeros(0), T_shape, _triangles(shape))
                continue
            given = "plane" if kind == "planes" else shape["type"]
            word = PRIMITIVES.get(given) if isinstance(given, int) else str(given).lower()
            size = np.array([] if word == "plane" else shape["dimensions"], dtype=np.float64)
            reader.add(name, count, word or str(given), size, T_shape)


def _triangles(mesh: dict[str, Any]) -> tuple[FloatArray, IntArray]:
    vertices = np.array([[point[axis] for axis in "xyz"] for point in mesh["vertices"]], dtype=np.float64)
    faces = np.array([triangle["vertex_indices"] for triangle in mesh["triangles"]], dtype=np.int64)
    return vertices.reshape(-1, 3), faces.reshape(-1, 3)


class _Shapes:
    """The shapes read so far, and what was left out."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._shapes: list[Shape] = []
        self._planes: list[str] = []
        self._enclosed: list[str] = []
        self._taken: dict[str, int] = {}

    def pose(self, position: Sequence[float] | FloatArray, quaternion: FloatArray, name: str) -> FloatArray:
        """Return the pose (4, 4) of a position [m] and a quaternion (4,), w last; all zeros mean no rotation."""
        T = np.eye(4)
        T[:3, 3] = position
        if not (np.abs(T[:3, 3]) <= FARTHEST).all():
            far = np.abs(T[:3, 3]).max()
            raise WorkcellError(f"scene {self.path}: object '{name}' is {far:.3g} m away; give metres, or leave it out")
        with np.errstate(over="ignore", invalid="ignore"):
            length = float(np.linalg.norm(quaternion))
        if length != 0:
            if not abs(length - 1) <= UNIT:
                raise WorkcellError(
                    f"scene {self.path}: object '{name}' has a quaternion of length {length:.3g}, not 1"
                )
            T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
        return T

    def message_pose(self, pose: Any, name: str) -> FloatArray:
        """Return the pose (4, 4) of a ``geometry_msgs/msg/Pose``; what is missing in it is zero."""
        position, turn = ((pose or {}).get(key) or {} for key in ("position", "orientation"))
        for part, fields in ((pose or {}, ("position", "orientation")), (position, "xyz"), (turn, "xyzw")):
            self.know(part, fields, name)
        numbers = np.array(
            [float(part.get(axis, 0.0)) for part, axes in ((position, "xyz"), (turn, "xyzw")) for axis in axes]
        )
        return self.pose(numbers[:3], numbers[3:], name)

    def know(self, part: dict[str, Any], fields: Collection[str], name: str) -> None:
        """Raise a WorkcellError if a `part` of a message has a key that is none of its `fields`."""
        wrong = next((key for key in part if key not in fields), None)
        if wrong is not None:
            raise WorkcellError(f"scene {self.path}: object '{name}' has the unknown key '{wrong}'; correct it")

    def unknown(self, name: str, kind: str) -> int:
        """Raise a WorkcellError about a shape of an unknown kind."""
        raise WorkcellError(
            f"scene {self.path}: object '{name}' has a shape of kind '{kind}'; known: {', '.join(SIZES)}"
        )

    def add(
        self,
        name: str,
        count: int,
        kind: str,
        size: FloatArray,
        T: FloatArray,
        mesh: tuple[FloatArray, IntArray] | None = None,
    ) -> None:
        """Add a shape at `T` (4, 4) to the object `name`, one of its `count`; `size` is that of a message."""
        if kind not in SIZES:
            self.unknown(name, kind)
        number = self._taken[name] = self._taken.get(name, 0) + 1
        own = name if count == 1 else f"{name}-{number}"
        if mesh is not None:
            self._shapes.append(Mesh(own, mesh[0], mesh[1], T))
            return
        if kind == "plane":
            self._planes.append(own)
            return
        if kind == "mesh" or len(size) < SIZES[kind] or not (np.isfinite(size) & (size > 0)).all():
            raise WorkcellError(
                f"scene {self.path}: '{own}' is a {kind} of dimensions {size.tolist()}; give lengths above 0"
            )
        if kind == "box":
            self._shapes.append(Box(own, size[:3], T))
        elif kind == "cylinder":
            self._shapes.append(Cylinder(own, float(size[1]), float(size[0]), T))
        else:
            self._enclosed.append(own)
            around = ball_around(own, float(size[0]), T) if kind == "sphere" else cone_around(own, size[1], size[0], T)
            self._shapes.append(around)

    def finished(self) -> list[Shape]:
        """Return all shapes; says what was left out or enclosed."""
        say_left_out(self.path, self._planes, "left out, since it is an endless plane")
        say_left_out(self.path, self._enclosed, ENCLOSED)
        return self._shapes
