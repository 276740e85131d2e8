"""Inverse kinematics, analytic and numerical: sound, complete, within limits, repeatable."""

import numpy as np
import pytest
from arms import GENERAL_SIX, MIXED, arm_urdf
from hypothesis import given
from hypothesis import strategies as st

from regrasp_opt.conventions import FK_POSITION_TOLERANCE, FK_ROTATION_TOLERANCE, pose_distance
from regrasp_opt.robots import load_robot
from regrasp_opt.robots.analytic import AnalyticIk
from regrasp_opt.robots.ik import principal
from regrasp_opt.robots.locked import LockedIk
from regrasp_opt.robots.numerical import NumericalIk


@pytest.fixture(scope="module")
def general(tmp_path_factory):
    path = tmp_path_factory.mktemp("general") / "arm.urdf"
    path.write_text(arm_urdf(GENERAL_SIX))
    return load_robot(path)


def configurations(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.dof))


def same(a, b, tolerance=1e-5):
    """Whether configurations are equal but for whole turns."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi).max(axis=-1) < tolerance


def check_sound(robot, T, solutions):
    distance, angle = pose_distance(robot.forward(solutions.q), T[solutions.pose_index])
    assert distance.max() <= FK_POSITION_TOLERANCE
    assert angle.max() <= FK_ROTATION_TOLERANCE
    assert (solutions.q >= robot.lower - 1e-9).all()
    assert (solutions.q <= robot.upper + 1e-9).all()
    assert (np.diff(solutions.pose_index) >= 0).all()


def share_found(q, solutions):
    return np.mean([same(solutions.q[solutions.pose_index == k], q[k]).any() for k in range(len(q))])


def test_solvers_are_chosen_by_the_arm(any_robot, general):
    solvers = {"panda": LockedIk, "nova2": AnalyticIk, "ur5": AnalyticIk, "ur10": AnalyticIk}
    assert isinstance(any_robot.ik, solvers.get(any_robot.name, NumericalIk))
    assert isinstance(general.ik, NumericalIk)


@pytest.mark.parametrize("name", ["nova2", "ur5"])
def test_analytic_branches_are_sound_and_contain_where_the_pose_came_from(name, request):
    robot = request.getfixturevalue(name)
    q = configurations(robot, 1000)
    T = robot.forward(q)
    solutions = robot.solve_ik(T)
    check_sound(robot, T, solutions)
    assert share_found(q, solutions) == 1.0
    assert len(solutions.q) / len(q) > 4


def test_analytic_branches_miss_none_that_a_numerical_search_finds(nova2):
    search = NumericalIk(nova2.chain, nova2.lower, nova2.upper)
    T = nova2.forward(configurations(nova2, 12, seed=3))
    found, branches = search.solve(T), nova2.solve_ik(T)
    assert len(found.q) > 30
    for q, k in zip(found.q, found.pose_index, strict=True):
        assert same(branches.q[branches.pose_index == k], q).any()


@pytest.mark.parametrize("bend", [0.0, 1e-9, 1e-6, 1e-3])
def test_a_stretched_elbow_is_found(nova2, bend):
    q = configurations(nova2, 100, seed=4)
    q[:, 2] = bend
    T = nova2.forward(q)
    solutions = nova2.solve_ik(T)
    check_sound(nova2, T, solutions)
    assert set(solutions.pose_index) == set(range(100))


@pytest.mark.parametrize("twist", [0.0, 1e-9, 1e-4, 1e-2])
@pytest.mark.parametrize("at", [0.0, np.pi])
def test_near_the_wrists_singularity_branches_are_sound_and_from_a_little_off_none_is_missed(nova2, twist, at):
    """At the singularity itself infinitely many configurations reach a pose; for some poses none is found there."""
    q = configurations(nova2, 100, seed=11)
    q[:, 4] = at + twist
    T = nova2.forward(q)
    solutions = nova2.solve_ik(T)
    check_sound(nova2, T, solutions)
    if twist >= 1e-4:
        assert share_found(q, solutions) == 1.0
    else:
        assert len(set(solutions.pose_index)) > 60


def test_float32_poses_have_solutions(nova2):
    T = nova2.forward(configurations(nova2, 100)).astype(np.float32)
    assert set(nova2.solve_ik(T).pose_index) == set(range(100))


def test_poses_out_of_reach_have_none(nova2, panda):
    for robot in (nova2, panda):
        T = np.eye(4)[None].repeat(3, 0)
        T[:, 0, 3] = 1.01 * robot.max_reach, 3.0, 100.0
        solutions = robot.solve_ik(T)
        assert solutions.q.shape == (0, robot.dof)
        assert solutions.pose_index.shape == (0,)


def test_an_empty_batch_and_a_single_pose(nova2, panda):
    for robot in (nova2, panda):
        assert robot.solve_ik(np.zeros((0, 4, 4))).q.shape == (0, robot.dof)
        assert len(robot.solve_ik(robot.forward(robot.home)).q) > 0


def test_a_mixed_batch_keeps_its_indices(nova2):
    reachable = nova2.forward(nova2.home)
    far = reachable.copy()
    far[0, 3] = 5.0
    assert set(nova2.solve_ik(np.array([far, reachable, far, reachable])).pose_index) == {1, 3}


@pytest.mark.parametrize("name", ["panda", "general"])
def test_numerical_solutions_are_sound_and_distinct(name, request):
    robot = request.getfixturevalue(name)
    T = robot.forward(configurations(robot, 12, seed=5))
    solutions = NumericalIk(robot.chain, robot.lower, robot.upper).solve(T)
    check_sound(robot, T, solutions)
    assert set(solutions.pose_index) == set(range(12))
    for k in range(12):
        q = solutions.q[solutions.pose_index == k]
        gaps = np.abs(q[:, None] - q[None]).max(axis=-1) + np.eye(len(q))
        assert gaps.min() > 1e-3


def test_numerical_search_finds_where_the_pose_came_from(general):
    q = configurations(general, 24, seed=6)
    assert share_found(q, general.solve_ik(general.forward(q))) >= 0.9


SLIDE = ("prismatic", "0.1 0 0.2", "0.2 0 0.1", "0 1 0", (-0.3, 0.4))
SHORT = {
    "one joint": GENERAL_SIX[:1],
    "one slide": [SLIDE],
    "turn and slide": [GENERAL_SIX[0], SLIDE],
    "two": GENERAL_SIX[:2],
    "three": GENERAL_SIX[:3],
    "three slides": [SLIDE, ("prismatic", "0 0 0", "0 0 0", "1 0 0", (-0.3, 0.4)), (*SLIDE[:4], (0, 0.2))],
    "four": MIXED,
    "five": GENERAL_SIX[:5],
}


@pytest.mark.parametrize("name", SHORT)
def test_short_arms_reach_their_own_poses_and_no_others(name, tmp_path):
    (tmp_path / "short.urdf").write_text(arm_urdf(SHORT[name]))
    robot = load_robot(tmp_path / "short.urdf")
    q = configurations(robot, 5)
    T = robot.forward(q)
    solutions = robot.solve_ik(T)
    check_sound(robot, T, solutions)
    assert share_found(q, solutions) == 1.0
    T[:, :3, :3] = T[:, :3, :3] @ np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    assert len(robot.solve_ik(T).q) == 0
    assert robot.ik_test[1:4] == (64, 64, 64)
    assert robot.ik_test.residual < 1e-6


def test_the_same_poses_give_the_same_solutions(nova2, panda):
    for robot, again in ((nova2, load_robot("nova2")), (panda, panda)):
        T = robot.forward(configurations(robot, 4, seed=7))
        np.testing.assert_array_equal(robot.solve_ik(T).q, again.solve_ik(T).q)
        whole = robot.solve_ik(T)
        np.testing.assert_array_equal(robot.solve_ik(T[2:3]).q, whole.q[whole.pose_index == 2])


def test_equivalents_are_all_whole_turns_within_limits(nova2):
    q = np.array([0.5, 1.0, -2.0, -3.0, 0.0, 6.0])
    found = nova2.equivalents(q)
    assert [len(values) for values in found] == [2, 1, 1, 2, 1, 2]
    for x, values, low, high in zip(q, found, nova2.lower, nova2.upper, strict=True):
        assert ((values >= low) & (values <= high)).all()
        np.testing.assert_allclose(np.exp(1j * values), np.exp(1j * x))
        assert (np.diff(values) > 6).all()


def test_the_nearest_equivalent_is_chosen_joint_by_joint(nova2):
    rng = np.random.default_rng(3)
    q, to = rng.uniform(nova2.lower, nova2.upper, (40, 1, 6)), rng.uniform(-9, 9, (30, 6))
    near = nova2.nearest_equivalent(q, to)
    assert near.shape == (40, 30, 6)
    for i, j in np.ndindex(40, 30):
        for x, wanted, values in zip(near[i, j], to[j], nova2.equivalents(q[i, 0]), strict=True):
            assert np.abs(x - wanted) == pytest.approx(np.abs(values - wanted).min())


def test_sliding_joints_have_no_equivalents(mixed):
    q = np.array([0.0, 0.1, 0.5, 0.0])
    assert [values.tolist() for values in mixed.equivalents(q)] == [[0], [0.1], [0.5 - 2 * np.pi, 0.5], [0]]
    np.testing.assert_allclose(mixed.nearest_equivalent(q, q + 9.0), q)
    np.testing.assert_allclose(mixed.nearest_equivalent(q, q - 9.0), q - [0, 0, 2 * np.pi, 0])


@given(st.floats(-20, 20), st.floats(-7, 6), st.floats(0.1, 8))
def test_principal_is_the_nearest_value_to_zero_within_the_limits(q, lower, width):
    upper = lower + width
    value, fits = principal(np.array([[q]]), np.array([lower]), np.array([upper]), np.array([True]))
    candidates = q + 2 * np.pi * np.arange(-8, 9)
    inside = candidates[(candidates >= lower) & (candidates <= upper)]
    near_a_limit = np.abs(candidates - lower).min() < 1e-6 or np.abs(candidates - upper).min() < 1e-6
    if not near_a_limit:
        assert fits[0] == (len(inside) > 0)
    if fits[0] and not near_a_limit:
        assert abs(value[0, 0]) == pytest.approx(np.abs(inside).min(), abs=1e-6)


def descend(robot, T, q, steps=60):
    """Return `q` (B, 6) after damped Newton steps on the pose error, its derivative taken by differences."""

    def error(q):
        at = robot.forward(q)
        R = np.swapaxes(at[:, :3, :3], -1, -2) @ T[:3, :3]
        turn = np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1) / 2
        away = np.trace(R, axis1=1, axis2=2)[:, None] < 0  # beyond a right angle the sine falls again
        turn = np.where(away, turn / np.maximum(np.linalg.norm(turn, axis=1, keepdims=True), 1e-9), turn)
        return np.concatenate([at[:, :3, 3] - T[:3, 3], -(at[:, :3, :3] @ turn[..., None])[..., 0]], axis=1)

    damping, now = np.full(len(q), 1e-2), error(q)
    for _ in range(steps):
        J = np.stack([(error(q + 1e-6 * axis) - now) / 1e-6 for axis in np.eye(6)], axis=2)
        A = np.swapaxes(J, 1, 2) @ J + damping[:, None, None] * np.eye(6)
        step = np.linalg.solve(A, np.swapaxes(J, 1, 2) @ now[..., None])[..., 0]
        trial = q - np.clip(step, -0.5, 0.5)
        after = error(trial)
        better = np.linalg.norm(after, axis=1) < np.linalg.norm(now, axis=1)
        q, now = np.where(better[:, None], trial, q), np.where(better[:, None], after, now)
        damping = np.where(better, np.maximum(damping / 4, 1e-12), damping * 4)
    return q[np.linalg.norm(now, axis=1) < 1e-7]


@pytest.mark.parametrize("seed", [8, 9])
def test_a_dense_search_finds_no_other_branch(nova2, seed):
    """From each of 729 points of a grid over all joints, by a method that shares nothing with either solver."""
    T = nova2.forward(configurations(nova2, 1, seed))[0]
    grid = np.stack(np.meshgrid(*6 * [np.array([-2.0, 0.1, 2.2])], indexing="ij"), axis=-1).reshape(-1, 6)
    found = descend(nova2, T, grid)
    found = found[principal(found, nova2.lower, nova2.upper, np.ones(6, bool))[1]]
    branches = nova2.solve_ik(T).q
    assert len(found) > 100
    assert all(same(branches, q).any() for q in found)
    assert all(same(found, q).any() for q in branches)
