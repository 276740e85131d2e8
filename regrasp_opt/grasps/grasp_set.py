"""The grasp set: TCP poses in the object frame with their jaw widths, addressed by index everywhere else."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import GraspError
from regrasp_opt.files import UNREADABLE_ARRAYS, atomic_path, content_hash

KINDS = ("parallel", "suction")


@dataclass(frozen=True, eq=False)
class GraspSet:
    """Grasps of one object with one end-effector.

    Attributes
    ----------
    T_object_tcp : FloatArray
        TCP poses in the object frame (G, 4, 4): z approach, y closing direction.
    width : FloatArray
        Distance between the contacts, which is the jaw opening when closed (G,) [m]; 0 for suction.
    kind : {"parallel", "suction"}
        What holds the object.

    Raises
    ------
    GraspError
        If shapes disagree, a pose is not rigid or not finite, a width is negative or the kind is unknown.
    """

    T_object_tcp: FloatArray
    width: FloatArray
    kind: Literal["parallel", "suction"]

    def __post_init__(self) -> None:
        T, width = self.T_object_tcp, self.width
        if T.ndim != 3 or T.shape[1:] != (4, 4) or width.shape != T.shape[:1]:
            raise GraspError(f"a grasp set has poses {T.shape} and widths {width.shape}; give (G, 4, 4) and (G,)")
        if not (np.isfinite(width).all() and _are_rigid(T)):
            raise GraspError("a grasp set holds a pose that is not rigid or not finite; sample the grasps again")
        if (width < 0).any() or self.kind not in KINDS:
            raise GraspError(f"a grasp set has a negative width or kind '{self.kind}'; kinds are {', '.join(KINDS)}")

    def __len__(self) -> int:
        return len(self.width)

    def subset(self, ids: ArrayLike) -> GraspSet:
        """Return the grasps whose indices `ids` (K,) are, or where the mask `ids` (G,) is true, in that order."""
        index = np.asarray(ids)
        index = index if index.dtype == bool else index.astype(np.int64)
        return GraspSet(self.T_object_tcp[index], self.width[index], self.kind)

    def fingerprint(self) -> str:
        """Return a hash of poses, widths and kind; it depends on the order."""
        return content_hash("grasps", self.kind, self.T_object_tcp, self.width)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the set to the ``.npz`` file `path`, whole or not at all."""
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
        try:
            with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
                T, width, kind = (data[key] for key in ("T_object_tcp", "width", "kind"))
        except UNREADABLE_ARRAYS as error:
            raise GraspError(f"grasp file {os.fspath(path)} is missing or corrupt; sample the grasps again") from error
        if T.dtype.kind != "f" or width.dtype.kind != "f":
            raise GraspError(f"grasp file {os.fspath(path)} holds no numbers; sample the grasps again")
        return cls(T.astype(np.float64), width.astype(np.float64), str(kind))  # type: ignore[arg-type]


def _are_rigid(T: FloatArray) -> bool:
    """Return whether all `T` (G, 4, 4) are finite, and rotations in their upper left."""
    rotation = T[:, :3, :3]
    if not (np.isfinite(T).all() and (np.abs(rotation) < 2).all()):
        return False
    orthonormal = np.allclose(rotation @ np.swapaxes(rotation, 1, 2), np.eye(3), atol=1e-6)
    return orthonormal and bool((np.linalg.det(rotation) > 0).all())
