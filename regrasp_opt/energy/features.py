"""What the energy sees of a pose and a grasp, and which columns of the first layer that takes.

``paper``: the object pose ``T`` and the grasp ``g`` (Section III-A of the paper).
``tcp``: the same and the world pose of the tool, ``T @ g``. It is a function of the other two that the network
would otherwise have to learn, and it is affine in the entries of ``T``, so the first layer stays affine as well.
``arm``: the pose of the tool alone. Such an energy knows no object, so it serves every one.

A transform enters as its upper three rows, row by row (12 numbers), a grasp as its transform and, where wanted, its
jaw width in metres. Standardisation is folded into the first layer after training, so models take raw features.

This is the only module that knows the order of the inputs. A new feature set is a line in `BLOCKS`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.grasps import GraspSet

FeatureSet = Literal["paper", "tcp", "arm"]

BLOCKS: dict[FeatureSet, tuple[str, ...]] = {
    "paper": ("pose", "grasp"),
    "tcp": ("pose", "grasp", "tcp"),
    "arm": ("tcp",),
}
"""The transforms that each feature set sees, in the order of the inputs; the jaw width comes last."""

FEATURE_SETS: tuple[FeatureSet, ...] = tuple(BLOCKS)


class InputWeights(NamedTuple):
    """The columns of a first layer of H units by what they weigh; zeros for what the model does not see.

    `pose` and `tcp` (3, H, 4) weigh the three upper rows of the object pose ``T`` and of the tool pose ``T @ g``,
    `grasp` (H, 12) the upper rows of the grasp ``g``, row by row, `width` (H,) the jaw width.
    """

    pose: FloatArray
    tcp: FloatArray
    grasp: FloatArray
    width: FloatArray


def feature_count(features: FeatureSet, use_width: bool) -> int:
    """Return the length of the feature vector."""
    return 12 * len(BLOCKS[features]) + int(use_width)


def pair_features(T: FloatArray, grasps: GraspSet, features: FeatureSet, use_width: bool) -> FloatArray:
    """Return features (M, F) of M (pose, grasp) pairs: `T` (M, 4, 4) with the M grasps of `grasps`."""
    g = grasps.T_object_tcp
    transforms = {"pose": T, "grasp": g, "tcp": T @ g}
    parts = [transforms[block][:, :3].reshape(-1, 12) for block in BLOCKS[features]]
    return np.concatenate([*parts, grasps.width[:, None]] if use_width else parts, axis=1)


def with_tcp_weights(W: FloatArray, features: FeatureSet, tcp: FloatArray) -> FloatArray:
    """Return the first layer's weights `W` (H, F) with other weights `tcp` (3, H, 4) of the tool pose."""
    changed, first = W.copy(), 12 * BLOCKS[features].index("tcp")
    changed[:, first : first + 12] = tcp.transpose(1, 0, 2).reshape(len(W), 12)
    return changed


def input_weights(W: FloatArray, features: FeatureSet, use_width: bool) -> InputWeights:
    """Return the first layer's weights `W` (H, F) by what they weigh."""
    blocks = {block: W[:, 12 * i : 12 * (i + 1)] for i, block in enumerate(BLOCKS[features])}
    nothing = np.zeros((len(W), 12))
    pose, tcp = (blocks.get(name, nothing).reshape(-1, 3, 4).transpose(1, 0, 2) for name in ("pose", "tcp"))
    return InputWeights(pose, tcp, blocks.get("grasp", nothing), W[:, -1] if use_width else nothing[:, 0])
