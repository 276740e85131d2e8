"""Inverse kinematics with one joint locked: seven-joint arms, and a slide under a six-joint one."""

import numpy as np
import pytest
from arms import FOREIGN, GENERAL_SIX, arm_urdf

from regrasp_opt.conventions import FK_POSITION_TOLERANCE, FK_ROTATION_TOLERANCE, pose_distance
from regrasp_opt.robots import load_robot
from regrasp_opt.robots.analytic import AnalyticIk
from regrasp_opt.robots.locked import HALVINGS, LockedIk, halving
from regrasp_opt.robots.numerical import NumericalIk
from regrasp_opt.robots.self_test import self_test

SLIDE = ("prismatic", "0 0 0.1", "0 0 0", "0 1 0", (-0.5, 0.7))
PUMA = [
    ("revolute", "0 0 0.5", "0 0 0", "0 0 1", (-3, 3)),
    ("revolute", "0 0.2 0", "0 0 0", "0 1 0", (-3, 3)),
    ("revolute", "0.4 -0.1 0", "0 0 0", "0 1 0", (-3, 3)),
    ("revolute", "0 0 0.4", "0 0 0", "0 0 1", (-3, 3)),
    ("revolute", "0 0 0", "0 0 0", "0 1 0", (-3, 3)),
    ("revolute", "0 0 0", "0 0 0", "0 0 1", (-3, 3)),
    ("fixed", "0 0 0.1", "0 0 0", "0 0 1", None),
]

SPHERICAL = [
    ("revolute", "0 0 0.34", "0 0 0", "0 0 1", (-2.9, 2.9)),
    ("revolute", "0 0 0", "0 0 0", "0 1 0", (-2.1, 2.1)),
    ("revolute", "0 0 0", "0 0 0", "0 0 1", (-2.9, 2.9)),
    ("revolute", "0 0 0.4", "0 0 0", "0 1 0", (-2.1, 2.1)),
    *PUMA[3:],
]
"""Spherical shoulder and wrist."""


@pytest.fixture(scope="module")
def xarm7():
    return load_robot(FOREIGN / "xarm_description/urdf/xarm7.urdf", tip="link_eef")


@pytest.fixture(scope="module")
def rail(tmp_path_factory):
    """Return an arm of six joints with a spherical wrist, on a rail."""
    path = tmp_path_factory.mktemp("rail") / "rail.urdf"
    path.write_text(arm_urdf([SLIDE, *PUMA]))
    return load_robot(path)


@pytest.fixture(scope="module")
def spherical(tmp_path_factory):
    path = tmp_path_factory.mktemp("spherical") / "spherical.urdf"
    path.write_text(arm_urdf(SPHERICAL))
    return load_robot(path)


@pytest.fixture(params=["panda", "xarm7", "rail", "spherical"])
def redundant(request):
    return request.getfixturevalue(request.param)


def configurations(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.dof))


def test_a_chain_with_a_locked_joint_moves_as_the_whole_chain_does(any_robot):
    chain, q = any_robot.chain, configurations(any_robot, 5)
    for joint in range(chain.dof):
        q[:, joint] = 0.3
        rest = chain.locked(joint, 0.3)
        np.testing.assert_allclose(rest.forward(np.delete(q, joint, axis=1)), chain.forward(q), atol=1e-12)
        assert rest.dof == chain.dof - 1
        np.testing.assert_array_equal(rest.prismatic, np.delete(chain.prismatic, joint))


def test_every_part_halves_the_steps_between_the_values():
    levels = halving(-1.0, 3.0)
    assert len(levels) == HALVINGS
    assert levels[:2] == [[1.0], [0.0, 2.0]]
    for k in range(HALVINGS):
        values = np.sort(np.concatenate(levels[: k + 1]))
        np.testing.assert_allclose(np.diff([-1.0, *values, 3.0]), 4.0 / 2 ** (k + 1))


def test_which_joint_is_locked(panda, xarm7, rail):
    assert [robot.ik.joint for robot in (panda, xarm7, rail)] == [6, 6, 0]
    assert panda.ik_test.solver == "analytic, 6R-SPHERICAL_FIRST_TWO_INTERSECTING with joint 7 locked"
    assert panda.ik_test.tried == panda.ik_test.solved == 64
    assert panda.ik_test.residual < 1e-9
    for robot in (panda, xarm7, rail):
        values, joint = np.array([sample.value for sample in robot.ik.samples]), robot.ik.joint
        assert len(set(values)) == 2**HALVINGS - 1
        assert robot.lower[joint] < values.min() and values.max() < robot.upper[joint]
        assert np.ptp(values) < 2 * np.pi


def test_solutions_are_sound(redundant):
    T = redundant.forward(configurations(redundant, 100))
    solutions = redundant.solve_ik(T)
    distance, angle = pose_distance(redundant.forward(solutions.q), T[solutions.pose_index])
    assert distance.max() <= FK_POSITION_TOLERANCE
    assert angle.max() <= FK_ROTATION_TOLERANCE
    assert (solutions.q >= redundant.lower - 1e-9).all()
    assert (solutions.q <= redundant.upper + 1e-9).all()
    assert (np.diff(solutions.pose_index) >= 0).all()
    assert len(set(solutions.pose_index)) >= 98


