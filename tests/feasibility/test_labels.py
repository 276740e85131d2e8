"""Labelled data: resumable, repeatable, the same whatever the number of workers, and an end where there is no hope."""

import os
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.feasibility import FeasibilityChecker, dataset
from regrasp_opt.feasibility.dataset import LabellingTask, label_pairs, label_poses
from regrasp_opt.files import machine_memory
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.objects import load_object
from regrasp_opt.scene import WorkspaceBounds, load_workcell

WANTED = 800


@pytest.fixture(scope="module")
def task():
    model, cell = load_object("mug"), load_workcell("nova2-w")
    grasps = sample_grasps(model, cell.end_effector, 30, seed=1)
    return LabellingTask(model, cell, grasps, np.array([p.pose for p in model.placements]), seed=5)


@pytest.fixture(scope="module")
def labelled(task, tmp_path_factory):
    folder = tmp_path_factory.mktemp("labels")
    return folder, label_pairs(task, WANTED, folder=folder, jobs=1)


def assert_same(a, b):
    for name in ("T", "grasp_ids", "feasible"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_pairs_are_labelled_as_the_checker_says(task, labelled):
    _, pairs = labelled
    assert pairs.feasible.sum() >= WANTED
    assert len(pairs) == len(pairs.T) == len(pairs.grasp_ids)
    some = np.random.default_rng(0).integers(len(pairs), size=300)
    checker = FeasibilityChecker(task.model, task.workcell, task.grasps)
    np.testing.assert_array_equal(checker.feasible_pairs(pairs.T[some], pairs.grasp_ids[some]), pairs.feasible[some])


def test_poses_rest_on_the_table_inside_the_workspace(task, labelled):
    _, pairs = labelled
    low, high = task.workcell.bounds.array
    lowest = (pairs.T[::97, 2, :3] @ task.model.vertices.T + pairs.T[::97, 2, 3:]).min(axis=1)
    np.testing.assert_allclose(lowest, 0.0, atol=1e-9)
    relative = pairs.T[:, None, :3, :3] @ np.swapaxes(task.placements[None, :, :3, :3], -1, -2)
    turned_about_z = np.isclose(relative[..., 2, 2], 1.0)
    assert turned_about_z.any(axis=1).all()
    assert (pairs.T[:, :2, 3].min(axis=0) > low - 0.1).all() and (pairs.T[:, :2, 3].max(axis=0) < high + 0.1).all()


def test_it_goes_on_where_it_stopped(task, labelled, tmp_path):
    folder, pairs = labelled
    blocks = sorted(folder.iterdir())
    assert len(blocks) >= 2
    half = tmp_path / "half"
    half.mkdir()
    for block in blocks[1:]:
        (half / block.name).write_bytes(block.read_bytes())
    assert_same(label_pairs(task, WANTED, folder=half, jobs=1), pairs)
    assert {path.name for path in half.iterdir()} == {path.name for path in blocks}


def test_stored_blocks_are_used(task, labelled, tmp_path):
    folder, pairs = labelled
    block = min(folder.iterdir())
    changed = tmp_path / block.name
    with np.load(block) as stored:
        arrays = dict(stored)
    arrays["feasible"] = np.ones_like(arrays["feasible"])
    np.savez(changed, **arrays)
    again = label_pairs(task, 10, folder=tmp_path, jobs=1)
    assert again.feasible[: arrays["feasible"].size].all()
    assert not pairs.feasible[: arrays["feasible"].size].all()


@pytest.mark.parametrize("damage", ["empty", "cut", "garbage", "other arrays", "wrong shape"])
def test_broken_blocks_are_made_again(task, labelled, tmp_path, damage):
    folder, pairs = labelled
    block = min(folder.iterdir())
    target = tmp_path / block.name
    whole = block.read_bytes()
    if damage == "other arrays":
        np.savez(target, something=np.zeros(3))
    elif damage == "wrong shape":
        np.savez(target, T=np.zeros((2, 4, 4)), grasp_ids=np.zeros((2, 5), int), feasible=np.ones((2, 5), bool))
    else:
        target.write_bytes({"empty": b"", "cut": whole[: len(whole) // 2], "garbage": b"no archive" * 50}[damage])
    again = label_pairs(task, 10, folder=tmp_path, jobs=1)
    count = min(len(again), len(pairs))
    np.testing.assert_array_equal(again.feasible[:count], pairs.feasible[:count])
    assert target.read_bytes() != b""


def test_one_and_two_workers_give_the_same(task, labelled, tmp_path):
    _, pairs = labelled
    assert_same(label_pairs(task, WANTED, folder=tmp_path, jobs=2), pairs)
    one, two = label_poses(task, 9, jobs=1), label_poses(task, 9, jobs=2)
    np.testing.assert_array_equal(one.T, two.T)
    np.testing.assert_array_equal(one.feasible, two.feasible)
    assert one.feasible.shape == (9, len(task.grasps))


def test_no_pose_is_drawn_twice_however_many_blocks_it_takes(task, tmp_path, monkeypatch):
    monkeypatch.setattr(dataset, "POSES_PER_BLOCK", 8)
    pairs = label_pairs(task, 700, folder=tmp_path, jobs=1)
    blocks = len(pairs) // (8 * dataset.GRASPS_PER_POSE)
    assert blocks >= 5
    assert len(np.unique(pairs.T.reshape(-1, 16), axis=0)) == 8 * blocks


@pytest.mark.parametrize("count", [1, 3, 10])
def test_a_few_poses_are_labelled_for_every_grasp(task, count):
    labelled = label_poses(task, count, jobs=1)
    checker = FeasibilityChecker(task.model, task.workcell, task.grasps)
    assert labelled.feasible.dtype == bool
    np.testing.assert_array_equal(labelled.feasible, [checker.feasible(T) for T in labelled.T])


def test_progress_ends_at_what_was_wanted(task, tmp_path):
    seen = []
    label_pairs(task, 50, folder=tmp_path, jobs=1, progress=lambda done, of: seen.append((done, of)))
    assert seen[-1] == (50, 50)
    assert seen == sorted(seen)


def test_a_workspace_out_of_reach_ends_in_an_error(task, tmp_path):
    table = replace(task.workcell.table, size=np.array([20.0, 20.0]))
    cell = replace(task.workcell, supports=(replace(table, workspace=WorkspaceBounds((5.0, 6.0), (5.0, 6.0))),))
    with pytest.raises(GraspError, match=r"anywhere in the workspace; of \d+ tried \d+ out of reach; move") as info:
        label_pairs(replace(task, workcell=cell), 50, folder=tmp_path, jobs=1)
    assert "\n" not in str(info.value)


def test_more_pairs_than_memory_are_refused_before_and_while_they_are_drawn(task, tmp_path, monkeypatch):
    with pytest.raises(OptionError, match=r"1000000000000 samples need about .* ask for fewer samples"):
        label_pairs(task, 10**12, folder=tmp_path, jobs=1)
    assert not list(tmp_path.iterdir())
    monkeypatch.setattr(dataset, "machine_memory", lambda: 8.0 * 2**30)
    with pytest.raises(OptionError, match=r"need about 23.3 GB of memory, and this machine has 8 GB"):
        label_pairs(task, 10**7, folder=tmp_path, jobs=1)
    monkeypatch.setattr(dataset, "machine_memory", lambda: 20_000.0 * dataset.BYTES_PER_PAIR)
    assert len(label_pairs(task, 50, folder=tmp_path, jobs=1)) == 5000
    with pytest.raises(OptionError, match="samples need about"):  # about one pair in three is feasible
        label_pairs(task, 19_000, folder=tmp_path, jobs=1)


def test_the_memory_of_the_machine_is_known_or_without_end(monkeypatch):
    assert 1e8 < machine_memory() < 1e14
    monkeypatch.delattr(os, "sysconf")
    assert machine_memory() == float("inf")


def test_the_fingerprint_follows_everything_that_labels_depend_on(task):
    same = LabellingTask(load_object("mug"), load_workcell("nova2-w"), task.grasps, task.placements, task.seed)
    assert same.fingerprint() == task.fingerprint()
    others = [
        replace(task, seed=6),
        replace(task, model=load_object("bottle")),
        replace(task, grasps=task.grasps.subset(np.arange(29))),
        replace(task, placements=task.placements[:-1]),
        replace(task, workcell=load_workcell("nova2-r85")),
        replace(task, workcell=task.workcell.within(WorkspaceBounds((-0.4, 0.4), (0.1, 0.6)))),
    ]
    prints = {task.fingerprint(), *(other.fingerprint() for other in others)}
    assert len(prints) == len(others) + 1
