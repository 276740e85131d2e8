"""Frames, units and the few rigid-transform helpers that every layer shares.

SI units, radians. A transform ``T_a_b`` is a (4, 4) float64 matrix that maps coordinates in frame b into frame a.
The grasp frame has its origin at the TCP, z along the approach and y along the closing direction.
Planar parameters ``xi = (x, y, theta)`` act on the left of a stable placement (Eq. 6 of the paper).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from regrasp_opt.errors import OptionError, PoseError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

FK_POSITION_TOLERANCE = 1e-6
"""Largest distance between a flange pose asked for and the one forward kinematics gives [m]."""

FK_ROTATION_TOLERANCE = 1e-6
"""Largest angle between a flange pose asked for and the one forward kinematics gives [rad]."""

JOINT_LIMIT_TOLERANCE = 1e-9
"""How far a joint may stand beyond its limit through rounding [rad]."""

CLEARANCE_TOLERANCE = 1e-4
"""How far a recomputed distance may fall short of the clearance that a plan claims [m]."""

PLACEMENT_TOLERANCE = 1e-6
"""How far an intermediate pose may be from its stable placement and planar parameters [m, rad]."""

RESTING_TOLERANCE = 1e-3
"""How far an object's lowest point may be from the table top, and what else touches the table [m]."""

RIGID_TOLERANCE = 1e-4
"""How far ``R.T @ R`` of a given pose may be from the identity before it is rejected; below, it is orthonormalised."""

QUATERNION_TOLERANCE = 1e-2
"""How far the length of a given quaternion may be from 1 before it is rejected; below, it is normalised."""


def orthonormalise(T: ArrayLike) -> FloatArray:
    """Return the rigid transforms nearest to `T` (..., 4, 4) (polar decomposition of the rotation part)."""
    out = np.array(T, dtype=np.float64)
    u, _, vt = np.linalg.svd(out[..., :3, :3])
    out[..., :3, :3] = u @ vt
    out[..., 3, :] = (0.0, 0.0, 0.0, 1.0)
    return out


def as_pose(T: Any, name: str = "pose") -> FloatArray:
    """Return `T` as a rigid (4, 4) float64 transform.

    Parameters
    ----------
    T : (4, 4) array_like or dict
        A matrix, or a dict with ``position`` (3,) [m] and a unit quaternion (4,), which is called
        ``quaternion_xyzw`` or ``quaternion_wxyz`` after the order of its numbers.

    Raises
    ------
    PoseError
        If `T` is none of these, not finite, not rigid or left-handed; `name` says which pose it was.
    """
    if isinstance(T, Mapping):
        T = _from_quaternion(T, name)
    try:
        matrix = np.array(T, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise PoseError(f"the {name} is not a numeric 4x4 matrix; give four rows of four numbers") from error
    if matrix.shape != (4, 4):
        raise PoseError(f"the {name} has shape {matrix.shape}; give a 4x4 matrix T_world_object")
    if not np.isfinite(matrix).all():
        raise PoseError(f"the {name} holds NaN or infinity; give finite numbers")
    rotation = matrix[:3, :3]
    if (
        not np.allclose(matrix[3], (0, 0, 0, 1), atol=1e-9)
        or np.abs(rotation).max() > 1 + RIGID_TOLERANCE
        or np.abs(rotation.T @ rotation - np.eye(3)).max() > RIGID_TOLERANCE
    ):
        raise PoseError(f"the {name} is not a rigid transform; give an orthonormal rotation and last row 0 0 0 1")
    if np.linalg.det(rotation) < 0:
        raise PoseError(f"the {name} is left-handed (a mirror image); give a rotation with determinant +1")
    return orthonormalise(matrix)


def _from_quaternion(pose: Mapping[str, Any], name: str) -> FloatArray:
    """Return the pose (4, 4) of a position and a quaternion."""
    orders = {"quaternion_xyzw": (0, 1, 2, 3), "quaternion_wxyz": (1, 2, 3, 0)}
    order = next((orders[key] for key in pose if key in orders), None)
    if order is None or len(pose) != 2 or "position" not in pose:
        raise PoseError(
            f"the {name} has the keys {', '.join(map(str, pose)) or 'none'}; give 'position' and 'quaternion_xyzw' or "
            "'quaternion_wxyz'"
        )
    try:
        position, quaternion = (np.array(value, dtype=np.float64) for key, value in sorted(pose.items()))
    except (TypeError, ValueError, OverflowError) as error:
        raise PoseError(f"the {name} holds something that is not a number") from error
    if position.shape != (3,) or quaternion.shape != (4,):
        raise PoseError(f"the {name} needs 3 numbers as its position [m] and 4 as its quaternion")
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1) <= QUATERNION_TOLERANCE:
        raise PoseError(f"the {name} has a quaternion of length {norm:.4g}; give a unit quaternion")
    x, y, z, w = quaternion[list(order)] / norm
    T = np.eye(4)
    T[:3, :3] = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    T[:3, 3] = position
    return T


