"""Workcells from TOML files: the built-in ones by name, any other by path."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Mapping
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray, as_pose, rotation_rpy, translation
from regrasp_opt.end_effectors import END_EFFECTOR_NAMES, EndEffector, load_end_effector
from regrasp_opt.errors import HomeCollisionError, MeshError, PoseError, UnknownNameError, WorkcellError
from regrasp_opt.files import report_outside
from regrasp_opt.geometry.mesh_files import LARGEST_MESH, read_triangles, unlikely_size
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, Shape, shape_geometry
from regrasp_opt.geometry.solids import Solid, find_shells, separation
from regrasp_opt.robots import Robot, load_robot
from regrasp_opt.scene.arm import Arm
from regrasp_opt.scene.collision_world import collision_at_home
from regrasp_opt.scene.schema import (
    ArmSection,
    MountingSection,
    ObstacleSection,
    ObstaclesFile,
    SupportSection,
    Vector,
    WorkcellFile,
    WorkcellFile1,
)
from regrasp_opt.scene.support import Fixture, HeldPose, Support, WorkspaceBounds
from regrasp_opt.scene.workcell import Clearance, Workcell
from regrasp_opt.schemas import parse_toml, read_toml, validated

logger = logging.getLogger(__name__)

WORKCELL_NAMES = tuple(f"nova2-{name}" for name in END_EFFECTOR_NAMES)
"""The built-in workcells with the arm whose energies come along: the Nova2 with each of the built-in end-effectors."""

FURTHER_WORKCELL_NAMES = ("iiwa7-w", "kinova-w", "panda-w", "ur10-r140", "ur5-r85", "xarm7-w", "z1-w")
"""Built-in workcells with other arms. But for the iiwa's, their URDF files come with the extra ``robots``."""

FRICTION = 0.5
"""Friction between objects and a board that gives none: the tangent of the tilt up to which objects stay."""
THICKNESS = 0.05
"""Thickness of a board that gives none [m]."""
OVERLAP = 1e-4
"""Depth to which two supports may overlap [m]: boards of one shelf may touch."""

LARGEST_WORKSPACE = 10.0
"""A workspace wider than this is taken to be in another unit [m]; its pose lattice would not fit into memory."""


def load_workcell(
    name_or_path: str | os.PathLike[str], *, end_effector: str | os.PathLike[str] | None = None
) -> Workcell:
    """Return a built-in workcell by name, or any other from the path of its TOML file.

    Parameters
    ----------
    name_or_path : str or path
        One of `WORKCELL_NAMES` or `FURTHER_WORKCELL_NAMES`, or a file. A string is a path when it ends in
        ``.toml`` or has a folder in it. Paths within the file are relative to its folder.
    end_effector : str or path, optional
        End-effector to use in place of the file's, by name or by path.

    Raises
    ------
    UnknownNameError
        If a workcell, robot or end-effector is asked for by a name that is not built in.
    WorkcellError
        If the file cannot be read, or holds a wrong key, value or geometry; the message names the file, the
        key and what is allowed.
    """
    names = (*WORKCELL_NAMES, *FURTHER_WORKCELL_NAMES)
    if isinstance(name_or_path, str) and name_or_path in names:
        path = Path(str(files("regrasp_opt"))) / "data" / "workcells" / f"{name_or_path}.toml"
        return _build(path, "built-in", end_effector)
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and path.suffix.lower() != ".toml" and path.name == name_or_path:
        raise UnknownNameError("workcell", name_or_path, names)
    return _build(path, str(path), end_effector)


def load_obstacles(path: str | os.PathLike[str]) -> tuple[Shape, ...]:
    """Return the obstacles of a TOML file that has nothing but ``[[obstacles]]``, with the keys of a workcell's.

    Raises
    ------
    WorkcellError
        If the file cannot be read, or holds a wrong key, value or geometry.
    """
    path = Path(path)
    content = read_toml(_text(path, "obstacles"), ObstaclesFile, str(path))
    return tuple(_obstacle(section, path) for section in content.obstacles)


