"""Grasp files of other tools: ACRONYM's HDF5 and JSON, GraspGen's JSON and Isaac's YAML.

All of them give the pose of a hand in the frame of the object's mesh, none the width: it is found on the object.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import GraspError
from regrasp_opt.grasps.hand_frames import FRAMES, HandFrame

MOST_GRASPS = 1_000_000
"""More in one file are not read."""

FRANKA_HANDS = {"panda_hand", "fr3_hand", "fp3_hand", "franka_hand", "fer_hand"}
"""Names of the link that our frame `panda_hand` is, in the URDF files of Franka's arms."""

UNIT = 1e-3
"""How far the length of a quaternion may be from 1."""


class FileGrasps(NamedTuple):
    """What a grasp file holds.

    Attributes
    ----------
    T_object_hand : array-like
        Poses of the hand in the object frame (N, 4, 4), in the unit of the file; tested by whoever takes them.
    names : tuple of str
        Names of the grasps, or of their rows in the file; or none.
    frame : str or None
        The hand's frame, as `regrasp_opt.grasps.hand_frames.hand_frame` takes it; None if the file does not say.
    width : array-like, optional
        Jaw widths (N,) [m], NaN where not known.
    kind : str, optional
        What the hand is, where the file says so.
    quality : FloatArray, optional
        How good the file says each grasp is (N,); 0 for one that failed.
    mesh, mesh_scale : optional
        The mesh that the grasps were made for, and the scale it was given.
    """

    T_object_hand: ArrayLike
    names: tuple[str, ...]
    frame: str | None
    width: ArrayLike | None = None
    kind: str | None = None
    quality: FloatArray | None = None
    mesh: str | None = None
    mesh_scale: float | None = None


