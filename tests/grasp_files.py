"""Grasp files as other tools write them, made after their documentation; poses are of a hand in the object frame."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

Z_APPROACH_X_CLOSING = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Our axes in a frame that approaches along z and closes along x: our y is its x, our x its -y."""


def hand_poses(T_object_tcp: np.ndarray, tcp: float, turn: np.ndarray | None = None) -> np.ndarray:
    """Return where a hand is (N, 4, 4) whose TCP is `tcp` [m] ahead along its z; `turn` has our axes in its frame."""
    T = T_object_tcp.copy()
    T[:, :3, 3] -= tcp * T[:, :3, 2]
    if turn is not None:
        T[:, :3, :3] = T[:, :3, :3] @ turn.T
    return T


def write_acronym(
    path: Path, T: np.ndarray, success: Sequence[int] | np.ndarray, scale: float = 1.0, mesh: str = "meshes/Mug/1a.obj"
) -> None:
    """Write ACRONYM's HDF5: the groups grasps, gripper and object."""
    h5py = pytest.importorskip("h5py")
    with h5py.File(path, "w") as file:
        file["grasps/transforms"] = T
        for name in ("object_in_gripper", "object_motion_during_shaking_linear"):
            file[f"grasps/qualities/flex/{name}"] = np.asarray(success)
        file["gripper/type"] = "panda"
        file["object/file"] = mesh
        file["object/scale"] = scale


def acronym_json(T: np.ndarray, success: Sequence[int] | np.ndarray, scale: float = 1.0) -> dict[str, Any]:
    """Return the content of ACRONYM's older JSON files."""
    return {
        "object": "meshes/Mug/1a.obj",
        "object_scale": scale,
        "transforms": T.tolist(),
        "quality_flex_object_in_gripper": np.asarray(success).tolist(),
    }


def graspgen(T: np.ndarray, success: Sequence[bool] | np.ndarray, scale: float = 1.0, **more: Any) -> dict[str, Any]:
    """Return the content of a file of GraspGen's data set."""
    return {
        "object": {"file": "objects/mug.obj", "scale": scale},
        "grasps": {"transforms": T.tolist(), "object_in_gripper": np.asarray(success, dtype=bool).tolist()},
        **more,
    }


def isaac(T: np.ndarray, confidence: Sequence[float] | np.ndarray, **more: Any) -> dict[str, Any]:
    """Return the content of an isaac_grasp file, with the joints of Franka's hand."""
    quaternions = Rotation.from_matrix(T[:, :3, :3]).as_quat()
    return {
        "format": "isaac_grasp",
        "format_version": 1.0,
        **more,
        "grasps": {
            f"grasp_{k}": {
                "confidence": float(confidence[k]),
                "position": T[k, :3, 3].tolist(),
                "orientation": {"w": float(quaternions[k, 3]), "xyz": quaternions[k, :3].tolist()},
                "cspace_position": {"panda_finger_joint1": 0.01},
                "pregrasp_cspace_position": {"panda_finger_joint1": 0.04},
            }
            for k in range(len(T))
        },
    }


def write(path: Path, content: Any) -> Path:
    """Write JSON or YAML, by the suffix of `path`."""
    text = json.dumps(content) if path.suffix == ".json" else yaml.safe_dump(content, sort_keys=False)
    path.write_text(text, encoding="utf-8")
    return path
