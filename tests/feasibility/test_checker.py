"""The exact check: consistent, equal to a plain loop, monotone, and each way of being infeasible."""

from dataclasses import replace
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from verifying import PlainCheck

from regrasp_opt.conventions import planar_transform, translation
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.grasps import GraspSet, sample_grasps
from regrasp_opt.objects import load_object
from regrasp_opt.robots import load_robot
from regrasp_opt.scene import load_workcell
from regrasp_opt.scene.workcell import Clearance

BUILT_IN = (files("regrasp_opt") / "data" / "workcells" / "nova2-w.toml").read_text("utf-8")
FOREIGN = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
UR5 = FOREIGN / "ur_description/urdf/ur5_robot.urdf"
PANDA = FOREIGN / "panda_description/urdf/panda.urdf"
SHELF = """
[[obstacles]]
type = "box"
name = "shelf"
position = [0.3, 0.45, 0.3]
size = [0.3, 0.3, 0.02]

[[obstacles]]
type = "cylinder"
name = "post"
position = [-0.2, 0.3, 0.15]
radius = 0.03
length = 0.3
"""
IN_VIEW = np.array([[-0.3, 0.15], [0.3, 0.5]])


def cell_from(tmp_path, text):
    path = tmp_path / "cell.toml"
    path.write_text(text, encoding="utf-8")
    return load_workcell(path)


def setting(kind, tmp_path):
    """Return (object, workcell, grasps) of a named setting."""
    if kind == "shelf":
        model, cell = load_object("bottle"), cell_from(tmp_path, BUILT_IN + SHELF)
    elif kind == "suction":
        model, cell = load_object("pentagon"), load_workcell("nova2-s1")
    elif kind == "ur5":
        text = BUILT_IN.replace('model = "nova2"', f'model = "{UR5}"\nhome = [1.5, -1.5, 1.0, -1.0, -1.5, 0.0]')
        model, cell = load_object("mug"), cell_from(tmp_path, text.replace("height = 0.0", "height = -0.1"))
    elif kind == "panda":
        text = BUILT_IN.replace('model = "nova2"', f'model = "{PANDA}"\nhome = [1.5, 0.0, 0.0, -1.6, 0.0, 1.6, 0.0]')
        model, cell = load_object("bottle"), cell_from(tmp_path, text)
    else:
        model, cell = load_object("bottle"), load_workcell("nova2-w")
    return model, cell, sample_grasps(model, cell.end_effector, 40, seed=1)


def draw(model, cell, count, seed, num_grasps):
    """Return random resting poses (count, 4, 4) and a grasp id (count,) for each."""
    rng = np.random.default_rng(seed)
    lift = translation(0.0, 0.0, cell.table.height)
    placements = np.array([lift @ placement.pose for placement in model.placements])
    numbers, xi = random_poses(placements, IN_VIEW, count, rng)
    return planar_transform(xi) @ placements[numbers], rng.integers(num_grasps, size=count)


def configurations(checker, T, grasp):
    return checker.configurations(T, np.array([grasp]))[0]


@pytest.fixture(scope="module")
def bottle(tmp_path_factory):
    model, cell, grasps = setting("plain", tmp_path_factory.mktemp("bottle"))
    return model, cell, grasps, FeasibilityChecker(model, cell, grasps)


def test_single_batch_any_order_and_subset_agree(bottle):
    model, cell, grasps, checker = bottle
    T, ids = draw(model, cell, 300, 0, len(grasps))
    batch = checker.feasible_pairs(T, ids)
    assert 0.05 < batch.mean() < 0.95
    np.testing.assert_array_equal([checker.feasible(T[k], ids[[k]])[0] for k in range(300)], batch)
    order = np.random.default_rng(1).permutation(300)
    np.testing.assert_array_equal(checker.feasible_pairs(T[order], ids[order]), batch[order])
    every = checker.feasible(T[0])
    assert every.shape == (len(grasps),)
    some = np.array([7, 3, 3, 31])
    np.testing.assert_array_equal(checker.feasible(T[0], some), every[some])
    assert checker.feasible(T[0], np.array([], dtype=np.int64)).shape == (0,)


def test_a_large_batch_is_checked_in_parts(bottle, monkeypatch):
    model, cell, grasps, checker = bottle
    T, ids = draw(model, cell, 100, 0, len(grasps))
    whole = checker.feasible_pairs(T, ids)
    seen = []
    flange_poses = checker.flange_poses
    monkeypatch.setattr(checker, "flange_poses", lambda T, ids: seen.append(len(ids)) or flange_poses(T, ids))
    monkeypatch.setattr("regrasp_opt.feasibility.checker.PAIRS_AT_ONCE", 7)
    np.testing.assert_array_equal(checker.feasible_pairs(T, ids), whole)
    assert max(seen) <= 7 and checker.feasible_pairs(T[:0], ids[:0]).shape == (0,)


