"""Grasp files of our own and of other tools: read, converted to our frame, and refused with one sentence."""

from __future__ import annotations

import csv
import sys
from pathlib import Path
from typing import Any

import grasp_files
import numpy as np
import pytest
import trimesh
from grasp_files import Z_APPROACH_X_CLOSING, hand_poses, write
from transforms import random_transforms

from regrasp_opt.errors import GraspError
from regrasp_opt.grasps import GraspSet, gripper_free, hold_failures
from regrasp_opt.grasps.hand_frames import FRAMES, hand_frame

COUNT = 12
WANTED = random_transforms(np.random.default_rng(0), COUNT)
WANTED[:, :3, 3] *= 0.1
FAILED = np.arange(COUNT) % 4 == 1
PANDA, ROBOTIQ = 0.1034, 0.195


def stands_as(loaded: GraspSet, wanted: np.ndarray) -> None:
    """Assert that a set has these poses, and no widths yet."""
    np.testing.assert_allclose(loaded.T_object_tcp, wanted, atol=1e-9)
    assert not loaded.settled and np.isnan(loaded.width).all()


def test_hand_frames_put_the_tcp_ahead_and_turn_the_axes() -> None:
    for name, frame in FRAMES.items():
        T = frame.T_hand_tcp
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0) and hand_frame(str(frame)) == frame, name
        np.testing.assert_array_equal(T[:3, 3], [0.0, 0.0, frame.tcp])
    np.testing.assert_array_equal(FRAMES["tcp"].T_hand_tcp, np.eye(4))
    np.testing.assert_array_equal(FRAMES["acronym"].T_hand_tcp[:3, :3], Z_APPROACH_X_CLOSING)
    T = hand_frame("-x,z,0.05").T_hand_tcp
    np.testing.assert_array_equal(T[:3, 1:].T, [[0, 0, 1], [-1, 0, 0], [-0.05, 0, 0]])
    assert hand_frame("z,x,0.02,suction").kind == "suction"


@pytest.mark.parametrize(
    "text", ["hand", "z,z,0.1", "z,-z,0.1", "z,x", "z,x,far", "z,w,0.1", "z,x,nan", "z,x,0.1,magnet", ""]
)
def test_a_text_that_is_no_hand_frame_is_refused(text: str) -> None:
    with pytest.raises(GraspError, match="is not a hand frame; give tcp, panda_hand, acronym"):
        hand_frame(text)