def as_obstacles(obstacles: Iterable[Shape | Mapping[str, Any]]) -> tuple[Shape, ...]:
    """Return shapes in the world frame; a mapping has the keys of ``[[obstacles]]``, files relative to this folder.

    Raises
    ------
    WorkcellError
        If a mapping has a wrong key, value or geometry.
    """
    path = Path("obstacles")
    return tuple(
        _obstacle(validated(dict(each), ObstacleSection, f"obstacle {number}", WorkcellError), path)
        if isinstance(each, Mapping)
        else _sound(each, f"obstacle {number}")
        for number, each in enumerate(obstacles)
    )


def _sound(shape: Shape, where: str) -> Shape:
    """Return a shape that somebody made, with a rigid pose and sizes that a body can have.

    Raises
    ------
    WorkcellError
        If it is not such a shape.
    """
    if not isinstance(shape, (Box, Cylinder, Mesh)):
        raise WorkcellError(f"{where} is a {type(shape).__name__}; give a Box, Cylinder or Mesh, or a dict of keys")
    try:
        pose = as_pose(shape.pose, f"pose of {where}")
    except PoseError as error:
        raise WorkcellError(str(error)) from error
    if isinstance(shape, Mesh):
        return _checked_mesh(replace(shape, pose=pose), f"{where}, mesh '{shape.name}',", 1.0)
    lengths = np.asarray(shape.size if isinstance(shape, Box) else (shape.radius, shape.length), dtype=np.float64)
    if lengths.shape != ((3,) if isinstance(shape, Box) else (2,)) or not (np.isfinite(lengths) & (lengths > 0)).all():
        raise WorkcellError(f"{where}, '{shape.name}', has sizes {lengths.tolist()}; give lengths above 0 in metres")
    return replace(shape, pose=pose)


def _text(path: Path, what: str) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, ValueError) as error:
        raise WorkcellError(f"{what} file {path} cannot be read; give the path of a TOML file") from error


class _Keys(NamedTuple):
    """What messages call the parts of a file."""

    robot: str
    robot_model: str
    home: str
    tool: str
    tool_model: str
    workspace: str


_KEYS = {
    1: _Keys("robot", "robot.model", "robot.home", "end_effector", "end_effector.model", "workspace"),
    2: _Keys("arms.0", "arms.0.robot", "arms.0.home", "arms.0", "arms.0.end_effector", "supports.{}.workspace"),
}


def _read(path: Path) -> tuple[WorkcellFile, _Keys]:
    data = parse_toml(_text(path, "workcell"), str(path))
    if data.get("schema", 1) not in _KEYS:
        raise WorkcellError(f"{path}: key 'schema' is {data['schema']!r}; this version reads schemas 1 and 2")
    if data.get("schema") == 2:
        return validated(data, WorkcellFile, str(path), WorkcellError), _KEYS[2]
    return validated(data, WorkcellFile1, str(path), WorkcellError).current(), _KEYS[1]


def _build(path: Path, source: str, override: str | os.PathLike[str] | None) -> Workcell:
    content, keys = _read(path)
    (arm,), margins = content.arms, content.clearance
    report_outside(path, _named_files(content, path, override))
    workcell = Workcell(
        name=content.name or path.stem,
        arm=Arm(
            _robot(arm, path, keys),
            _pose(arm.position, arm.rpy),
            _end_effector(arm, path, keys) if override is None else load_end_effector(override),
            arm.name,
        ),
        supports=tuple(_support(section, path, f"supports.{i}") for i, section in enumerate(content.supports)),
        obstacles=tuple(_obstacle(section, path) for section in content.obstacles),
        clearance=Clearance(margins.arm, margins.gripper, margins.self_collision),
        source=source,
        end_effector_override=_override(override),
    )
    _check(workcell, path, keys)
    return workcell


def _support(section: SupportSection, path: Path, key: str) -> Support | Fixture:
    if section.kind == "fixture":
        return _fixture(section, path)
    friction = section.friction or FRICTION
    center, size = np.array(section.center), np.array(section.size)
    space = None if section.workspace is None else WorkspaceBounds(section.workspace.x, section.workspace.y)
    support = Support.table(
        section.height or 0.0,
        center,
        size,
        section.thickness or THICKNESS,
        space,
        name=section.name,
        rotation=rotation_rpy(*section.rpy) if any(section.rpy) else None,
        weight=section.weight,
    )
    if support.normal[2] <= 0 or support.slope > friction + 1e-9:
        raise WorkcellError(
            f"{path}: key '{key}.rpy': '{section.name}' is tilted by {np.degrees(np.arccos(support.normal[2])):.1f} "
            f"degrees, and objects slide off above {np.degrees(np.arctan(friction)):.1f}; tilt it less, or give its "
            f"'friction'"
        )
    return support