def as_seed(seed: Any) -> int:
    """Return `seed` if it is a whole number from 0 to 2**63 - 1.

    Raises
    ------
    OptionError
        If it is not.
    """
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or not 0 <= seed < 2**63:
        raise OptionError(f"seed is {seed}; give a whole number from 0 to 2**63 - 1")
    return int(seed)


def invert(T: ArrayLike) -> FloatArray:
    """Invert rigid transforms (..., 4, 4)."""
    T = np.asarray(T, dtype=np.float64)
    out = np.zeros_like(T)
    rotation = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = rotation
    out[..., :3, 3] = -(rotation @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def planar_transform(xi: ArrayLike) -> FloatArray:
    """Return ``dT(xi)`` (..., 4, 4) of planar parameters (..., 3) in [m, m, rad] (Eq. 6)."""
    xi = np.asarray(xi, dtype=np.float64)
    c, s = np.cos(xi[..., 2]), np.sin(xi[..., 2])
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., 0, 0], out[..., 0, 1], out[..., 1, 0], out[..., 1, 1] = c, -s, s, c
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    out[..., :2, 3] = xi[..., :2]
    return out


def rotation_angle(R: ArrayLike) -> FloatArray:
    """Return the angle in [0, pi] of rotations (..., 3, 3) [rad], accurate near 0 and pi."""
    R = np.asarray(R, dtype=np.float64)
    skew = np.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1)
    return np.arctan2(np.linalg.norm(skew, axis=-1), np.trace(R, axis1=-2, axis2=-1) - 1.0)


def pose_distance(T_a: ArrayLike, T_b: ArrayLike) -> tuple[FloatArray, FloatArray]:
    """Return the distance [m] and the angle [rad] between transforms (..., 4, 4)."""
    T_a, T_b = np.asarray(T_a, dtype=np.float64), np.asarray(T_b, dtype=np.float64)
    relative = np.swapaxes(T_a[..., :3, :3], -1, -2) @ T_b[..., :3, :3]
    return np.linalg.norm(T_a[..., :3, 3] - T_b[..., :3, 3], axis=-1), rotation_angle(relative)


def translation(x: float, y: float, z: float) -> FloatArray:
    """Return the pure translation (4, 4) by (x, y, z) [m]."""
    T = np.eye(4)
    T[:3, 3] = (x, y, z)
    return T


def rpy_angles(R: ArrayLike) -> FloatArray:
    """Return URDF's roll, pitch and yaw (3,) [rad] of a rotation (3, 3), at pitches of +-pi/2 with some yaw."""
    R = np.asarray(R, dtype=np.float64)
    yaw = np.arctan2(R[1, 0], R[0, 0])
    c, s = np.cos(yaw), np.sin(yaw)
    pitch = np.arctan2(-R[2, 0], c * R[0, 0] + s * R[1, 0])
    return np.array([np.arctan2(s * R[0, 2] - c * R[1, 2], c * R[1, 1] - s * R[0, 1]), pitch, yaw])


def rotation_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """Return the rotation (3, 3) of URDF roll-pitch-yaw angles [rad]: ``Rz(yaw) @ Ry(pitch) @ Rx(roll)``."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
