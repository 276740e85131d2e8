"""Grasp files: our own (npz, CSV) and those of other tools, as arrays in the frame and unit of the file."""

from __future__ import annotations

import csv
import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import GraspError
from regrasp_opt.files import UNREADABLE_ARRAYS, atomic_path
from regrasp_opt.grasps.foreign_files import FileGrasps, from_content, from_hdf5, poses
from regrasp_opt.schemas import read_json, read_yaml

SUFFIXES = (".npz", ".csv", ".h5", ".hdf5", ".json", ".yaml", ".yml")

POSE_COLUMNS = ("x", "y", "z", "qw", "qx", "qy", "qz")
COLUMNS = ("name", *POSE_COLUMNS, "width", "kind")
"""Columns of a CSV file; name, width and kind need not be there, and a width may be left empty."""


def read_grasp_file(path: str | os.PathLike[str]) -> FileGrasps:
    """Return what the grasp file `path` holds; its suffix says how it is read.

    Raises
    ------
    GraspError
        If the file is missing or broken, is of no known format, or holds no grasps.
    """
    path, suffix = Path(path), Path(path).suffix.lower()
    if suffix not in SUFFIXES:
        raise GraspError(f"grasp file {path} has no known suffix; known: {', '.join(SUFFIXES)}")
    if suffix == ".npz":
        return _from_npz(path)
    if suffix == ".csv":
        return _from_csv(path)
    if suffix in (".h5", ".hdf5"):
        return from_hdf5(path)
    content = read_json(path, "grasp file", GraspError) if suffix == ".json" else _first(read_yaml(path, GraspError))
    return from_content(content, path)


def _first(documents: list[object]) -> object:
    return documents[0] if documents else None


def _from_npz(path: Path) -> FileGrasps:
    where, needed = f"grasp file {path}", ("T_object_tcp", "width", "kind")
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            content = {key: data[key] for key in (*needed, "names") if key in data}
    except UNREADABLE_ARRAYS as error:
        raise GraspError(f"{where} is missing or corrupt; sample the grasps again") from error
    missing = [key for key in needed if key not in content]
    if missing:
        raise GraspError(f"{where} lacks the array '{missing[0]}'; it needs T_object_tcp, width and kind")
    names = tuple(str(name) for name in np.ravel(content.get("names", ())))
    return FileGrasps(content["T_object_tcp"], names, "tcp", width=content["width"], kind=str(content["kind"]))


def _from_csv(path: Path) -> FileGrasps:
    where = f"grasp file {path}"
    try:
        with open(path, encoding="utf-8-sig", newline="") as file:
            reader = csv.DictReader(file, skipinitialspace=True)
            rows, header = list(reader), tuple(reader.fieldnames or ())
    except (OSError, ValueError, csv.Error) as error:
        raise GraspError(f"{where} is missing or not a CSV file; give a table with a line of column names") from error
    wrong = [name for name in header if name not in COLUMNS] or [name for name in POSE_COLUMNS if name not in header]
    if wrong:
        raise GraspError(
            f"{where}: column '{wrong[0]}' is {'unknown' if wrong[0] in header else 'missing'}; the first line names "
            f"the columns: {', '.join(COLUMNS)}"
        )
    twice = next((name for k, name in enumerate(header) if name in header[:k]), None)
    if twice is not None:
        raise GraspError(f"{where}: column '{twice}' is there twice; keep the one that counts")
    numbers = np.zeros((len(rows), len(POSE_COLUMNS)))
    for number, row in enumerate(rows):
        if None in row or None in row.values():
            raise GraspError(f"{where}: row {number + 1} has not as many values as the first line has columns")
        try:
            numbers[number] = [float(row[name]) for name in POSE_COLUMNS]
            row["width"] = float(row.get("width") or "nan")
        except ValueError as error:
            raise GraspError(f"{where}: row {number + 1} holds something that is not a number") from error
    kinds = {row.get("kind") or "parallel" for row in rows}
    if len(kinds) > 1:
        raise GraspError(f"{where} has grasps of several kinds, {' and '.join(sorted(kinds))}; write one file for each")
    return FileGrasps(
        poses(numbers[:, :3], numbers[:, 3:], where),
        tuple(row["name"] for row in rows) if "name" in header else (),
        "tcp",
        width=np.array([row["width"] for row in rows], dtype=np.float64),
        kind=next(iter(kinds), "parallel"),
    )


def write_grasp_file(
    path: str | os.PathLike[str], T_object_tcp: FloatArray, width: FloatArray, kind: str, names: Sequence[str]
) -> None:
    """Write grasps as ``.npz`` or ``.csv``, by the suffix of `path`, atomically.

    Raises
    ------
    GraspError
        If `path` has another suffix.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".npz", ".csv"):
        raise GraspError(f"'{os.fspath(path)}' has no suffix that grasps are written with; give .npz or .csv")
    with atomic_path(path) as temporary:
        if suffix == ".npz":
            extra: dict[str, ArrayLike] = {"names": np.array(names)} if names else {}
            with temporary.open("wb") as file:
                np.savez(file, T_object_tcp=T_object_tcp, width=width, kind=np.array(kind), **extra)  # type: ignore[arg-type]
            return
        quaternions = Rotation.from_matrix(T_object_tcp[:, :3, :3].reshape(-1, 3, 3)).as_quat()[:, [3, 0, 1, 2]]
        with temporary.open("w", encoding="utf-8", newline="") as table:
            writer = csv.writer(table, lineterminator="\n")
            writer.writerow(COLUMNS)
            for k, (T, q, w) in enumerate(zip(T_object_tcp, quaternions, width, strict=True)):
                numbers = [repr(float(x)) for x in (*T[:3, 3], *q)]
                writer.writerow([names[k] if names else k, *numbers, "" if np.isnan(w) else repr(float(w)), kind])
