from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from regrasp_opt.errors import GraspError
from regrasp_opt.grasps import GraspSet


def make(count: int = 5) -> GraspSet:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, 3] = np.arange(count) * 0.01
    return GraspSet(T, np.linspace(0.01, 0.05, count), "parallel")


def test_subset_keeps_order_and_takes_masks() -> None:
    grasps = make()
    np.testing.assert_array_equal(grasps.subset([3, 1]).width, grasps.width[[3, 1]])
    np.testing.assert_array_equal(grasps.subset(grasps.width > 0.025).width, grasps.width[2:])
    assert len(grasps.subset([])) == 0 and len(grasps) == 5


def test_fingerprint_follows_poses_widths_and_order() -> None:
    grasps = make()
    assert grasps.fingerprint() == make().fingerprint()
    assert grasps.fingerprint() != grasps.subset([1, 0, 2, 3, 4]).fingerprint()
    assert grasps.fingerprint() != GraspSet(grasps.T_object_tcp, grasps.width + 1e-6, "parallel").fingerprint()


def test_saved_and_loaded_is_the_same(tmp_path: Path) -> None:
    path = tmp_path / "grasps.npz"
    make().save(path)
    loaded = GraspSet.load(path)
    assert loaded.fingerprint() == make().fingerprint() and loaded.kind == "parallel"
    assert [entry.name for entry in tmp_path.iterdir()] == ["grasps.npz"]


@pytest.mark.parametrize(
    "damage",
    ["missing", "empty", "garbage", "truncated", "compression", "header", "keys", "pickle", "npy", "kind", "text"],
)
def test_corrupt_files_are_refused(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "grasps.npz"
    make().save(path)
    whole, T, width = path.read_bytes(), make().T_object_tcp, make().width
    if damage == "missing":
        path.unlink()
    elif damage in ("empty", "garbage", "truncated"):
        path.write_bytes(
            {"empty": b"", "garbage": b"PK\x03\x04junk" * 9, "truncated": whole[: len(whole) // 2]}[damage]
        )
    elif damage == "compression":
        path.write_bytes(
            whole.replace(b"PK\x01\x02\x2d\x03\x2d\x00\x00\x00\x00", b"PK\x01\x02\x2d\x03\x2d\x00\x00\x00\x63")
        )
    elif damage == "header":
        with zipfile.ZipFile(path) as stored:
            members = {name: stored.read(name) for name in stored.namelist()}
        with zipfile.ZipFile(path, "w") as broken:
            for name, content in members.items():
                broken.writestr(name, content.replace(b"}", b" "))
    elif damage == "npy":
        with path.open("wb") as file:
            np.save(file, width)
    else:
        arrays: dict[str, Any] = {"T_object_tcp": T, "width": width, "kind": np.array("parallel")}
        damages: dict[str, dict[str, Any]] = {
            "keys": {"width": None},
            "pickle": {"width": np.array([{}] * 5, dtype=object)},
            "kind": {"kind": np.array("magnet")},
            "text": {"width": np.array(["a"] * 5)},
        }
        kept = {key: value for key, value in {**arrays, **damages[damage]}.items() if value is not None}
        np.savez(path, **kept)
    with pytest.raises(GraspError) as caught:
        GraspSet.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wrong", ["shape", "nan", "scaled", "mirrored", "negative"])
def test_malformed_sets_are_refused(wrong: str) -> None:
    T, width = make().T_object_tcp.copy(), make().width.copy()
    if wrong == "shape":
        width = width[:-1]
    elif wrong == "nan":
        T[0, 0, 3] = np.nan
    elif wrong == "scaled":
        T[0, :3, :3] *= 1.1
    elif wrong == "mirrored":
        T[0, 2, 2] = -1.0
    else:
        width[0] = -0.01
    with pytest.raises(GraspError):
        GraspSet(T, width, "parallel")