@pytest.mark.parametrize(
    ("kind", "count"), [("plain", 2000), ("shelf", 700), ("suction", 1000), ("ur5", 250), ("panda", 150)]
)
def test_labels_equal_a_plain_loop(kind, count, tmp_path):
    model, cell, grasps = setting(kind, tmp_path)
    T, ids = draw(model, cell, count, 2, len(grasps))
    labels = FeasibilityChecker(model, cell, grasps).feasible_pairs(T, ids)
    plain = PlainCheck(model, cell, grasps)
    expected = np.array([plain.feasible(pose, grasp) for pose, grasp in zip(T, ids, strict=True)])
    assert 0.02 < expected.mean() < 0.98
    np.testing.assert_array_equal(labels, expected)


def test_of_a_redundant_arm_only_open_pairs_are_looked_at_further(tmp_path):
    model, cell, grasps = setting("panda", tmp_path)
    T, ids = draw(model, cell, 200, 5, len(grasps))
    checker, asked = FeasibilityChecker(model, cell, grasps), []

    def counted(solve):
        return lambda T: asked.append(len(T)) or solve(T)

    expected, parts = checker.feasible_pairs(T, ids), [counted(solve) for solve in cell.robot.ik.parts]
    object.__setattr__(cell.robot, "ik", SimpleNamespace(parts=parts))
    np.testing.assert_array_equal(checker.feasible_pairs(T, ids), expected)
    assert asked == sorted(asked, reverse=True)
    assert len(asked) == len(parts)
    assert asked[0] - asked[-1] >= 0.9 * expected.sum()


def test_a_suction_cup_that_just_clears_the_table_is_feasible():
    model, cell = load_object("bottle"), load_workcell("nova2-s1")
    angles = np.deg2rad(np.arange(20, 88, 4))
    T_object_tcp = np.stack([np.eye(4)] * len(angles))
    for T, tilt in zip(T_object_tcp, angles, strict=True):
        T[:3, 2] = 0.0, np.sin(tilt), -np.cos(tilt)
        T[:3, 0] = np.cos(np.pi / 4), np.sin(np.pi / 4) * np.cos(tilt), np.sin(np.pi / 4) * np.sin(tilt)
        T[:3, 1] = np.cross(T[:3, 2], T[:3, 0])
        T[:3, 3] = 0.0, -0.03, 0.0
    grasps = GraspSet(T_object_tcp, np.zeros(len(angles)), "suction")
    checker, plain = FeasibilityChecker(model, cell, grasps), PlainCheck(model, cell, grasps)
    heights = np.linspace(0.008, 0.03, 12)
    poses = np.array([translation(0.0, 0.35, z) for z in heights])
    expected = [[plain.feasible(T, g) for g in range(len(grasps))] for T in poses]
    assert 0.1 < np.mean(expected) < 0.9
    np.testing.assert_array_equal([checker.feasible(T) for T in poses], expected)


def test_more_clearance_never_adds_a_feasible_pair(bottle):
    model, cell, grasps, _ = bottle
    T, ids = draw(model, cell, 400, 3, len(grasps))
    margins = (0.0, 0.005, 0.015, 0.03)
    labels = []
    for margin in margins:
        wide = replace(cell, clearance=Clearance(margin, margin, margin / 10))
        labels.append(FeasibilityChecker(model, wide, grasps).feasible_pairs(T, ids))
    for less, more in zip(labels[1:], labels[:-1], strict=True):
        assert not (less & ~more).any()
    assert labels[0].sum() > labels[-1].sum() > 0


def test_configurations_are_exactly_the_free_branches(bottle):
    model, cell, grasps, checker = bottle
    plain = PlainCheck(model, cell, grasps)
    T, ids = draw(model, cell, 60, 4, len(grasps))
    labels = checker.feasible_pairs(T, ids)
    for pose, grasp, label in zip(T, ids.tolist(), labels, strict=True):
        found = configurations(checker, pose, grasp)
        assert found.shape == (len(found), 6)
        assert (len(found) > 0) == label
        every = cell.robot.solve_ik(pose @ grasps.T_object_tcp[grasp] @ cell.end_effector.T_tcp_flange).q
        free = [q for q in every if plain.free(q, pose, grasp)]
        assert len(free) == len(found)
        for q in found:
            assert cell.robot.within_limits(q)
            clearance = checker.clearance(pose, grasp, q)
            assert clearance >= min(cell.clearance.gripper, cell.clearance.arm)
            assert clearance == pytest.approx(plain.clearance(q, pose, grasp)[0], abs=1e-5)


