"""Trajectories: closed-form extremes against dense samples, and what must not change under slowing and reversing."""

import numpy as np
import pytest

from regrasp_opt.motion.trajectory.time_parameterization import rest_to_rest
from regrasp_opt.motion.trajectory.trajectory import MotionLimits, Trajectory, joined


def random_trajectory(rng, knots=6, dof=3):
    times = np.concatenate([[0.0], np.cumsum(rng.uniform(0.1, 1.0, knots - 1))])
    return Trajectory(times, rng.normal(size=(knots, dof)), rng.normal(size=(knots, dof)))


def dense(trajectory, count=20_001):
    return np.linspace(0.0, trajectory.duration, count)


@pytest.mark.parametrize("seed", range(4))
def test_extremes_are_those_of_dense_samples(seed):
    path = random_trajectory(np.random.default_rng(seed))
    t = dense(path)
    q, v = path.at(t), path.velocity_at(t)
    low, high = path.position_range()
    assert np.allclose(low, q.min(axis=0), atol=1e-6) and np.allclose(high, q.max(axis=0), atol=1e-6)
    assert np.allclose(path.peak_velocity(), np.abs(v).max(axis=0), atol=1e-4)
    for piece in range(len(path.times) - 1):
        inside = t[(t > path.times[piece]) & (t < path.times[piece + 1])]
        acceleration = np.diff(path.velocity_at(inside), axis=0) / np.diff(inside)[:, None]
        assert (np.abs(acceleration) <= path.peak_acceleration() + 1e-6).all()
    h = 1e-6
    ends = np.concatenate([path.times[:-1] + h, path.times[1:] - h])
    curvature = (path.velocity_at(ends + h / 2) - path.velocity_at(ends - h / 2)) / h
    assert np.allclose(np.abs(curvature).max(axis=0), path.peak_acceleration(), rtol=1e-3)


def test_a_straight_and_a_parabolic_piece_have_their_extremes():
    line = Trajectory(np.array([0.0, 2.0]), np.array([[0.0], [2.0]]), np.array([[1.0], [1.0]]))
    assert line.position_range() == (np.array([0.0]), np.array([2.0]))
    hill = Trajectory(np.array([0.0, 2.0]), np.array([[0.0], [0.0]]), np.array([[1.0], [-1.0]]))
    assert np.allclose(hill.position_range(), [[0.0], [0.5]])
    assert np.allclose(hill.peak_acceleration(), 1.0)


def test_velocity_is_the_derivative_of_position():
    path = random_trajectory(np.random.default_rng(1))
    t, h = np.linspace(0.01, path.duration - 0.01, 57), 1e-6
    assert np.allclose(path.velocity_at(t), (path.at(t + h) - path.at(t - h)) / (2 * h), atol=1e-5)


def test_acceleration_and_jerk_are_derivatives_of_velocity():
    path = random_trajectory(np.random.default_rng(5))
    middles, h = (path.times[1:] + path.times[:-1]) / 2, 1e-4
    before, after = path.velocity_at(middles - h), path.velocity_at(middles + h)
    assert np.allclose(path.acceleration_at(middles), (after - before) / (2 * h), atol=1e-6)
    jerk = (after - 2 * path.velocity_at(middles) + before) / h**2
    assert np.allclose(path.peak_jerk(), np.abs(jerk).max(axis=0), rtol=1e-4)


def test_split_parts_are_the_same_motion():
    path = random_trajectory(np.random.default_rng(6))
    cuts = np.array([0.2, 0.3, 0.8]) * path.duration
    parts = path.split(cuts)
    for part, start in zip(parts, (0.0, *cuts), strict=True):
        t = dense(part, 101)
        assert np.allclose(part.at(t), path.at(start + t))
        assert np.allclose(part.velocity_at(t), path.velocity_at(start + t))
    assert sum(part.duration for part in parts) == pytest.approx(path.duration)
    assert len(path.split(np.array([]))) == 1


def test_slowing_keeps_the_path_and_divides_speeds_and_accelerations():
    path = random_trajectory(np.random.default_rng(2))
    slow = path.slowed(2.0)
    assert np.allclose(slow.at(2 * dense(path, 101)), path.at(dense(path, 101)))
    assert np.allclose(slow.peak_velocity(), path.peak_velocity() / 2)
    assert np.allclose(slow.peak_acceleration(), path.peak_acceleration() / 4)


@pytest.mark.parametrize(
    ("velocity", "acceleration", "jerk"), [(0.1, 1e2, 1e3), (1e2, 0.1, 1e3), (1e2, 1e2, 0.1), (1e3, 1e3, 1e4)]
)
def test_within_reaches_the_tighter_limit_and_no_more(velocity, acceleration, jerk):
    path = random_trajectory(np.random.default_rng(3))
    limits = MotionLimits(np.full(3, velocity), np.full(3, acceleration), np.full(3, jerk))
    inside = path.within(limits)
    peaks = inside.peak_velocity(), inside.peak_acceleration(), inside.peak_jerk()
    shares = [(peak / limit).max() for peak, limit in zip(peaks, limits, strict=True)]
    assert max(shares) <= 1.0
    assert max(shares) > 0.999 or inside is path


def test_reversing_takes_the_path_backwards():
    path = random_trajectory(np.random.default_rng(4))
    t = dense(path, 101)
    assert np.allclose(path.reversed().at(t), path.at(path.duration - t))
    assert np.allclose(path.reversed().velocity_at(t[1:-1]), -path.velocity_at(path.duration - t[1:-1]))


def test_joined_parts_follow_each_other():
    first, second = (
        rest_to_rest(np.array(a), np.array(b), MotionLimits(np.ones(2), np.ones(2), np.full(2, np.inf)))
        for a, b in ([(0, 0), (1, 2.0)], [(1, 2.0), (0, 5)])
    )
    both = joined([first, second])
    assert both.duration == pytest.approx(first.duration + second.duration)
    assert np.allclose(both.at(0.3), first.at(0.3))
    assert np.allclose(both.at(first.duration + 0.3), second.at(0.3))
    assert (np.diff(both.times) > 0).all()
