"""A workcell as data: the scene that a plan file keeps, what has changed in it since, and obstacles that no file has.

Keys are those of workcell files. Robot and end-effector are named with a hash, as are meshes that the workcell's file
names; meshes that were added to it are kept whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, model_validator

from regrasp_opt.conventions import FloatArray, pose_distance, rotation_rpy, rpy_angles, translation
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.mesh_files import LARGEST_MESH
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape
from regrasp_opt.scene.schema import SIZE_KEYS, ClearanceSection, Length, TableSection, Vector, WorkspaceSection
from regrasp_opt.scene.support import Fixture, Support
from regrasp_opt.scene.workcell import Workcell
from regrasp_opt.schemas import Section

TOLERANCE = 1e-9
"""Lengths [m] and angles [rad] that differ by less are the same, as in `content_hash`."""
UNCOMPARED = {"name", "position", "rpy", "added", "vertices", "faces"}
"""Keys of a record that are compared otherwise, or not."""

Index = Annotated[int, Field(ge=0)]
Coordinate = Annotated[float, Field(ge=-LARGEST_MESH, le=LARGEST_MESH)]


class Reference(Section):
    """A file, or something built in, and the hash of what was read from it."""

    source: str
    name: str
    fingerprint: str


class Placed(Section):
    """Something with a name that stands somewhere in the world [m, rad]."""

    name: str
    position: Vector
    rpy: Vector

    @property
    def pose(self) -> FloatArray:
        """The pose (4, 4) in the world."""
        T = translation(*self.position)
        T[:3, :3] = rotation_rpy(*self.rpy)
        return T


class ArmRecord(Placed):
    """The robot, where its base stands, and the tool."""

    robot: Reference
    end_effector: Reference


class ObstacleRecord(Placed):
    """A fixed shape; `added` if the workcell's file does not hold it."""

    type: Literal["box", "cylinder", "mesh"]
    size: tuple[Length, Length, Length] | None = None
    radius: Length | None = None
    length: Length | None = None
    fingerprint: str | None = None
    vertices: list[tuple[Coordinate, Coordinate, Coordinate]] | None = None
    faces: list[tuple[Index, Index, Index]] | None = None
    added: bool = False

    @model_validator(mode="after")
    def _complete(self) -> ObstacleRecord:
        mesh = ("fingerprint", "vertices", "faces") if self.added else ("fingerprint",)
        needed = mesh if self.type == "mesh" else SIZE_KEYS[self.type]
        for key in needed:
            if not getattr(self, key):
                raise ValueError(f"a {self.type} needs the key '{key}'")
        for key in ("size", "radius", "length", "fingerprint", "vertices", "faces"):
            if getattr(self, key) is not None and key not in needed:
                raise ValueError(f"a {self.type} has no key '{key}'; allowed: {', '.join(needed)}")
        if self.faces and max(map(max, self.faces)) >= len(self.vertices or ()):
            raise ValueError("a face names a vertex that does not exist")
        return self

    def shape(self) -> Shape:
        """Return the shape itself, which must be a box, a cylinder or added."""
        if self.type == "box":
            return Box(self.name, np.array(self.size), self.pose)
        if self.radius is not None and self.length is not None:
            return Cylinder(self.name, self.radius, self.length, self.pose)
        return Mesh(self.name, np.array(self.vertices), np.array(self.faces), self.pose)


class HeldPoseRecord(Placed):
    """A pose of an object in a fixture, in the fixture's frame."""

    object: str | None = None


class SupportRecord(Section):
    """What objects stand on, and where; a fixture's bodies are in the world."""

    name: str
    height: float | None = None
    center: tuple[float, float] | None = None
    size: tuple[Length, Length] | None = None
    thickness: Length | None = None
    workspace: WorkspaceSection | None = None
    rpy: Vector = (0.0, 0.0, 0.0)
    weight: float = 0.0
    position: Vector | None = None
    bodies: list[ObstacleRecord] = Field(default_factory=list)
    poses: list[HeldPoseRecord] = Field(default_factory=list)


class SceneRecord(Section):
    """A workcell as it is."""

    arms: Annotated[list[ArmRecord], Field(min_length=1, max_length=1)]
    supports: Annotated[list[SupportRecord], Field(min_length=1)]
    obstacles: list[ObstacleRecord]
    added_fingerprint: str
    clearance: ClearanceSection


def scene_content(cell: Workcell) -> dict[str, Any]:
    """Return the record of `cell`, as JSON can hold it."""
    robot, effector = cell.arm.robot, cell.arm.end_effector
    built_in = Path(robot.urdf_path).is_relative_to(Path(str(files("regrasp_opt"))))
    arm = {
        "robot": reference(robot, "built-in" if built_in else robot.urdf_path),
        "end_effector": reference(effector, effector.source),
    }
    obstacles = [ObstacleRecord.model_validate(_obstacle(shape, shape.name in cell.added)) for shape in cell.obstacles]
    record = SceneRecord.model_validate(
        {
            "arms": [{"name": cell.arm.name, **_placed(cell.arm.T_world_base), **arm}],
            "supports": [_support(support) for support in cell.supports],
            "obstacles": obstacles,
            "added_fingerprint": added_fingerprint(obstacles),
            "clearance": vars(cell.clearance),
        }
    )
    return record.model_dump(mode="json", exclude_none=True)


