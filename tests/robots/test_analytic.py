"""Analytic inverse kinematics of many kinds of arms: of EAIK's families, and of arms that nearly belong to one."""

import logging

import numpy as np
import pytest
from arms import FAMILIES, INNER_PARALLEL, arm_urdf, calibrated, chain_of

from regrasp_opt.conventions import FK_POSITION_TOLERANCE, FK_ROTATION_TOLERANCE, pose_distance
from regrasp_opt.robots import load_robot
from regrasp_opt.robots.alignment import aligned, parallel_runs, senses
from regrasp_opt.robots.analytic import AnalyticIk, descriptions
from regrasp_opt.robots.numerical import NumericalIk
from regrasp_opt.robots.self_test import inverse_kinematics, self_test

LIMIT = np.full(6, 2 * np.pi)


def found(ik, chain, count=300, seed=0):
    """Return the share of random configurations that are among the solutions, all of which are checked."""
    q = np.random.default_rng(seed).uniform(-np.pi, np.pi, (count, 6))
    T = chain.forward(q)
    solutions = ik.solve(T)
    distance, angle = pose_distance(chain.forward(solutions.q), T[solutions.pose_index])
    assert distance.max() <= FK_POSITION_TOLERANCE
    assert angle.max() <= FK_ROTATION_TOLERANCE
    assert (np.diff(solutions.pose_index) >= 0).all()
    apart = np.abs((solutions.q - q[solutions.pose_index] + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    return len(set(solutions.pose_index[apart < 1e-3])) / count


@pytest.mark.parametrize("name", FAMILIES)
def test_every_configuration_of_an_arm_with_exact_axes_is_found(name, caplog):
    chain = chain_of(*FAMILIES[name])
    ik = inverse_kinematics(name, chain, -LIMIT, LIMIT)
    assert isinstance(ik, AnalyticIk)
    assert found(ik, chain) == 1.0
    assert not caplog.records


@pytest.mark.parametrize("flipped", [(1,), (2,), (1, 3), (0, 4, 5)])
def test_axes_may_point_either_way(flipped):
    chain = chain_of(*FAMILIES["ur"])
    chain.axes[list(flipped)] *= -1
    assert found(inverse_kinematics("flipped", chain, -LIMIT, LIMIT), chain) == 1.0


def test_three_inner_parallel_axes_after_two_parallel_ones(tmp_path):
    (tmp_path / "inner.urdf").write_text(arm_urdf(INNER_PARALLEL))
    robot = load_robot(tmp_path / "inner.urdf")
    q = np.random.default_rng(5).uniform(-2.5, 2.5, (20, 6))
    assert set(robot.solve_ik(robot.forward(q)).pose_index) == set(range(20))
    assert robot.ik_test.solver == "analytic, 6R-THREE_INNER_PARALLEL"
    assert robot.ik_test.found == robot.ik_test.tried


@pytest.mark.parametrize("size", [1e-12, 1e-11, 1e-10, 1e-9, 1e-8, 1e-6, 1e-5, 1e-4, 3e-4, 1e-3])
@pytest.mark.parametrize("name", ["ur", "puma", "kuka", "nova2"])
@pytest.mark.parametrize("seed", [0, 3])
def test_a_calibrated_arm_is_solved_from_the_arm_next_to_it(name, size, seed, nova2, caplog):
    exact = nova2.chain if name == "nova2" else chain_of(*FAMILIES[name])
    chain = calibrated(exact, size, seed)
    ik = inverse_kinematics(name, chain, -LIMIT, LIMIT)
    assert isinstance(ik, AnalyticIk)
    assert found(ik, chain) >= (0.98 if size <= 1e-4 else 0.95)
    assert not caplog.records


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("size", [1e-11, 1e-7, 1e-4])
def test_one_axis_may_be_off(joint, size, nova2):
    chain = calibrated(nova2.chain, size, seed=joint, joints=[joint])
    assert found(inverse_kinematics("off", chain, -LIMIT, LIMIT), chain, 100) >= 0.98


def test_polished_branches_are_distinct_and_within_the_limits(nova2):
    chain = calibrated(nova2.chain, 1e-4, seed=1)
    ik = inverse_kinematics("nova2", chain, nova2.lower, nova2.upper)
    solutions = ik.solve(chain.forward(np.random.default_rng(2).uniform(nova2.lower, nova2.upper, (100, 6))))
    assert (solutions.q >= nova2.lower - 1e-9).all()
    assert (solutions.q <= nova2.upper + 1e-9).all()
    for k in range(100):
        q = solutions.q[solutions.pose_index == k]
        assert (np.abs(q[:, None] - q[None]).max(axis=-1) + np.eye(len(q))).min() > 1e-3


def test_where_no_description_serves_the_numerical_solver_is_taken_and_said_so(caplog):
    chain = chain_of(*FAMILIES["ur"])
    chain.axes[4] = chain.axes[3]  # four parallel axes: infinitely many solutions
    with caplog.at_level(logging.WARNING):
        ik = inverse_kinematics("four", chain, -LIMIT, LIMIT)
    assert isinstance(ik, NumericalIk)
    (record,) = caplog.records
    assert "four: the analytic inverse kinematics for 6R-THREE_INNER_PARALLEL finds" in record.getMessage()
    report = self_test(ik, chain, -LIMIT, LIMIT)
    assert report.solver == "numerical"
    assert report.solved == report.tried


def test_a_solver_that_loses_branches_fails_its_test(nova2, monkeypatch, caplog):
    solve = AnalyticIk.solve

    def half(self, T):
        q, index = solve(self, T)
        return type(solve(self, T[:0]))(q[::2], index[::2])

    monkeypatch.setattr(AnalyticIk, "solve", half)
    assert isinstance(inverse_kinematics("nova2", nova2.chain, nova2.lower, nova2.upper), NumericalIk)
    assert len(caplog.records) == 1


def test_the_arm_as_it_is_comes_first(nova2):
    first = next(descriptions(nova2.chain, nova2.lower, nova2.upper))
    T = nova2.forward(np.random.default_rng(4).uniform(nova2.lower, nova2.upper, (50, 6)))
    np.testing.assert_array_equal(first.solve(T).q, nova2.solve_ik(T).q)


def test_no_analytic_solver_for_other_arms(mixed, panda):
    for robot in (mixed, panda):
        assert not list(descriptions(robot.chain, robot.lower, robot.upper))


def test_alignment_makes_nearly_parallel_axes_parallel_and_nearly_meeting_ones_meet():
    axes = np.array([[0, 0, 1.0], [0, 1, 1e-3], [1e-3, -1, 0], [1, 0, 0], [0, 0, 1], [1, 0, 1e-3]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    points = np.array([[0, 0, 0.3], [0, 0.1, 0.4], [0.3, 0, 0.4], [0.5, 0, 0.5], [0.6, 1e-3, 0], [0.2, 1e-3, 0.499]])
    assert parallel_runs(axes) == [[0], [1, 2], [3], [4], [5]]
    np.testing.assert_array_equal(senses(axes), [1, 1, -1, 1, 1, 1])
    straight, moved = aligned(axes, points, meet_from=0)
    np.testing.assert_allclose(straight[1], -straight[2])
    assert np.abs(moved - points).max() < 5e-3
    for i, j in ((3, 4), (4, 5)):
        assert abs(np.cross(straight[i], straight[j]) @ (moved[j] - moved[i])) < 1e-12
    kept, still = aligned(axes, points, meet_from=5)
    np.testing.assert_array_equal(still, points)
    np.testing.assert_array_equal(kept, straight)