def test_clearance_does_not_depend_on_what_was_asked_before(bottle):
    model, cell, grasps, checker = bottle
    T, ids = draw(model, cell, 60, 4, len(grasps))
    asked = [
        (pose, grasp, q)
        for pose, grasp in zip(T, ids.tolist(), strict=True)
        for q in configurations(checker, pose, grasp)
    ]
    forward = [checker.clearance(*one) for one in asked]
    backward = [checker.clearance(*one) for one in asked[::-1]][::-1]
    assert forward == backward


# ---- each way of being infeasible, built on one pair that is feasible


@pytest.fixture(scope="module")
def graspable(bottle):
    """Return an upright bottle and a feasible grasp of its middle."""
    _, _, grasps, checker = bottle
    T = translation(0.0, 0.35, 0.0)
    feasible = np.flatnonzero(checker.feasible(T))
    assert len(feasible)
    height = grasps.T_object_tcp[feasible, 2, 3]
    return T, int(feasible[np.argmax(height)])


def is_feasible(bottle, T, grasp, cell=None, grasps=None):
    model, built_in, own, _ = bottle
    checker = FeasibilityChecker(model, cell or built_in, own if grasps is None else grasps)
    result = bool(checker.feasible(T, np.array([grasp]))[0])
    assert result == (len(configurations(checker, T, grasp)) > 0)
    return result


def test_rejected_because_the_gripper_is_in_the_table(bottle, graspable):
    T, grasp = graspable
    assert is_feasible(bottle, T, grasp)
    _, cell, grasps, _ = bottle
    there = translation(*cell.table.center, grasps.T_object_tcp[grasp, 2, 3])
    raised = replace(cell, supports=(replace(cell.table, T_world_support=there),))
    assert not is_feasible(bottle, T, grasp, raised)


def test_rejected_because_it_is_out_of_reach(bottle, graspable):
    _, grasp = graspable
    far = translation(0.0, 1.5, 0.0)
    assert not is_feasible(bottle, far, grasp)
    assert len(bottle[3].branches(far[None], np.array([grasp])).q) == 0


def test_rejected_because_an_obstacle_is_in_the_way(bottle, graspable):
    T, grasp = graspable
    _, cell, grasps, checker = bottle
    at_palm = T @ grasps.T_object_tcp[grasp] @ cell.end_effector.T_tcp_flange
    crate = Box("crate", np.array([0.05, 0.05, 0.05]), at_palm)
    assert len(checker.branches(T[None], np.array([grasp])).q) > 0
    assert not is_feasible(bottle, T, grasp, replace(cell, obstacles=(crate,)))
    apart = Box("crate", np.array([0.05, 0.05, 0.05]), translation(0.6, 0.8, 0.1))
    assert is_feasible(bottle, T, grasp, replace(cell, obstacles=(apart,)))


def test_rejected_because_the_object_overlaps_an_obstacle(bottle, graspable):
    T, grasp = graspable
    low = Box("pebble", np.array([0.02, 0.02, 0.004]), T @ translation(0.025, 0.0, 0.002))
    assert not FeasibilityChecker(bottle[0], replace(bottle[1], obstacles=(low,)), bottle[2]).feasible(T).any()
    beside = Box("pebble", np.array([0.02, 0.02, 0.004]), T @ translation(0.045, 0.0, 0.002))
    assert is_feasible(bottle, T, grasp, replace(bottle[1], obstacles=(beside,)))


def test_rejected_because_the_object_is_in_the_way_of_the_arm(bottle, graspable):
    T, grasp = graspable
    model, cell, grasps, _ = bottle
    wide = replace(model, mesh=model.mesh.copy())
    wide.mesh.vertices = wide.mesh.vertices * np.array([12.0, 12.0, 3.0])
    checker = FeasibilityChecker(wide, cell, grasps)
    assert not checker.feasible(T, np.array([grasp]))[0]
    plain = PlainCheck(wide, cell, grasps)
    branches = checker.branches(T[None], np.array([grasp])).q
    assert len(branches)
    said = [plain.collisions(q, T, grasp) for q in branches]
    assert all(said) and any(all("object" in text for text in texts) for texts in said)


def test_rejected_because_of_joint_limits(bottle, graspable, tmp_path):
    T, grasp = graspable
    path = Path(load_robot("nova2").urdf_path)
    text = path.read_text("utf-8")
    assert text.count('lower="-2.618" upper="2.618"') == 2
    stiff = tmp_path / "stiff.urdf"
    stiff.write_text(text.replace('lower="-2.618" upper="2.618"', 'lower="-0.05" upper="0.05"'), encoding="utf-8")
    cell = replace(bottle[1], arm=replace(bottle[1].arm, robot=load_robot(stiff, tip="flange")))
    assert len(bottle[3].branches(T[None], np.array([grasp])).q) > 0
    assert not is_feasible(bottle, T, grasp, cell)
    checker = FeasibilityChecker(bottle[0], cell, bottle[2])
    assert len(checker.branches(T[None], np.array([grasp])).q) == 0
