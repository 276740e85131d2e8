"""Newton's method on pose errors: its derivative, what it converges to, and that it keeps limits."""

import numpy as np
import pytest
from derivatives import assert_derivative

from regrasp_opt.conventions import pose_distance
from regrasp_opt.robots.newton import _error, _factors, _goal, _solve, astride, descend, polish


def configurations(robot, count, seed=0):
    return np.random.default_rng(seed).uniform(robot.lower, robot.upper, (count, robot.dof))


@pytest.mark.parametrize("name", ["nova2", "panda", "mixed"])
def test_the_jacobian_is_the_derivative_of_the_tip(name, request):
    robot = request.getfixturevalue(name)
    q = configurations(robot, 1)[0]
    goal = _goal(robot.forward(q)[None])  # at the goal the twist's derivative is minus the Jacobian
    J = _error(robot.chain, goal, q[:, None])[1][..., 0]
    assert_derivative(lambda x: -_error(robot.chain, goal, x[:, None])[0][:, 0], J, q)


@pytest.mark.parametrize("name", ["nova2", "panda", "mixed"])
def test_the_error_is_the_distance_and_the_angle_to_the_goal(name, request):
    robot = request.getfixturevalue(name)
    q, goals = configurations(robot, 50), robot.forward(configurations(robot, 50, seed=1))
    error = _error(robot.chain, _goal(goals), q.T)[0]
    distance, angle = pose_distance(robot.forward(q), goals)
    np.testing.assert_allclose(np.linalg.norm(error[:3], axis=0), distance)
    np.testing.assert_allclose(np.linalg.norm(error[3:], axis=0), angle, atol=1e-7)


def test_the_linear_solver_is_numpys():
    rng = np.random.default_rng(0)
    J, b, damping = rng.normal(size=(6, 5, 7)), rng.normal(size=(5, 7)), rng.uniform(1e-3, 1, 7)
    x = _solve(_factors(J, damping), b)
    for k in range(7):
        A = J[..., k].T @ J[..., k] + damping[k] * np.eye(5)
        np.testing.assert_allclose(x[:, k], np.linalg.solve(A, b[:, k]))


@pytest.mark.parametrize("count", [300, 3000])
def test_polishing_converges_at_third_order(nova2, count):
    q = configurations(nova2, count, seed=2)
    T = nova2.forward(q)
    errors = []
    for off in (1e-2, 1e-3):
        moved, left = polish(nova2.chain, T, q + off * np.sign(np.random.default_rng(3).normal(size=q.shape)))
        distance, angle = pose_distance(nova2.forward(moved), T)
        np.testing.assert_allclose(left, np.hypot(distance, angle), atol=3e-8)
        errors.append(np.median(left))
    assert errors[0] < 1e-4
    assert errors[1] < errors[0] / 300


def test_descent_from_far_finds_most_goals_and_says_which(nova2, panda):
    for robot in (nova2, panda):
        T = robot.forward(configurations(robot, 200, seed=4))
        q, errors = descend(robot.chain, T, configurations(robot, 200, seed=5), 40)
        distance, angle = pose_distance(robot.forward(q), T)
        np.testing.assert_allclose(errors, np.hypot(distance, angle), atol=3e-8)
        assert np.mean(errors < 1e-8) > 0.4


def test_descent_keeps_the_limits(panda):
    T = panda.forward(configurations(panda, 100, seed=6))
    start = configurations(panda, 100, seed=7)
    q, errors = descend(panda.chain, T, start, 40, (panda.lower, panda.upper))
    assert (q >= panda.lower).all()
    assert (q <= panda.upper).all()
    assert np.mean(errors < 1e-8) > 0.2


def test_a_joint_at_its_limit_does_not_stop_the_others(nova2):
    q = configurations(nova2, 1, seed=8)
    lower, upper = q[0] - 0.3, q[0] + 0.3
    upper[2] = q[0, 2]
    start = q + np.array([0.2, -0.2, 0.0, 0.1, 0.1, -0.1])
    found, errors = descend(nova2.chain, nova2.forward(q), start, 40, (lower, upper))
    assert errors[0] < 1e-8
    np.testing.assert_allclose(found, q, atol=1e-6)


def test_no_configurations_are_no_trouble(nova2):
    none = np.zeros((0, 6))
    assert polish(nova2.chain, np.zeros((0, 4, 4)), none)[0].shape == (0, 6)
    assert descend(nova2.chain, np.zeros((0, 4, 4)), none, 5)[0].shape == (0, 6)
    assert astride(nova2.chain, none, 0.1).shape == (0, 6)


def test_beside_a_stretched_elbow_lie_its_two_bends(nova2):
    q = configurations(nova2, 5, seed=9)
    q[:, 2] = 1e-3
    left, right = astride(nova2.chain, q, 0.1).reshape(2, 5, 6) - q
    np.testing.assert_allclose(left, -right)
    assert (np.abs(left).max(axis=1) == pytest.approx(0.1)) and (np.abs(left[:, 2]) > 0.05).all()
