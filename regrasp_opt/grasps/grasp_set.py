"""The grasp set: TCP poses in the object frame with their jaw widths, addressed by index everywhere else."""

from __future__ import annotations

import logging
import os
import shlex
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import BoolArray, FloatArray, as_pose
from regrasp_opt.errors import GraspError, PoseError
from regrasp_opt.files import content_hash
from regrasp_opt.grasps.files import read_grasp_file, write_grasp_file
from regrasp_opt.grasps.hand_frames import FRAMES, hand_frame

KINDS = ("parallel", "suction")

FARTHEST = 100.0
"""Largest coordinate of a tool pose and largest width [m]; more are millimetres, or damage."""

LIKELY_FARTHEST = 10.0
"""If half the positions in a file are farther from the object's origin than this [m], they are millimetres."""

ORTHONORMAL = 1e-9
"""How far a rotation may be from orthonormal and still be taken as it is."""

logger = logging.getLogger(__name__)


class GraspSource(NamedTuple):
    """Where grasps were read from, and how their file was understood.

    Attributes
    ----------
    path : str
        The file.
    frame : str
        The hand frame that its poses were taken to be of, as `regrasp_opt.grasps.hand_frames.hand_frame` takes it.
    scale, min_quality
        Same as in `GraspSet.load`.
    mesh, mesh_scale : optional
        The mesh that the file says the grasps are for, and its scale.
    """

    path: str
    frame: str
    scale: float = 1.0
    min_quality: float | None = None
    mesh: str | None = None
    mesh_scale: float | None = None

    @property
    def arguments(self) -> str:
        """Options of the command line that read the same grasps."""
        text = f"--grasps {shlex.quote(os.path.abspath(self.path))} --grasp-frame={self.frame}"
        text += "" if self.scale == 1.0 else f" --grasp-scale {self.scale:g}"
        return text if self.min_quality is None else f"{text} --grasp-quality {self.min_quality:g}"