def _fixture(section: SupportSection, path: Path) -> Fixture:
    assert section.position is not None and section.poses is not None
    T = _pose(section.position, section.rpy)
    bodies = [_obstacle(each, path) for each in section.bodies or ()]
    shapes = tuple(replace(each, name=f"{section.name} {each.name}", pose=T @ each.pose) for each in bodies)
    poses = tuple(HeldPose(each.name, _pose(each.position, each.rpy), each.object) for each in section.poses)
    return Fixture(section.name, T, shapes, poses, section.weight)


def _named_files(content: WorkcellFile, path: Path, override: str | os.PathLike[str] | None) -> list[Path]:
    """Return the files and folders that the file at `path` has read; built-in names are none."""
    (arm,) = content.arms
    models = [arm.robot, *([arm.end_effector] if override is None else [])]
    named = [file for file in (_relative(name, path.parent) for name in models) if isinstance(file, Path)]
    named += [path.parent / name for name in (*arm.package_dirs, *([] if arm.srdf is None else [arm.srdf]))]
    bodies = [body for support in content.supports for body in support.bodies or ()]
    return named + [path.parent / section.file for section in (*content.obstacles, *bodies) if section.file is not None]


def _override(end_effector: str | os.PathLike[str] | None) -> str | None:
    """Return what loads the same end-effector from any folder."""
    if end_effector is None or str(end_effector) in END_EFFECTOR_NAMES:
        return None if end_effector is None else str(end_effector)
    return str(Path(end_effector).resolve())


def _check(workcell: Workcell, path: Path, keys: _Keys) -> None:
    """Raise a WorkcellError where the parts do not fit each other."""
    if not isinstance(workcell.supports[0], Support):
        raise WorkcellError(f"{path}: key 'supports.0': the first support is a fixture; put a board first")
    for number, board in enumerate(workcell.supports):
        if isinstance(board, Support):
            _check_workspace(board, f"{path}: key '{keys.workspace.format(number)}.")
    twice = workcell.repeated_name
    if twice is not None:
        raise WorkcellError(f"{path}: key 'obstacles': the name '{twice}' is taken; give each obstacle its own")
    _check_supports(workcell, path)
    hit = collision_at_home(workcell)
    if hit is not None:
        raise HomeCollisionError(
            f"{path}: '{hit[0]}' collides with '{hit[1]}', or is nearer than its clearance, while the robot is at "
            f"home; choose another '{keys.home}', or add the pair to '{keys.robot}.ignore_collisions' if both are "
            "links made to touch",
            workcell,
        )


def _check_workspace(board: Support, where: str) -> None:
    space = board.workspace
    for axis, (low, high), middle, size in zip("xy", (space.x, space.y), board.center, board.size, strict=True):
        if high - low > LARGEST_WORKSPACE:
            raise WorkcellError(
                f"{where}{axis}': {low:g} to {high:g} is wider than {LARGEST_WORKSPACE:g} m; give "
                "metres, and no more than the arm can reach"
            )
        if low < middle - size / 2 - 1e-9 or high > middle + size / 2 + 1e-9:
            raise WorkcellError(
                f"{where}{axis}': {low:g} to {high:g} leaves the {board.name}, which ends at "
                f"{middle - size / 2:g} and {middle + size / 2:g}; keep it within"
            )