def added_fingerprint(obstacles: Sequence[ObstacleRecord]) -> str:
    """Return a hash of those `obstacles` that were added; names and the order do not matter.

    It is made of the numbers of the record, which JSON keeps exactly, not of the poses made from them.
    """
    left_out = {"name", "added", "vertices", "faces"}  # a mesh is held to its own fingerprint
    added = [shape.model_dump(exclude=left_out, exclude_none=True) for shape in obstacles if shape.added]
    return content_hash(*sorted(content_hash(*shape.items()) for shape in added))


def reference(item: Any, source: str) -> dict[str, str]:
    """Return how a file refers to `item`, which has a name and a fingerprint and was read from `source`."""
    return {"source": absolute(source), "name": item.name, "fingerprint": item.fingerprint()}


def absolute(source: str) -> str:
    """Return the absolute path of what was read from `source`, which may be built in."""
    return source if source == "built-in" else str(Path(source).resolve())


def _placed(T: FloatArray) -> dict[str, Any]:
    return {"position": T[:3, 3].tolist(), "rpy": rpy_angles(T[:3, :3]).tolist()}


def _support(support: Support | Fixture) -> dict[str, Any]:
    turn = rpy_angles(support.T_world_support[:3, :3]).tolist()
    common = {"name": support.name, "rpy": turn, "weight": support.weight}
    if isinstance(support, Support):
        sizes = {name: np.asarray(getattr(support, name)).tolist() for name in TableSection.model_fields}
        return {**common, **sizes, "workspace": vars(support.workspace)}
    poses = [{"name": p.name, "object": p.object, **_placed(p.T_support_object)} for p in support.poses]
    bodies = [_obstacle(shape, False) for shape in support.shapes]
    return {**common, "position": support.T_world_support[:3, 3].tolist(), "bodies": bodies, "poses": poses}


def _obstacle(shape: Shape, added: bool) -> dict[str, Any]:
    placed = {"name": shape.name, "added": added, **_placed(shape.pose)}
    if isinstance(shape, Box):
        return {"type": "box", "size": shape.size.tolist(), **placed}
    if isinstance(shape, Cylinder):
        return {"type": "cylinder", "radius": shape.radius, "length": shape.length, **placed}
    whole = {"vertices": shape.vertices.tolist(), "faces": shape.faces.tolist()} if added else {}
    return {"type": "mesh", "fingerprint": content_hash(shape.vertices, shape.faces), **whole, **placed}


@np.errstate(over="ignore", invalid="ignore")  # of numbers that a damaged file holds
def scene_changes(before: SceneRecord, cell: Workcell) -> list[str]:
    """Return a clause for each difference between `before` and `cell`; names alone, and the order, do not matter."""
    now = SceneRecord.model_validate(scene_content(cell))
    return [
        *_items("arm", before.arms, now.arms),
        *_items("support", before.supports, now.supports),
        *_items("obstacle", before.obstacles, now.obstacles),
        *_differences("", before.clearance, now.clearance),
    ]


def _items(kind: str, before: Sequence[Any], now: Sequence[Any]) -> list[str]:
    gone = [item for item in before if all(_differences("", item, other) for other in now)]
    new = {item.name: item for item in now if all(_differences("", other, item) for other in before)}
    texts = []
    for item in gone:
        what, other = f"{kind} '{item.name}'", new.pop(item.name, None)
        texts += [f"{what} was removed"] if other is None else _differences(what, item, other)
    return texts + [f"{kind} '{name}' was added" for name in new]


def _differences(what: str, before: Section, now: Section) -> list[str]:
    texts = []
    if isinstance(before, Placed) and isinstance(now, Placed):
        moved, turned = pose_distance(before.pose, now.pose)
        texts += [f"{what} moved by {moved:.3g} m"] if moved > TOLERANCE else []
        texts += [f"{what} turned by {np.degrees(turned):.3g} degrees"] if turned > TOLERANCE else []
    for key, old in before:
        new = getattr(now, key)
        if key in UNCOMPARED or _equal(old, new):
            continue
        if key == "type":  # nothing else of the two can be compared
            return [f"{what} is a {new} instead of a {old}"]
        if isinstance(old, Section) and isinstance(new, Section) and not isinstance(old, Reference):
            texts += _differences(f"the {key} of {what}", old, new)
        elif None in (old, new) or isinstance(old, list):
            texts.append(f"the {key} of {what} is another")
        elif key == "fingerprint" or (isinstance(old, Reference) and old.name == new.name):
            texts.append(f"the {'mesh' if key == 'fingerprint' else key} of {what} is another")
        else:
            texts.append(
                f"{f'{key} of {what}' if what else f'clearance.{key}'} is {_text(new)} instead of {_text(old)}"
            )
    return texts


def _equal(old: Any, new: Any) -> bool:
    if isinstance(old, Reference):
        return bool(old.fingerprint == new.fingerprint)
    if isinstance(old, (float, tuple)) and isinstance(new, (float, tuple)):
        return bool(np.allclose(old, new, rtol=0.0, atol=TOLERANCE))
    return bool(old == new)


def _text(value: Any) -> str:
    if isinstance(value, Reference):
        return f"'{value.name}'"
    return f"[{', '.join(f'{x:.9g}' for x in value)}]" if isinstance(value, tuple) else f"{value:.9g}"
