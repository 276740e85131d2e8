"""The grasp set: TCP poses in the object frame with their jaw widths, addressed by index everywhere else."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray, as_pose
from regrasp_opt.errors import GraspError, PoseError
from regrasp_opt.files import UNREADABLE_ARRAYS, atomic_path, content_hash

KINDS = ("parallel", "suction")

FARTHEST = 100.0
"""Largest coordinate of a tool pose and largest width [m]; more are millimetres, or damage."""

ORTHONORMAL = 1e-9
"""How far a rotation may be from orthonormal and still be taken as it is."""


@dataclass(frozen=True, eq=False)
class GraspSet:
    """Grasps of one object with one end-effector.

    Attributes
    ----------
    T_object_tcp : FloatArray
        TCP poses in the object frame (G, 4, 4): z approach, y closing direction. Lists and other types of numbers are
        converted, and rotations that are off by up to `RIGID_TOLERANCE` are made orthonormal.
    width : FloatArray
        Distance between the contacts, which is the jaw opening when closed (G,) [m]; 0 for suction.
    kind : {"parallel", "suction"}
        What holds the object.

    Raises
    ------
    GraspError
        If shapes disagree, or the kind is unknown; names the first grasp whose pose is not rigid, not finite or far
        away, or whose width is not a length.
    """

    T_object_tcp: FloatArray
    width: FloatArray
    kind: Literal["parallel", "suction"]

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(self, T_object_tcp: ArrayLike, width: ArrayLike, kind: Literal["parallel", "suction"]) -> None: ...

    def __post_init__(self) -> None:
        T, width = _numbers(self.T_object_tcp, "poses"), _numbers(self.width, "widths")
        T = T.reshape(0, 4, 4) if T.size == 0 else T
        if T.ndim != 3 or T.shape[1:] != (4, 4) or width.shape != T.shape[:1]:
            raise GraspError(f"a grasp set has poses {T.shape} and widths {width.shape}; give (G, 4, 4) and (G,)")
        if self.kind not in KINDS:
            raise GraspError(f"a grasp set has kind '{self.kind}'; kinds are {', '.join(KINDS)}")
        good = np.isfinite(width) & (width >= 0) & (width <= FARTHEST)
        if not good.all():
            first = int((~good).argmax())
            raise GraspError(f"the width of grasp {first} is {width[first]:g}; give metres, 0 or more")
        T = _orthonormal(T)
        distance = np.abs(T[:, :3, 3]).max(axis=1, initial=0.0)
        if (distance > FARTHEST).any():
            first = int(distance.argmax())
            raise GraspError(f"the pose of grasp {first} is {distance[first]:.3g} m from the object; give metres")
        object.__setattr__(self, "T_object_tcp", T)
        object.__setattr__(self, "width", width)

    def __len__(self) -> int:
        return len(self.width)

    def subset(self, ids: ArrayLike) -> GraspSet:
        """Return the grasps with indices `ids` (K,), in that order, or those where the mask `ids` (G,) is true."""
        index = np.asarray(ids)
        index = index if index.dtype == bool else index.astype(np.int64)
        return GraspSet(self.T_object_tcp[index], self.width[index], self.kind)

    def fingerprint(self) -> str:
        """Return a hash of poses, widths and kind; it depends on the order."""
        return content_hash("grasps", self.kind, self.T_object_tcp, self.width)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the set to the ``.npz`` file `path`, atomically."""
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.savez(file, T_object_tcp=self.T_object_tcp, width=self.width, kind=np.array(self.kind))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> GraspSet:
        """Return the set that `save` wrote to `path`.

        Raises
        ------
        GraspError
            If the file is missing, corrupt or holds no valid grasp set.
        """
        where = f"grasp file {os.fspath(path)}"
        try:
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
                missing = [key for key in ("T_object_tcp", "width", "kind") if key not in data]
                T, width, kind = (None if missing else data[key] for key in ("T_object_tcp", "width", "kind"))
        except UNREADABLE_ARRAYS as error:
            raise GraspError(f"{where} is missing or corrupt; sample the grasps again") from error
        if missing:
            raise GraspError(f"{where} lacks the array '{missing[0]}'; it needs T_object_tcp, width and kind")
        try:
            return cls(T, width, str(kind))  # type: ignore[arg-type]
        except GraspError as error:
            raise GraspError(f"{where}: {error}") from error


def _numbers(values: ArrayLike, what: str) -> FloatArray:
    """Return `values` as an array of float64; `what` they are is named in errors."""
    try:
        array = np.asarray(values)
        if array.dtype.kind in "fiu":
            with np.errstate(over="ignore"):
                return array.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    raise GraspError(f"the {what} of a grasp set are not an array of numbers; give nested lists or arrays of them")


def _orthonormal(T: FloatArray) -> FloatArray:
    """Return `T` (G, 4, 4) with orthonormal rotations: rounding is mended, what is off by more refused."""
    rotation = T[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.abs(np.swapaxes(rotation, 1, 2) @ rotation - np.eye(3)).max(axis=(1, 2), initial=0.0)
        good = (error < ORTHONORMAL) & (np.linalg.det(rotation) > 0) & np.isfinite(T).all(axis=(1, 2))
    good &= (T[:, 3] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    if good.all():
        return T
    T = T.copy()
    for index in np.flatnonzero(~good).tolist():
        try:
            T[index] = as_pose(T[index], f"pose of grasp {index}")
        except PoseError as error:
            raise GraspError(str(error)) from error
    return T