def test_every_configuration_with_the_joint_at_a_sample_is_found(redundant):
    q, rng = configurations(redundant, 200, seed=1), np.random.default_rng(2)
    q[:, redundant.ik.joint] = rng.choice([sample.value for sample in redundant.ik.samples], 200)
    q_found, index = redundant.solve_ik(redundant.forward(q))
    apart = np.abs((q_found - q[index] + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    assert len(set(index[apart < 1e-5])) >= 198


def test_no_pose_is_missed_that_a_numerical_search_reaches(panda):
    rng = np.random.default_rng(3)
    T = panda.forward(configurations(panda, 60, seed=3))
    T[:, :3, 3] += rng.uniform(-0.1, 0.1, (60, 3))
    search = NumericalIk(panda.chain, panda.lower, panda.upper)
    reached, missed = set(search.solve(T).pose_index), set(range(60)) - set(panda.solve_ik(T).pose_index)
    assert 30 < len(reached) < 60
    assert len(reached & missed) <= 1


def test_parts_give_together_what_the_whole_does(redundant):
    T = redundant.forward(configurations(redundant, 20, seed=4))
    q, index = redundant.ik.solve(T)
    for k in range(20):
        parts = np.concatenate([solve(T[k : k + 1]).q for solve in redundant.ik.parts])
        assert len(parts) == (index == k).sum()
        gaps = np.abs(q[index == k][:, None] - parts).max(axis=2)
        assert gaps.min(axis=0).max(initial=0.0) < 1e-7


def test_six_joints_have_one_part(nova2):
    assert nova2.ik.parts == (nova2.ik.solve,)


def test_an_arm_of_which_no_joint_can_be_locked_is_solved_numerically(tmp_path, caplog):
    (tmp_path / "seven.urdf").write_text(arm_urdf([*GENERAL_SIX, GENERAL_SIX[1]]))
    robot = load_robot(tmp_path / "seven.urdf")
    assert isinstance(robot.ik, NumericalIk)
    assert robot.ik_test.solver == "numerical"
    assert robot.ik_test.solved == 64
    assert not [record for record in caplog.records if "kinematics" in record.getMessage()]


def test_where_few_poses_are_reached_another_joint_is_locked_or_none(panda, monkeypatch):
    """Solvers that answer for hardly any pose fail the test of the whole, whichever joint is locked."""
    from regrasp_opt.robots.self_test import inverse_kinematics

    solve = LockedIk.solve

    def few(self, T):
        q, index = solve(self, T)
        return type(solve(self, T[:0]))(q[index < 10], index[index < 10])

    def but_the_sixth(self, T):
        return few(self, T) if self.joint == 6 else solve(self, T)

    arm = "panda", panda.chain, panda.lower, panda.upper
    with monkeypatch.context() as patch:
        patch.setattr(LockedIk, "solve", but_the_sixth)
        other = inverse_kinematics(*arm)
    assert other.joint == 5
    assert self_test(other, *arm[1:]).solved >= 60
    monkeypatch.setattr(LockedIk, "solve", few)
    assert isinstance(inverse_kinematics(*arm), NumericalIk)


def test_the_solvers_of_the_parts_are_analytic(redundant):
    assert all(isinstance(sample.others, AnalyticIk) for sample in redundant.ik.samples)


def test_the_locked_joint_keeps_its_value_while_the_others_are_polished(xarm7):
    q, _ = xarm7.solve_ik(xarm7.forward(configurations(xarm7, 50, seed=6)))
    values = np.array([sample.value for sample in xarm7.ik.samples])
    assert np.abs(q[:, 6, None] - values).min(axis=1).max() == 0.0


def test_large_batches_are_solved_in_pieces(redundant, monkeypatch):
    T = redundant.forward(configurations(redundant, 10, seed=7))
    whole = redundant.ik.solve(T)
    monkeypatch.setattr("regrasp_opt.robots.locked.AT_ONCE", 3 * len(redundant.ik.samples))
    pieces = redundant.ik.solve(T)
    np.testing.assert_array_equal(pieces.pose_index, whole.pose_index)
    np.testing.assert_allclose(pieces.q, whole.q, atol=1e-7)


def test_without_limits_the_joints_beyond_them_are_named(spherical):
    q = configurations(spherical, 40)
    joint = spherical.ik.joint
    turned = next(k for k in (5, 3, 1) if k != joint)
    q[:, turned] = spherical.upper[turned] + 0.1
    T = spherical.forward(q)
    free = spherical.solve_without_limits(T)
    assert len(free.q) > len(spherical.solve_ik(T).q)
    distance, angle = pose_distance(spherical.forward(free.q), T[free.pose_index])
    assert distance.max() < FK_POSITION_TOLERANCE and angle.max() < FK_ROTATION_TOLERANCE
    beyond = spherical.beyond_limits(free.q)
    assert not beyond[:, joint].any() and beyond.any()
    np.testing.assert_array_equal(~beyond.any(axis=1), [spherical.within_limits(x) for x in free.q])
    assert spherical.beyond_limits(q)[:, turned].all()