def _check_supports(workcell: Workcell, path: Path) -> None:
    """Raise a WorkcellError where two supports overlap, or one is out of the arm's reach."""
    solids = [[(Solid(shape_geometry(s)), s.pose) for s in support.shapes] for support in workcell.supports]
    for j, other in enumerate(workcell.supports):
        for i in range(j):
            if any(separation(a, b, T, U) < -OVERLAP for a, T in solids[i] for b, U in solids[j]):
                raise WorkcellError(
                    f"{path}: key 'supports.{j}': '{other.name}' overlaps '{workcell.supports[i].name}'; move it away"
                )
    base, reach = workcell.arm.T_world_base[:3, 3], workcell.arm.robot.max_reach + workcell.arm.end_effector.tcp_offset
    for number, support in enumerate(workcell.supports[1:], start=1):
        if isinstance(support, Support):
            nearest = np.clip(support.seen(base)[:2], *support.workspace.array)
            away = float(np.linalg.norm(support.seen(base) - np.append(nearest, 0.0)))
        else:
            held = [support.T_world_support @ pose.T_support_object for pose in support.poses]
            away = min(float(np.linalg.norm(T[:3, 3] - base)) for T in held)
        if away > reach:
            raise WorkcellError(
                f"{path}: key 'supports.{number}': '{support.name}' is {away:.2f} m from the robot's base, which "
                f"reaches {reach:.2f} m; move it nearer"
            )


def _robot(section: ArmSection, path: Path, keys: _Keys) -> Robot:
    names = MountingSection.model_fields.keys() - {"position", "rpy"}
    options: dict[str, Any] = {name: getattr(section, name) for name in names}
    options["package_dirs"] = [path.parent / name for name in section.package_dirs]
    options["srdf"] = None if section.srdf is None else path.parent / section.srdf
    try:
        return load_robot(_relative(section.robot, path.parent), **options)
    except UnknownNameError as error:
        raise WorkcellError(
            f"{path}: key '{keys.robot_model}': {error}, or the path of a URDF or xacro file"
        ) from error
    except WorkcellError as error:
        raise WorkcellError(f"{path}: section '{keys.robot}': {error}") from error


def _end_effector(section: ArmSection, path: Path, keys: _Keys) -> EndEffector:
    try:
        return load_end_effector(_relative(section.end_effector, path.parent))
    except UnknownNameError as error:
        raise WorkcellError(f"{path}: key '{keys.tool_model}': {error}, or the path of a file") from error
    except WorkcellError as error:
        raise WorkcellError(f"{path}: section '{keys.tool}': {error}") from error


def _relative(name: str, folder: Path) -> str | Path:
    """Return `name` itself where it is a bare one, else the path that it means in a file of `folder`."""
    return name if Path(name).name == name and not Path(name).suffix else folder / name


def _pose(position: Vector, rpy: Vector) -> FloatArray:
    T = translation(*position)
    T[:3, :3] = rotation_rpy(*rpy)
    return T


def _obstacle(section: ObstacleSection, path: Path) -> Shape:
    pose = _pose(section.position, section.rpy)
    if section.size is not None:
        return Box(section.name, np.array(section.size), pose)
    if section.radius is not None and section.length is not None:
        return Cylinder(section.name, section.radius, section.length, pose)
    return _mesh(section, path, pose)


def _mesh(section: ObstacleSection, path: Path, pose: FloatArray) -> Mesh:
    file = path.parent / str(section.file)
    where = f"{path}: mesh '{file}' of obstacle '{section.name}'"
    if not os.path.isfile(file):
        raise WorkcellError(f"{where} does not exist; give a path relative to the workcell file")
    try:
        vertices, faces = read_triangles(file)
    except MeshError as error:
        raise WorkcellError(f"{where} cannot be read: {error}") from error
    scale = section.scale or 1.0
    return _checked_mesh(Mesh(section.name, vertices * scale, faces, pose), where, scale)


def _checked_mesh(mesh: Mesh, where: str, scale: float) -> Mesh:
    """Return `mesh`, which was scaled by `scale`, if it is sound and of a plausible size; say if it is not closed."""
    vertices, faces = np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64)
    if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or not len(faces) or not np.isfinite(vertices).all():
        raise WorkcellError(f"{where} needs finite vertices (V, 3) and at least one triangle (F, 3)")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise WorkcellError(f"{where} has triangles of vertices that it does not hold; make it again")
    wrong = unlikely_size(vertices[np.unique(faces)], LARGEST_MESH)
    if wrong is not None:
        raise WorkcellError(f"{where} {wrong[0]}; write scale = {scale * wrong[1]:g}")
    if find_shells(vertices, faces).open_parts:
        logger.warning(
            "%s is not closed: its surface is tested, but not what is inside; close it if it is solid", where
        )
    return replace(mesh, vertices=vertices, faces=faces)