def poses(position: FloatArray, quaternion: FloatArray, where: str) -> FloatArray:
    """Return poses (N, 4, 4) of positions (N, 3) and quaternions (N, 4), w first.

    Raises
    ------
    GraspError
        If a quaternion is not of unit length.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of numbers that a damaged file holds
        length = np.linalg.norm(quaternion, axis=1)
    wrong = ~(np.abs(length - 1) <= UNIT)
    if wrong.any():
        first = int(wrong.argmax())
        raise GraspError(f"{where}: the quaternion of grasp {first} has length {length[first]:.3g}; it must be 1")
    T = np.tile(np.eye(4), (len(position), 1, 1))
    if len(T):
        T[:, :3, :3] = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]]).as_matrix()
    T[:, :3, 3] = position
    return T


def from_hdf5(path: Path) -> FileGrasps:
    """Return the grasps of an ACRONYM file.

    Raises
    ------
    GraspError
        If h5py is not installed, or the file is not one of ACRONYM's.
    """
    try:
        import h5py
    except ImportError as error:
        raise GraspError(f"reading {path} needs the package h5py; install regrasp-opt[formats]") from error
    where, names = f"grasp file {path}", ("grasps/transforms", "grasps/qualities/flex/object_in_gripper")
    try:
        with h5py.File(path, "r") as file:
            for name in names:
                if name not in file:
                    raise GraspError(f"{where} lacks '{name}'; it is not a file of ACRONYM's")
            shape = file[names[0]].shape
            if len(shape) != 3 or shape[1:] != (4, 4) or shape[0] > MOST_GRASPS or file[names[1]].shape != shape[:1]:
                raise GraspError(f"{where}: '{names[0]}' has shape {shape}; it must be (N, 4, 4), with N qualities")
            T, quality = (np.asarray(file[name][()], dtype=np.float64) for name in names)
            scale, mesh = (file[name][()] if name in file else None for name in ("object/scale", "object/file"))
    except (OSError, KeyError, ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise GraspError(f"{where} is missing or not an HDF5 file that can be read; download it again") from error
    text = mesh.decode(errors="replace") if isinstance(mesh, bytes) else mesh
    return FileGrasps(T, _rows(len(T)), "acronym", quality=quality, mesh=_text(text), mesh_scale=_scale(scale))


def from_content(content: Any, path: Path) -> FileGrasps:
    """Return the grasps of the parsed JSON or YAML file `path`: Isaac's, GraspGen's or ACRONYM's.

    Raises
    ------
    GraspError
        If it is none of them, or a value is missing or no number.
    """
    where = f"grasp file {path}"
    if not isinstance(content, dict):
        raise GraspError(f"{where} holds no grasps; give a file of Isaac's, GraspGen's or ACRONYM's")
    grasps = content.get("grasps")
    if isinstance(grasps, dict) and "transforms" in grasps:
        return _graspgen(content, where)
    if isinstance(grasps, (dict, list)):
        return _isaac(content, where)
    if "transforms" in content:
        quality = content.get("quality_flex_object_in_gripper")
        return _from_matrices(content["transforms"], quality, where)._replace(
            frame="acronym", mesh=_text(content.get("object")), mesh_scale=_scale(content.get("object_scale"))
        )
    raise GraspError(f"{where} has neither 'grasps' nor 'transforms'; give a file of Isaac's, GraspGen's or ACRONYM's")


def _graspgen(content: dict[str, Any], where: str) -> FileGrasps:
    grasps, (body, gripper) = content["grasps"], (content.get(key) for key in ("object", "gripper"))
    body, gripper = (each if isinstance(each, dict) else {} for each in (body, gripper))
    depth, name = _number(gripper.get("depth")), _text(gripper.get("name"))
    frame = name if name in FRAMES else None if depth is None else str(HandFrame("z", "x", depth))
    found = _from_matrices(grasps["transforms"], grasps.get("object_in_gripper"), where)
    return found._replace(frame=frame, mesh=_text(body.get("file")), mesh_scale=_scale(body.get("scale")))


def _from_matrices(transforms: Any, quality: Any, where: str) -> FileGrasps:
    T = _array(transforms, f"{where}: the 'transforms'")
    values = None if quality is None else _array(quality, f"{where}: what 'object_in_gripper' says").reshape(-1)
    if values is not None and values.shape != T.shape[:1]:
        raise GraspError(f"{where} has {len(T)} transforms and {len(values)} qualities; it may be cut short")
    return FileGrasps(T, _rows(len(T)), None, quality=values)


def _isaac(content: dict[str, Any], where: str) -> FileGrasps:
    grasps = content["grasps"]
    items = list(grasps.items()) if isinstance(grasps, dict) else list(enumerate(grasps))
    position, quaternion, quality = [], [], []
    for name, grasp in items:
        try:
            turn = grasp["orientation"]
            position.append([float(x) for x in grasp["position"]])
            quaternion.append([float(x) for x in (turn["w"], *turn["xyz"])])
            quality.append(float(grasp.get("confidence", 1.0)))
            complete = len(position[-1]) == 3 and len(quaternion[-1]) == 4
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise GraspError(
                f"{where}: grasp '{name}' lacks a number; it needs position: [x, y, z] and orientation: {{w: .., xyz: "
                "[x, y, z]}"
            ) from error
        if not complete:
            raise GraspError(f"{where}: grasp '{name}' has a position or an orientation of the wrong length")
    T = poses(np.array(position).reshape(-1, 3), np.array(quaternion).reshape(-1, 4), where)
    link = next((content[key] for key in ("gripper_frame", "gripper_frame_link") if key in content), None)
    last = str(link).rstrip("/").rsplit("/", 1)[-1]
    frame = "panda_hand" if last in FRANKA_HANDS else last if last in FRAMES else None
    mesh, scale = _text(content.get("object_file")), _scale(content.get("object_scale"))
    names = tuple(str(name) for name, _ in items)
    return FileGrasps(T, names, frame, quality=np.array(quality), mesh=mesh, mesh_scale=scale)


def _rows(count: int) -> tuple[str, ...]:
    return tuple(map(str, range(count)))


def _array(values: Any, what: str) -> FloatArray:
    try:
        return np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise GraspError(f"{what} are not an array of numbers; the file is broken") from error


def _number(value: Any) -> float | None:
    try:
        number = float(value)
    except (TypeError, ValueError):
        return None
    return number if np.isfinite(number) else None


def _scale(value: Any) -> float | None:
    number = _number(value)
    return number if number is not None and number > 0 else None


def _text(value: Any) -> str | None:
    return value if isinstance(value, str) else None