@dataclass(frozen=True, eq=False)
class GraspSet:
    """Grasps of one object with one end-effector.

    Attributes
    ----------
    T_object_tcp : FloatArray
        TCP poses in the object frame (G, 4, 4): z approach, y closing direction. Lists and other types of numbers are
        converted, and rotations that are off by up to `RIGID_TOLERANCE` are made orthonormal.
    width : FloatArray
        Distance between the contacts, which is the jaw opening when closed (G,) [m]; 0 for suction. None is taken for
        grasps that were made elsewhere, and kept as NaN: `RegraspProblem.load` finds the widths on the object.
    kind : {"parallel", "suction"}
        What holds the object.
    names : tuple of str
        Names of the grasps (G,) in the file they came from, or none.
    source : GraspSource or None
        That file.

    Raises
    ------
    GraspError
        If shapes disagree, or the kind is unknown; names the first grasp whose pose is not rigid, not finite or far
        away, or whose width is not a length.
    """

    T_object_tcp: FloatArray
    width: FloatArray
    kind: Literal["parallel", "suction"]
    names: tuple[str, ...] = ()
    source: GraspSource | None = None

    if TYPE_CHECKING:  # what is taken is more than what is kept

        def __init__(
            self,
            T_object_tcp: ArrayLike,
            width: ArrayLike | None,
            kind: Literal["parallel", "suction"],
            names: tuple[str, ...] = (),
            source: GraspSource | None = None,
        ) -> None: ...

    def __post_init__(self) -> None:
        T = _numbers(self.T_object_tcp, "poses")
        T = T.reshape(0, 4, 4) if T.size == 0 else T
        width = np.full(T.shape[:1], np.nan) if self.width is None else _numbers(self.width, "widths")
        if T.ndim != 3 or T.shape[1:] != (4, 4) or width.shape != T.shape[:1]:
            raise GraspError(f"a grasp set has poses {T.shape} and widths {width.shape}; give (G, 4, 4) and (G,)")
        if self.kind not in KINDS:
            raise GraspError(f"a grasp set has kind '{self.kind}'; kinds are {', '.join(KINDS)}")
        good = np.isfinite(width) & (width >= 0) & (width <= FARTHEST)
        if not good.all() and not np.isnan(width).all():
            first = int((~good).argmax())
            raise GraspError(f"the width of grasp {first} is {width[first]:g}; give metres, 0 or more")
        if self.names and len(self.names) != len(width):
            raise GraspError(f"a grasp set has {len(width)} poses and {len(self.names)} names; give as many, or none")
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
        names = tuple(np.array(self.names, dtype=object)[index]) if self.names else ()
        return replace(self, T_object_tcp=self.T_object_tcp[index], width=self.width[index], names=names)

    @property
    def settled(self) -> bool:
        """Whether the widths are known: grasps made elsewhere are not on the object yet."""
        return not np.isnan(self.width).any()

    def need_widths(self) -> None:
        """Refuse grasps that are not on the object yet.

        Raises
        ------
        GraspError
            If the widths are not known.
        """
        if not self.settled:
            raise GraspError(
                "the widths of these grasps are not known yet; RegraspProblem.load(grasps=...) puts them on the object"
            )

    def name(self, index: int) -> str:
        """Return the name of grasp `index`, or the number itself where grasps have no names."""
        return self.names[index] if self.names else str(index)

    def fingerprint(self) -> str:
        """Return a hash of poses, widths and kind; it depends on the order."""
        return content_hash("grasps", self.kind, self.T_object_tcp, self.width)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the set to `path`, ``.npz`` or ``.csv``, atomically.

        Raises
        ------
        GraspError
            If the suffix is another.
        """
        write_grasp_file(path, self.T_object_tcp, self.width, self.kind, self.names)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        *,
        frame: str | None = None,
        scale: float = 1.0,
        min_quality: float | None = None,
    ) -> GraspSet:
        """Return the grasps of a file: what `save` wrote, or ACRONYM's, GraspGen's or Isaac's (docs/grasp-files.md).

        Other tools' files hold no widths. `RegraspProblem.load` puts such grasps on the object, which finds them.

        Parameters
        ----------
        path : path
            ``.npz``, ``.csv``, ``.h5``, ``.json`` or ``.yaml``.
        frame : str, optional
            The hand frame of the file's poses, by name or as ``"APPROACH,CLOSING,TCP"``, such as ``"z,x,0.1034"``; by
            default what the file says or its format has. See `regrasp_opt.grasps.hand_frames`.
        scale : float
            Metres per unit of the file's positions.
        min_quality : float, optional
            Least quality of a grasp, as the file has it; by default all but those that the file says failed (0).

        Raises
        ------
        GraspError
            If the file is missing, corrupt or holds no valid grasps, if it does not say what frame its poses are of,
            or if its positions must be in millimetres.
        """
        where, read = f"grasp file {os.fspath(path)}", read_grasp_file(path)
        chosen = frame or read.frame
        if chosen is None:
            raise GraspError(
                f"{where} does not say which hand's frame its poses are of; give frame (--grasp-frame): one of "
                f"{', '.join(FRAMES)}, or APPROACH,CLOSING,TCP, such as z,x,0.1034"
            )
        hand = hand_frame(chosen)
        if not (np.isfinite(scale) and scale > 0):
            raise GraspError(f"the scale of grasps is {scale}; give a positive number")
        try:
            T = _numbers(read.T_object_hand, "poses")
            if T.ndim == 3 and T.shape[1:] == (4, 4):
                T = T.copy()
                T[:, :3, 3] *= scale
                middle = float(np.median(np.abs(T[:, :3, 3]).max(axis=1))) if len(T) else 0.0
                if middle > LIKELY_FARTHEST:
                    raise GraspError(
                        f"half its positions are {middle:.3g} m or more from the object's origin, which looks like "
                        f"millimetres; give scale (--grasp-scale) {scale * 1e-3:g}"
                    )
                T = cls(T, None, hand.kind).T_object_tcp @ hand.T_hand_tcp
            source = GraspSource(os.fspath(path), chosen, scale, min_quality, read.mesh, read.mesh_scale)
            grasps = cls(T, read.width, read.kind or hand.kind, read.names, source)  # type: ignore[arg-type]
        except GraspError as error:
            raise GraspError(f"{where}: {error}") from error
        return grasps.subset(_good(read.quality, len(grasps), min_quality, where))


def _good(quality: FloatArray | None, count: int, least: float | None, where: str) -> BoolArray:
    """Return which of `count` grasps are of the quality asked for (count,); says how many are not."""
    if count == 0:
        raise GraspError(f"{where} holds no grasps; sample or write at least one")
    if quality is None:
        return np.ones(count, dtype=bool)
    good = quality > 0 if least is None else quality >= least
    if not good.any():
        raise GraspError(
            f"{where}: none of the {count} grasps has a quality of {'more than 0' if least is None else f'{least:g}'}; "
            f"the best has {quality.max():g}"
        )
    if not good.all():
        said = "the file says that they failed" if least is None else f"their quality is below {least:g}"
        logger.warning("%s: %d of %d grasps are left out: %s", where, (~good).sum(), count, said)
    return good


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
