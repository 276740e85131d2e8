from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda T, w: (T, w[:-1]), r"poses \(5, 4, 4\) and widths \(4,\)"),
        (lambda T, w: (changed(T, (2, 0, 3), np.nan), w), "the pose of grasp 2 holds NaN or infinity"),
        (lambda T, w: (changed(T, (1, 0, 0), np.inf), w), "the pose of grasp 1 holds NaN or infinity"),
        (lambda T, w: (changed(T, (4, 0, 0), 1e300), w), "the pose of grasp 4 is not a rigid transform"),
        (lambda T, w: (changed(T, (4, 1, 3), -101.0), w), "the pose of grasp 4 is 101 m from the object; give metres"),
        (lambda T, w: (T, changed(w, 2, 101.0)), "the width of grasp 2 is 101; give metres"),
        (lambda T, w: (T, changed(w.astype(np.longdouble), 0, np.longdouble("1e400"))), "the width of grasp 0 is inf"),
        (lambda T, w: (changed(T, (3, 0, 0), 1.1), w), "the pose of grasp 3 is not a rigid transform"),
        (lambda T, w: (changed(T, (3, 3, 0), 0.5), w), "the pose of grasp 3 is not a rigid transform"),
        (lambda T, w: (changed(T, (0, 2, 2), -1.0), w), "the pose of grasp 0 is left-handed"),
        (lambda T, w: (T, changed(w, 3, -0.01)), "the width of grasp 3 is -0.01"),
        (lambda T, w: (T, changed(w, 1, np.nan)), "the width of grasp 1 is nan"),
        (lambda T, w: (T, ["a"] * 5), "the widths of a grasp set are not an array of numbers"),
        (lambda T, w: ([T[0], T[1, :3]], w), "the poses of a grasp set are not an array of numbers"),
        (lambda T, w: (None, w), "the poses of a grasp set are not an array of numbers"),
        (lambda T, w: (T, w.astype(bool)), "the widths of a grasp set are not an array of numbers"),
    ],
)
def test_malformed_sets_are_refused(change: Callable[..., Any], text: str) -> None:
    with pytest.raises(GraspError, match=text):
        GraspSet(*change(make().T_object_tcp, make().width), "parallel")  # type: ignore[call-arg]


def test_unknown_kinds_are_refused() -> None:
    with pytest.raises(GraspError, match="kind 'magnet'; kinds are parallel, suction"):
        GraspSet(make().T_object_tcp, make().width, "magnet")  # type: ignore[arg-type]


def changed(array: np.ndarray, index: Any, value: Any) -> np.ndarray:
    array = array.copy()
    array[index] = value
    return array


def test_lists_and_single_precision_are_converted() -> None:
    grasps = make()
    for T, width in (
        (grasps.T_object_tcp.tolist(), grasps.width.tolist()),
        (list(grasps.T_object_tcp), tuple(grasps.width)),
        (grasps.T_object_tcp.astype(np.float32), grasps.width.astype(np.float32)),
    ):
        taken = GraspSet(T, width, "parallel")
        assert taken.T_object_tcp.dtype == taken.width.dtype == np.float64
        np.testing.assert_allclose(taken.T_object_tcp, grasps.T_object_tcp, atol=1e-8)
        np.testing.assert_allclose(taken.width, grasps.width, atol=1e-8)
    assert len(GraspSet([], [], "suction")) == 0


def test_rotations_that_are_off_by_rounding_are_made_orthonormal() -> None:
    T = np.tile(np.eye(4), (3, 1, 1))
    T[:, :3, :3] = Rotation.random(3, random_state=1).as_matrix()
    rough = T.copy()
    rough[1, :3, :3] *= 1 + 4e-5
    taken = GraspSet(rough, np.zeros(3), "parallel")
    np.testing.assert_array_equal(taken.T_object_tcp[[0, 2]], T[[0, 2]])
    np.testing.assert_allclose(taken.T_object_tcp[1], T[1], atol=1e-12)
    rough[1, :3, :3] = T[1, :3, :3] * (1 + 6e-5)
    with pytest.raises(GraspError, match="the pose of grasp 1 is not a rigid transform"):
        GraspSet(rough, np.zeros(3), "parallel")


@pytest.mark.parametrize("key", ["T_object_tcp", "width", "kind"])
def test_a_missing_array_is_named(tmp_path: Path, key: str) -> None:
    arrays = {"T_object_tcp": make().T_object_tcp, "width": make().width, "kind": np.array("parallel")}
    np.savez(tmp_path / "grasps.npz", **{name: value for name, value in arrays.items() if name != key})  # type: ignore[arg-type]
    with pytest.raises(GraspError, match=f"lacks the array '{key}'"):
        GraspSet.load(tmp_path / "grasps.npz")


def test_a_bad_set_in_a_file_names_the_file(tmp_path: Path) -> None:
    width = make().width
    width[2] = np.nan
    np.savez(tmp_path / "grasps.npz", T_object_tcp=make().T_object_tcp, width=width, kind=np.array("parallel"))
    with pytest.raises(GraspError, match=r"grasps\.npz: the width of grasp 2 is nan"):
        GraspSet.load(tmp_path / "grasps.npz")
