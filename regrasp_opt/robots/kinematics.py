"""Forward kinematics of a serial chain for whole batches of configurations.

The same products of joint placements as Pinocchio's, over arrays (Lynch and Park, Modern Robotics, section
4.1); tests hold them to Pinocchio. Each joint frame is turned once, at the start, so that its axis is z: a
joint then costs one constant (3, 3) product and one mixing of two columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, DTypeLike

from regrasp_opt.conventions import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class SerialChain:
    """A chain of one-degree joints between a base frame and a tip frame.

    Attributes
    ----------
    placements : (dof, 4, 4) array
        Pose of each joint frame at q = 0 in the joint frame before it; the first one in the base frame [m].
    axes : (dof, 3) array
        Unit axis of each joint in its own frame.
    prismatic : (dof,) bool array
        Whether the joint slides along its axis [m] instead of turning about it [rad].
    tip : (4, 4) array
        Pose of the tip in the last joint frame [m].
    still : int, optional
        Number of a joint that solvers leave where it is.
    """

    placements: FloatArray
    axes: FloatArray
    prismatic: BoolArray
    tip: FloatArray
    still: int | None = None

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.axes)

    @cached_property
    def _turned(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Rotations (dof, 3, 3) that take z to each axis; placements and tip between the frames so turned."""
        turn = np.array([_z_to(axis) for axis in self.axes])
        after = np.concatenate([self.placements[1:], self.tip[None]])
        steps: FloatArray = np.concatenate([self.placements[:1], after])
        steps[1:, :3] = np.swapaxes(turn, -1, -2) @ steps[1:, :3]
        steps[:-1, :3, :3] = steps[:-1, :3, :3] @ turn
        return turn, steps[:-1], steps[-1]

    def frames(self, q: ArrayLike, dtype: DTypeLike = np.float64) -> tuple[list[FloatArray], list[FloatArray]]:
        """Axes and origins of the turned joint frames after their joints, then of the tip, computed in `dtype`.

        Axes are (3, 3, B), the first index telling which axis; origins are (3, B). With the batch last,
        every operation runs over contiguous memory.
        """
        steps: FloatArray = np.concatenate([self._turned[1], self._turned[2][None]]).astype(dtype, copy=False)
        q = np.asarray(q, dtype=dtype).reshape(-1, self.dof).T
        c, s = np.cos(q), np.sin(q)
        axes: FloatArray = np.eye(3, dtype=dtype)[:, :, None].repeat(q.shape[1], -1)
        origin: FloatArray = np.zeros((3, q.shape[1]), dtype=dtype)
        all_axes, origins = [], []
        for i, step in enumerate(steps):
            flat = axes.reshape(3, -1)
            origin = origin + (step[:3, 3] @ flat).reshape(3, -1)
            axes = (step[:3, :3].T @ flat).reshape(3, 3, -1)
            if i < self.dof and self.prismatic[i]:
                origin = origin + axes[2] * q[i]
            elif i < self.dof:
                axes[:2] = axes[0] * c[i] + axes[1] * s[i], axes[1] * c[i] - axes[0] * s[i]
            all_axes.append(axes)
            origins.append(origin)
        return all_axes, origins

    def forward(self, q: ArrayLike) -> FloatArray:
        """Return ``T_base_tip`` (..., 4, 4) at configurations `q` (..., dof)."""
        axes, origins = self.frames(q)
        return _assemble(axes[-1], origins[-1]).reshape(*np.shape(q)[:-1], 4, 4)

    def link_transforms(self, q: ArrayLike) -> FloatArray:
        """Return the poses (..., dof, 4, 4) of all joint frames in the base frame at `q` (..., dof)."""
        axes, origins = self.frames(q)
        frames = np.stack([_assemble(a, o) for a, o in zip(axes[:-1], origins[:-1], strict=True)], axis=1)
        frames[..., :3, :3] = frames[..., :3, :3] @ np.swapaxes(self._turned[0], -1, -2)
        return frames.reshape(*np.shape(q)[:-1], self.dof, 4, 4)

    def locked(self, joint: int, value: float) -> SerialChain:
        """Return this chain without the joint of number `joint`, which stands still at `value` [rad, m]."""
        one = slice(joint, joint + 1)
        still = SerialChain(self.placements[one], self.axes[one], self.prismatic[one], np.eye(4)).forward([value])
        steps: FloatArray = np.concatenate([self.placements, self.tip[None]])
        steps[joint + 1] = still @ steps[joint + 1]
        *placements, tip = np.delete(steps, joint, axis=0)
        others = np.arange(self.dof) != joint
        return SerialChain(np.array(placements), self.axes[others], self.prismatic[others], tip)

    def reach(self, lower: FloatArray, upper: FloatArray) -> float:
        """Return an upper bound on the distance from base origin to tip within joint limits (dof,) [m]."""
        slides = np.where(self.prismatic, np.maximum(np.abs(lower), np.abs(upper)), 0.0)
        offsets = np.linalg.norm(self.placements[:, :3, 3], axis=-1)
        return float(offsets.sum() + slides.sum() + np.linalg.norm(self.tip[:3, 3]))


def chain_of_model(model: pin.Model, tip_frame: str) -> SerialChain:
    """Return the chain of a Pinocchio `model` whose joints lead one by one to the frame `tip_frame`."""
    data = model.createData()
    pin.computeJointJacobians(model, data, np.zeros(model.nq))
    axes, prismatic = [], []
    for joint in range(1, model.njoints):
        jacobian = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
        column = jacobian.reshape(6, -1)[:, joint - 1]
        prismatic.append(bool(np.linalg.norm(column[3:]) < 0.5))
        axes.append(column[:3] if prismatic[-1] else column[3:])
    placements = np.array([placement.homogeneous for placement in list(model.jointPlacements)[1:]])
    tip = model.frames[model.getFrameId(tip_frame)].placement.homogeneous
    return SerialChain(placements, np.array(axes), np.array(prismatic), np.array(tip))


def _assemble(axes: FloatArray, origin: FloatArray) -> FloatArray:
    T = np.zeros((origin.shape[1], 4, 4))
    T[:, :3, :3], T[:, :3, 3], T[:, 3, 3] = axes.T, origin.T, 1.0
    return T


def _z_to(axis: FloatArray) -> FloatArray:
    """Return a rotation (3, 3) whose third column is the unit vector `axis`; the identity for z itself."""
    if np.array_equal(axis, (0.0, 0.0, 1.0)):
        return np.eye(3)
    x = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=-1)