def test_acronym_files_approach_along_z_and_close_along_x(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    T = hand_poses(WANTED, PANDA, Z_APPROACH_X_CLOSING)
    np.testing.assert_allclose(T[:, :3, 0], WANTED[:, :3, 1], atol=1e-12)
    grasp_files.write_acronym(tmp_path / "mug.h5", T, ~FAILED, scale=0.5)
    write(tmp_path / "mug.json", grasp_files.acronym_json(T, ~FAILED, scale=0.5))
    for name in ("mug.h5", "mug.json"):
        caplog.clear()
        loaded = GraspSet.load(tmp_path / name)
        stands_as(loaded, WANTED[~FAILED])
        assert loaded.names == tuple(str(k) for k in np.flatnonzero(~FAILED)) and loaded.kind == "parallel"
        assert loaded.source is not None and loaded.source.frame == "acronym"
        assert (loaded.source.mesh, loaded.source.mesh_scale) == ("meshes/Mug/1a.obj", 0.5)
        assert f"{FAILED.sum()} of {COUNT} grasps are left out: the file says that they failed" in caplog.text


def test_isaac_files_have_the_frame_of_the_hand_that_they_name(tmp_path: Path) -> None:
    confidence = np.linspace(0, 1, COUNT)
    content = grasp_files.isaac(
        hand_poses(WANTED, PANDA), confidence, gripper_frame="/World/panda_hand", object_frame="/m"
    )
    loaded = GraspSet.load(write(tmp_path / "mug.yaml", content))
    stands_as(loaded, WANTED[1:])  # the first has no confidence at all
    assert loaded.names == tuple(f"grasp_{k}" for k in range(1, COUNT)) and loaded.name(0) == "grasp_1"
    better = GraspSet.load(tmp_path / "mug.yaml", min_quality=0.5)
    stands_as(better, WANTED[confidence >= 0.5])
    content["gripper_frame_link"] = content.pop("gripper_frame")  # as the grasp editor writes it
    stands_as(GraspSet.load(write(tmp_path / "link.yml", content)), WANTED[1:])
    with pytest.raises(GraspError, match=r"none of the 12 grasps has a quality of 2; the best has 1"):
        GraspSet.load(tmp_path / "mug.yaml", min_quality=2.0)


def test_a_frame_that_the_file_does_not_say_has_to_be_given(tmp_path: Path) -> None:
    T = hand_poses(WANTED, ROBOTIQ, Z_APPROACH_X_CLOSING)
    unnamed = write(tmp_path / "isaac.yaml", grasp_files.isaac(T, np.ones(COUNT)))
    other = write(tmp_path / "other.yaml", grasp_files.isaac(T, np.ones(COUNT), gripper_frame="/World/tool0"))
    data = write(tmp_path / "graspgen.json", grasp_files.graspgen(T, ~FAILED))
    for path in (unnamed, other, data):
        with pytest.raises(
            GraspError, match=r"does not say which hand's frame .* give frame \(--grasp-frame\): one of tcp"
        ):
            GraspSet.load(path)
    for frame in ("robotiq_2f_140", "z,x,0.195", "z,-x,0.195"):
        flip = np.diag([-1.0, -1.0, 1.0, 1.0]) if frame == "z,-x,0.195" else np.eye(4)
        stands_as(GraspSet.load(unnamed, frame=frame), WANTED @ flip)
        stands_as(GraspSet.load(data, frame=frame), (WANTED @ flip)[~FAILED])


def test_graspgen_files_that_know_their_gripper_need_no_frame(tmp_path: Path) -> None:
    T = hand_poses(WANTED, ROBOTIQ, Z_APPROACH_X_CLOSING)
    for number, gripper in enumerate(({"name": "robotiq_2f_140"}, {"name": "mine", "depth": 0.195, "width": 0.1})):
        for suffix in ("json", "yaml"):
            path = write(tmp_path / f"{number}.{suffix}", grasp_files.graspgen(T, ~FAILED, gripper=gripper))
            stands_as(GraspSet.load(path), WANTED[~FAILED])
    cup = write(
        tmp_path / "cup.json", grasp_files.graspgen(WANTED, ~FAILED, gripper={"name": "single_suction_cup_30mm"})
    )
    assert GraspSet.load(cup).kind == "suction"


@pytest.mark.parametrize("suffix", ["npz", "csv"])
def test_our_own_files_keep_poses_widths_names_and_kind(tmp_path: Path, suffix: str) -> None:
    width = np.random.default_rng(1).uniform(0.01, 0.1, COUNT)
    names = tuple(f"grasp {k}, the {'à' * k}" for k in range(COUNT))
    for kind, widths, called in (
        ("parallel", width, names),
        ("suction", np.zeros(COUNT), ()),
        ("parallel", None, names),
    ):
        grasps = GraspSet(WANTED, widths, kind, called)  # type: ignore[arg-type]
        path = tmp_path / f"grasps.{suffix}"
        grasps.save(path)
        loaded = GraspSet.load(path)
        np.testing.assert_allclose(loaded.T_object_tcp, WANTED, atol=1e-12)
        np.testing.assert_array_equal(loaded.width, grasps.width)
        assert loaded.kind == kind and loaded.settled == (widths is not None)
        assert loaded.names == (called or (tuple(map(str, range(COUNT))) if suffix == "csv" else ()))


def test_a_csv_of_somebody_else_may_have_fewer_columns_and_another_frame(tmp_path: Path) -> None:
    T = hand_poses(WANTED, PANDA) * np.array([1, 1, 1, 1000.0])
    T[:, 3, 3] = 1.0
    GraspSet(hand_poses(WANTED, PANDA), None, "parallel").save(tmp_path / "whole.csv")
    with (tmp_path / "whole.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    with (tmp_path / "mm.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["qw", "qx", "qy", "qz", "x", "y", "z"])
        for row in rows:
            turn = [row[name] for name in ("qw", "qx", "qy", "qz")]
            writer.writerow([*turn, *(str(1000 * float(row[name])) for name in "xyz")])
    loaded = GraspSet.load(tmp_path / "mm.csv", frame="panda_hand", scale=1e-3)
    stands_as(loaded, WANTED)
    assert loaded.names == ()
    with pytest.raises(GraspError, match=r"looks like millimetres; give scale \(--grasp-scale\) 0.001"):
        GraspSet.load(tmp_path / "mm.csv")


def test_millimetres_are_found_in_any_format(tmp_path: Path) -> None:
    T = hand_poses(WANTED, PANDA, Z_APPROACH_X_CLOSING)
    T[:, :3, 3] *= 1000
    files = [write(tmp_path / "a.json", grasp_files.acronym_json(T, ~FAILED))]
    files.append(write(tmp_path / "b.yaml", grasp_files.isaac(T, np.ones(COUNT), gripper_frame="panda_hand")))
    for path in files:
        with pytest.raises(GraspError, match=r"millimetres; give scale \(--grasp-scale\) 0.001"):
            GraspSet.load(path)
        stands_as(GraspSet.load(path, frame="acronym", scale=1e-3), WANTED[~FAILED] if path == files[0] else WANTED)
    for scale in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(GraspError, match="the scale of grasps is"):
            GraspSet.load(files[0], scale=scale)


def _without(content: dict[str, Any], *keys: str) -> dict[str, Any]:
    """Return a copy of nested content without the last of `keys`."""
    inner = {key: value for key, value in content.items() if key != keys[-1] or len(keys) > 1}
    return inner if len(keys) == 1 else {**inner, keys[0]: _without(content[keys[0]], *keys[1:])}


def _broken() -> dict[str, tuple[Any, str]]:
    T = hand_poses(WANTED, PANDA)
    far, bent, left = T.copy(), T.copy(), T.copy()
    far[2, 0, 3], bent[3, 0, 0], left[1, :3, 1] = np.nan, 2.0, -left[1, :3, 1]
    one, sound = np.ones(COUNT), grasp_files.isaac(T, np.ones(COUNT), gripper_frame="panda_hand")
    long = grasp_files.isaac(T, one, gripper_frame="panda_hand")
    long["grasps"]["grasp_5"]["orientation"]["w"] = 3.0
    short = grasp_files.isaac(T, one, gripper_frame="panda_hand")
    short["grasps"]["grasp_5"]["position"] = [0.0, 0.1]
    return {
        "list.json": ([1, 2], "holds no grasps; give a file of Isaac's"),
        "other.json": ({"poses": []}, "neither 'grasps' nor 'transforms'"),
        "empty.json": (grasp_files.acronym_json(T[:0], one[:0]), "holds no grasps; sample or write at least one"),
        "empty.yaml": ({**sound, "grasps": {}}, "holds no grasps; sample or write at least one"),
        "counts.json": (grasp_files.acronym_json(T, one[:-1]), "has 12 transforms and 11 qualities"),
        "nan.json": (grasp_files.acronym_json(far, one), "the pose of grasp 2 holds NaN or infinity"),
        "bent.json": (grasp_files.acronym_json(bent, one), "the pose of grasp 3 is not a rigid transform"),
        "left.json": (grasp_files.graspgen(left, one, gripper={"depth": 0.1}), "the pose of grasp 1 is left-handed"),
        "flat.json": (
            {**grasp_files.acronym_json(T, one), "transforms": T[0].tolist()},
            "qualities; it may be cut short",
        ),
        "text.json": ({**grasp_files.acronym_json(T, one), "transforms": "none"}, "are not an array of numbers"),
        "failed.json": (grasp_files.acronym_json(T, 0 * one), "none of the 12 grasps has a quality of more than 0"),
        "long.yaml": (long, "the quaternion of grasp 5 has length 3"),
        "short.yaml": (short, "grasp 'grasp_5' has a position or an orientation of the wrong length"),
        "bare.yaml": (_without(sound, "grasps", "grasp_7", "orientation"), "grasp 'grasp_7' lacks a number"),
        "flag.yaml": ({**sound, "grasps": {"a": True}}, "grasp 'a' lacks a number"),
        "nothing.yaml": (None, "holds no grasps; give a file of Isaac's"),
    }


@pytest.mark.parametrize("name", list(_broken()))
def test_broken_files_of_other_tools_are_refused_with_one_sentence(tmp_path: Path, name: str) -> None:
    content, said = _broken()[name]
    with pytest.raises(GraspError) as caught:
        GraspSet.load(write(tmp_path / name, content))
    assert said in str(caught.value) and name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("cut.json", '{"grasps": {"trans', "not valid JSON; it may be cut short"),
        ("cut.yaml", "grasps: {a: [1, 2", "not valid YAML; it may be cut short"),
        ("tag.yaml", "grasps: !!python/object/apply:os.getcwd []", "not valid YAML"),
        ("deep.yaml", "[" * 5000, "not valid YAML"),
        ("text.h5", "not an HDF5 file", "is missing or not an HDF5 file"),
        ("a.npz", "not a zip file", "is missing or corrupt"),
        ("a.txt", "1 2 3", "has no known suffix; known: .npz, .csv, .h5"),
        ("empty.csv", "", "column 'x' is missing"),
        ("none.csv", "x,y,z,qw,qx,qy,qz\n", "holds no grasps"),
        ("twice.csv", "x,y,z,qw,qx,qy,qz,x\n0,0,0,1,0,0,0,7\n", "column 'x' is there twice; keep the one that counts"),
        ("twice.yaml", "grasps:\n  a: {position: [0, 0, 0]}\n  b: {}\n  a: {}\n", "the key 'a' twice in one place"),
        ("twice.json", '{"grasps": {"a": {}, "b": {}, "a": {}}}', "the key 'a' twice in one place"),
        ("extra.csv", "x,y,z,w,qx,qy,qz\n0,0,0,1,0,0,0\n", "column 'w' is unknown; the first line names"),
        ("short.csv", "x,y,z,qw,qx,qy,qz\n0,0,0,1,0,0\n", "row 1 has not as many values"),
        ("long.csv", "x,y,z,qw,qx,qy,qz\n0,0,0,1,0,0,0,7\n", "row 1 has not as many values"),
        ("word.csv", "x,y,z,qw,qx,qy,qz\n0,0,0,1,0,0,0\n0,0,far,1,0,0,0\n", "row 2 holds something"),
        ("unit.csv", "x,y,z,qw,qx,qy,qz\n0,0,0,2,0,0,0\n", "the quaternion of grasp 0 has length 2"),
        ("nan.csv", "x,y,z,qw,qx,qy,qz\n0,nan,0,1,0,0,0\n", "the pose of grasp 0 holds NaN"),
        ("kinds.csv", "x,y,z,qw,qx,qy,qz,kind\n0,0,0,1,0,0,0,suction\n0,0,0,1,0,0,0,\n", "kinds, parallel and suction"),
        ("kind.csv", "x,y,z,qw,qx,qy,qz,kind\n0,0,0,1,0,0,0,magnet\n", "kind 'magnet'; kinds are parallel, suction"),
        ("some.csv", "x,y,z,qw,qx,qy,qz,width\n0,0,0,1,0,0,0,0.1\n0,0,0,1,0,0,0,\n", "the width of grasp 1 is nan"),
    ],
)  # fmt: skip
def test_broken_text_is_refused_with_one_sentence(tmp_path: Path, name: str, text: str, said: str) -> None:
    if name.endswith(".h5"):
        pytest.importorskip("h5py")
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(GraspError) as caught:
        GraspSet.load(tmp_path / name)
    assert said in str(caught.value) and name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", ["npz", "csv", "h5", "json", "yaml"])
