"""Rigid transforms for tests."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

IN_THE_BASE = np.array([0.0, 0.1, 0.8])
"""Planar parameters at which the bottle's edge is in the robot's base, in every placement [m, m, rad]."""


def random_transforms(rng: np.random.Generator, count: int, spread: float = 0.1) -> np.ndarray:
    """Return poses (count, 4, 4) with uniform rotations and normal translations of deviation `spread` [m]."""
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    T[:, :3, 3] = rng.normal(size=(count, 3)) * spread
    return T
