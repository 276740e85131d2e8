"""The check against table and base wherever they are: narrow tables, moved workcells, any arm configuration."""

from dataclasses import replace

import numpy as np
import pytest
from verifying import PlainCheck

from regrasp_opt.conventions import planar_transform, translation
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.grasps import sample_grasps
from regrasp_opt.objects import load_object
from regrasp_opt.scene import Support, load_workcell

FAR = translation(5.0, 5.0, 0.5)


@pytest.fixture(scope="module")
def bottle():
    """Return object, workcell and grasps."""
    model, cell = load_object("bottle"), load_workcell("nova2-w")
    return model, cell, sample_grasps(model, cell.end_effector, 40, seed=1)


def resting_poses(model, bounds, count, seed):
    rng = np.random.default_rng(seed)
    placements = np.array([placement.pose for placement in model.placements])
    xi = np.column_stack([rng.uniform(*bounds, (count, 2)), rng.uniform(-np.pi, np.pi, count)])
    return planar_transform(xi) @ placements[rng.integers(len(placements), size=count)]


def configurations_near_the_table(robot, grasps):
    """Return arm configurations (M, dof) whose flange points down or aslant, just above or in the table."""
    rng = np.random.default_rng(4)
    T = np.array([translation(x, y, z) for x, y, z in rng.uniform([-0.3, 0.2, 0.0], [0.3, 0.45, 0.3], (300, 3))])
    T[:, :3, :3] = grasps.T_object_tcp[rng.integers(len(grasps), size=len(T)), :3, :3]
    found = robot.solve_ik(T)
    return found.q[rng.permutation(len(found.q))[:250]]


@pytest.mark.parametrize("size", [(1.4, 1.2), (0.3, 0.02)], ids=["wide table", "rail"])
def test_arm_and_gripper_keep_clear_of_the_table_at_any_configuration(bottle, size):
    model, cell, grasps = bottle
    cell = replace(cell, supports=(Support.table(0.02, np.array([0.0, 0.32]), np.array(size), 0.05),))
    checker, plain = FeasibilityChecker(model, cell, grasps), PlainCheck(model, cell, grasps)
    by_gripper = 0
    for number, q in enumerate(configurations_near_the_table(cell.robot, grasps)):
        grasp = number % len(grasps)
        assert checker.is_free(FAR, grasp, q) == plain.free(q, FAR, grasp)
        clearance, nearest = plain.clearance(q, FAR, grasp)
        if clearance > 0:  # how deep an overlap is depends on the method
            assert checker.clearance(FAR, grasp, q) == pytest.approx(clearance, abs=1e-5)
        else:
            assert checker.clearance(FAR, grasp, q) <= 0
        by_gripper += bool(nearest & {"palm", "finger"})
    assert by_gripper > 20


def test_labels_above_a_rail_that_passes_between_the_corners_of_a_finger_equal_a_plain_loop(bottle):
    model, cell, grasps = bottle
    cell = replace(cell, supports=(Support.table(0.0, np.array([0.0, 0.35]), np.array([0.6, 0.004]), 0.02),))
    poses = translation(0.0, 0.0, 0.002) @ resting_poses(model, [[-0.2, 0.3], [0.2, 0.4]], 15, 6)
    checker, plain = FeasibilityChecker(model, cell, grasps), PlainCheck(model, cell, grasps)
    expected = np.array([[plain.feasible(T, grasp) for grasp in range(len(grasps))] for T in poses])
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal([checker.feasible(T) for T in poses], expected)


def test_a_workcell_moved_and_turned_as_a_whole_has_the_same_labels(bottle):
    model, cell, grasps = bottle
    post = Box("post", np.array([0.06, 0.04, 0.4]), translation(0.1, 0.25, 0.2))
    cell = replace(cell, obstacles=(post,))
    move = translation(0.9, -0.7, 0.15) @ planar_transform([0.0, 0.0, np.pi / 2])
    center = move @ np.array([*cell.table.center, cell.table.height, 1.0])
    moved = replace(
        cell,
        arm=replace(cell.arm, T_world_base=move @ cell.T_world_base),
        supports=(Support.table(float(center[2]), center[:2], cell.table.size[::-1].copy(), cell.table.thickness),),
        obstacles=(replace(post, pose=move @ post.pose),),
    )
    poses = resting_poses(model, cell.bounds.array, 30, 7)
    checker, elsewhere = FeasibilityChecker(model, cell, grasps), FeasibilityChecker(model, moved, grasps)
    labels = np.array([checker.feasible(T) for T in poses])
    assert 0.05 < labels.mean() < 0.95
    np.testing.assert_array_equal([elsewhere.feasible(move @ T) for T in poses], labels)


@pytest.mark.parametrize("cell_name", ["nova2-w", "nova2-s1"])
def test_a_grasp_has_the_same_label_alone_as_among_others(cell_name):
    model, cell = load_object("bottle"), load_workcell(cell_name)
    grasps = sample_grasps(model, cell.end_effector, 40, seed=1)
    poses = resting_poses(model, cell.bounds.array, 12, 8)
    together = FeasibilityChecker(model, cell, grasps)
    labels = np.array([together.feasible(T) for T in poses])
    few = np.arange(0, 40, 5)
    assert 0 < labels[:, few].mean() < 1
    for grasp in few:
        alone = FeasibilityChecker(model, cell, grasps.subset([grasp]))
        np.testing.assert_array_equal([alone.feasible(T)[0] for T in poses], labels[:, grasp])
