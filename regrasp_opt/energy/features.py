"""What the energy sees of a pose and a grasp.

``paper``: the object pose ``T`` and the grasp ``g`` (Section III-A of the paper).
``tcp``: the same and the world pose of the tool, ``T @ g``. It is a function of the other two that the network
would otherwise have to learn, and it is affine in the entries of ``T``, so the first layer stays affine as well.

A transform enters as its upper three rows, row by row (12 numbers), a grasp as its transform and, where wanted, its
jaw width in metres. Standardisation is folded into the first layer after training, so models take raw features.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.grasps import GraspSet

FeatureSet = Literal["paper", "tcp"]
FEATURE_SETS: tuple[FeatureSet, ...] = ("paper", "tcp")


def feature_count(features: FeatureSet, use_width: bool) -> int:
    """Return the length of the feature vector."""
    return 24 + (12 if features == "tcp" else 0) + int(use_width)


def pair_features(T: FloatArray, grasps: GraspSet, features: FeatureSet, use_width: bool) -> FloatArray:
    """Return features (M, F) of M (pose, grasp) pairs: `T` (M, 4, 4) with the M grasps of `grasps`."""
    parts = [T[:, :3].reshape(-1, 12), grasps.T_object_tcp[:, :3].reshape(-1, 12)]
    if features == "tcp":
        parts.append((T @ grasps.T_object_tcp)[:, :3].reshape(-1, 12))
    if use_width:
        parts.append(grasps.width[:, None])
    return np.concatenate(parts, axis=1)
