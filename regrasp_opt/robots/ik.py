"""What all inverse kinematics share: the interface, and how each branch is verified.

A solver proposes joint values; `verify` folds them into the joint limits, drops those that do not fit,
and keeps only those whose forward kinematics gives the pose that was asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from regrasp_opt.conventions import (
    FK_POSITION_TOLERANCE,
    FK_ROTATION_TOLERANCE,
    JOINT_LIMIT_TOLERANCE,
    BoolArray,
    FloatArray,
    IntArray,
    orthonormalise,
    pose_distance,
)
from regrasp_opt.robots.kinematics import SerialChain

DISTINCT = 1e-3
"""Solutions of a pose are the same where no joint differs by more than this [rad, m]."""


class IkSolutions(NamedTuple):
    """Configurations `q` (M, dof) and the index (M,), ascending, of the pose that each one reaches."""

    q: FloatArray
    pose_index: IntArray


class InverseKinematics(Protocol):
    """Finds configurations for poses of the tip."""

    @property
    def name(self) -> str:
        """What it is, for people."""
        ...

    @property
    def parts(self) -> Sequence[Callable[[FloatArray], IkSolutions]]:
        """Functions like `solve` that find some of the configurations each, for those whom any one may satisfy."""
        ...

    def solve(self, T_base_tip: FloatArray) -> IkSolutions:
        """Return configurations within limits that reach `T_base_tip` (B, 4, 4), each one verified."""
        ...


def in_pieces(solve: Callable[[FloatArray], IkSolutions], T: FloatArray, size: int) -> IkSolutions:
    """Return what `solve` finds for poses `T` (B, 4, 4), at most `size` of them at a time."""
    found = [solve(T[first : first + size]) for first in range(0, max(len(T), 1), size)]
    index = [solutions.pose_index + size * piece for piece, solutions in enumerate(found)]
    return IkSolutions(np.concatenate([solutions.q for solutions in found]), np.concatenate(index))


def nearest_rotations(T: ArrayLike) -> FloatArray:
    """Return poses (B, 4, 4) in float64, those that are off by rounding with exact rotations."""
    T = np.array(T, dtype=np.float64).reshape(-1, 4, 4)
    gram = np.swapaxes(T[:, :3, :3], -1, -2) @ T[:, :3, :3]
    off = np.abs(gram - np.eye(3)).max(axis=(1, 2)) > 1e-14
    if off.any():
        T[off] = orthonormalise(T[off])
    return T


def principal(q: FloatArray, lower: FloatArray, upper: FloatArray, turning: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return `q` (M, dof) with `turning` joints moved by whole turns into their limits, and which rows fit.

    Of several values within `lower` and `upper` (dof,) [rad, m] the one nearest to 0 is taken. A row fits,
    in the second array (M,), when each of its joints has one.
    """
    wrapped = np.where(turning, q - 2 * np.pi * np.round(q / (2 * np.pi)), q)
    low, high = lower - JOINT_LIMIT_TOLERANCE, upper + JOINT_LIMIT_TOLERANCE
    turns = np.where(wrapped > high, np.floor((high - wrapped) / (2 * np.pi)), 0.0)
    turns = np.where(wrapped < low, np.ceil((low - wrapped) / (2 * np.pi)), turns)
    moved = np.where(turning, wrapped + 2 * np.pi * turns, wrapped)
    fits: BoolArray = np.all((moved >= low) & (moved <= high), axis=-1)
    return moved, fits


def one_turn(chain: SerialChain, lower: FloatArray, upper: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return limits (dof,) within `lower` and `upper` (dof,) that leave a turning joint at most one turn, around 0."""
    low = np.where(chain.prismatic, lower, np.maximum(lower, np.clip(0.0, lower, upper) - np.pi))
    return low, np.where(chain.prismatic, upper, np.minimum(upper, low + 2 * np.pi))


def reaches(chain: SerialChain, T: FloatArray, q: FloatArray) -> BoolArray:
    """Return which configurations `q` (M, dof) put the tip at `T` (M, 4, 4), within the tolerances."""
    distance, angle = pose_distance(chain.forward(q), T)
    return (distance <= FK_POSITION_TOLERANCE) & (angle <= FK_ROTATION_TOLERANCE)


def verify(
    chain: SerialChain, T: FloatArray, solutions: IkSolutions, lower: FloatArray, upper: FloatArray
) -> IkSolutions:
    """Return the `solutions` that have a place within limits (dof,) and reach their pose of `T` (B, 4, 4)."""
    q, fits = principal(solutions.q, lower, upper, ~chain.prismatic)
    q, index = q[fits], solutions.pose_index[fits]
    good = reaches(chain, T[index], q)
    return IkSolutions(q[good], index[good])


def distinct(solutions: IkSolutions) -> IkSolutions:
    """Return the `solutions` without those that repeat an earlier one of the same pose, up to whole turns."""
    q, index = solutions
    first = np.ones(len(q), dtype=bool)
    for gap in range(1, len(q)):
        same = index[gap:] == index[:-gap]
        if not same.any():
            break
        later = np.flatnonzero(same & (np.abs(q[gap:, 0] - q[:-gap, 0]) < DISTINCT))
        apart = q[later + gap] - q[later]
        first[later[np.abs(apart).max(axis=1, initial=0.0) < DISTINCT] + gap] = False
    return IkSolutions(q[first], index[first])