def test_a_missing_file_is_one_sentence(tmp_path: Path, suffix: str) -> None:
    if suffix == "h5":
        pytest.importorskip("h5py")
    with pytest.raises(GraspError, match=rf"none\.{suffix}"):
        GraspSet.load(tmp_path / f"none.{suffix}")


def test_hdf5_files_that_are_not_acronyms_are_refused(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    T = hand_poses(WANTED, PANDA)
    whole = {"grasps/transforms": T, "grasps/qualities/flex/object_in_gripper": np.ones(COUNT)}
    cases = [
        (dict(list(whole.items())[:1]), "lacks 'grasps/qualities/flex/object_in_gripper'"),
        ({**whole, "grasps/transforms": T[0]}, r"has shape \(4, 4\)"),
        ({**whole, "grasps/qualities/flex/object_in_gripper": np.ones(3)}, r"has shape \(12, 4, 4\)"),
        (
            {**whole, "grasps/transforms": np.zeros((0, 4, 4)), "grasps/qualities/flex/object_in_gripper": []},
            "no grasps",
        ),
        ({**whole, "grasps/transforms": np.full((12, 4, 4), b"x")}, "not an HDF5 file that can be read"),
    ]
    for content, said in cases:
        with h5py.File(tmp_path / "a.h5", "w") as file:
            for key, value in content.items():
                file[key] = value
        with pytest.raises(GraspError, match=said):
            GraspSet.load(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["grasps"] = 1.0
    with pytest.raises(GraspError, match=r"lacks 'grasps/transforms'|not an HDF5 file"):
        GraspSet.load(tmp_path / "a.h5")
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        file.create_dataset("grasps/transforms", shape=(10**9, 4, 4), chunks=True, dtype="f8")
        file.create_dataset("grasps/qualities/flex/object_in_gripper", shape=(10**9,), chunks=True, dtype="f8")
    with pytest.raises(GraspError, match="has shape"):
        GraspSet.load(tmp_path / "huge.h5")


def test_without_h5py_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(GraspError, match=r"a\.h5 needs the package h5py; install regrasp-opt\[formats\]"):
        GraspSet.load(tmp_path / "a.h5")


def test_other_suffixes_are_not_written(tmp_path: Path) -> None:
    with pytest.raises(GraspError, match=r"give \.npz or \.csv"):
        GraspSet(WANTED, None, "parallel").save(tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_names_are_as_many_as_grasps_and_stay_with_them() -> None:
    grasps = GraspSet(WANTED, np.zeros(COUNT), "parallel", tuple(map(str, range(COUNT))))
    assert grasps.subset([3, 1]).names == ("3", "1") and grasps.subset(FAILED).names == ("1", "5", "9")
    assert GraspSet(WANTED, np.zeros(COUNT), "parallel").name(3) == "3"
    with pytest.raises(GraspError, match="12 poses and 2 names"):
        GraspSet(WANTED, np.zeros(COUNT), "parallel", ("a", "b"))


def test_grasps_that_are_not_on_the_object_yet_are_not_tested_as_if_they_were() -> None:
    from regrasp_opt.end_effectors import load_end_effector
    from regrasp_opt.feasibility import FeasibilityChecker
    from regrasp_opt.objects import ObjectModel
    from regrasp_opt.scene import load_workcell

    body, tool = ObjectModel("box", trimesh.creation.box(extents=(0.05, 0.05, 0.05)), ()), load_end_effector("w")
    grasps = GraspSet(WANTED, None, "parallel")
    for test in (hold_failures, gripper_free):
        with pytest.raises(GraspError, match=r"RegraspProblem\.load\(grasps=\.\.\.\) puts them on the object"):
            test(grasps, body, tool)
    with pytest.raises(GraspError, match="widths of these grasps are not known yet"):
        FeasibilityChecker(body, load_workcell("nova2-w"), grasps)
