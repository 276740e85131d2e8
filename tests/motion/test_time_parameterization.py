"""Timing: limits are reached and kept, and paths go where they should."""

import itertools

import numpy as np
import pytest

from regrasp_opt.motion.trajectory.time_parameterization import fastest, rest_to_rest, rounded, smoothed, through
from regrasp_opt.motion.trajectory.trajectory import MotionLimits, Trajectory, joined

LIMITS = MotionLimits(np.array([1.0, 2.0]), np.array([4.0, 3.0]), np.full(2, np.inf))


@pytest.mark.parametrize("change", [[0.05, 0.01], [2.0, 0.5], [0.0, -3.0]])
def test_a_straight_motion_takes_the_time_of_its_slowest_joint(change):
    change = np.array(change)
    path = rest_to_rest(np.zeros(2), change, LIMITS)
    times = []
    for size, v, a in zip(np.abs(change), *LIMITS[:2], strict=True):
        times.append(2 * np.sqrt(size / a) if size < v**2 / a else size / v + v / a)
    # the joints move in step, so the tightest speed and the tightest acceleration may be those of two joints
    assert max(times) - 1e-9 <= path.duration <= 1.33 * max(times)
    assert np.array_equal(path.positions[[0, -1]], [np.zeros(2), change])
    assert not path.velocities[[0, -1]].any()
    assert (path.peak_velocity() <= LIMITS[0] * (1 + 1e-9)).all()
    assert (path.peak_acceleration() <= LIMITS[1] * (1 + 1e-9)).all()
    t = np.linspace(0, path.duration, 50)
    assert np.allclose(path.at(t) @ np.array([-change[1], change[0]]), 0.0, atol=1e-12)


def test_no_motion_takes_no_time_worth_speaking_of():
    assert rest_to_rest(np.ones(2), np.ones(2), LIMITS).duration < 0.01


def test_the_linear_program_finds_the_fastest_timing_of_a_straight_path():
    change = np.array([1.5, 0.7])
    best = rest_to_rest(np.zeros(2), change, LIMITS)
    path = fastest(through(np.linspace(0.0, 1.0, 9)[:, None] * change), LIMITS, 60)
    assert best.duration - 1e-6 <= path.duration < 1.02 * best.duration


def test_a_curved_path_keeps_the_limits_and_uses_one_of_them_nearly_all_the_time():
    angle = np.linspace(0, np.pi, 30)
    curve = through(np.column_stack([np.cos(angle), np.sin(angle)]))
    path = fastest(curve, LIMITS, 60)
    assert (path.peak_velocity() <= LIMITS[0] * (1 + 1e-9)).all()
    assert (path.peak_acceleration() <= LIMITS[1] * (1 + 1e-9)).all()
    t = np.linspace(0, path.duration, 400)
    q, v = path.at(t), path.velocity_at(t)
    assert np.abs(np.linalg.norm(q, axis=1) - 1).max() < 5e-4
    share_v = (np.abs(v) / LIMITS[0]).max(axis=1)
    share_a = (np.abs(np.gradient(v, t, axis=0)) / LIMITS[1]).max(axis=1)
    assert np.mean(np.maximum(share_v, share_a) > 0.9) > 0.9


def accelerations(path):
    """Return those at the beginning and at the end of each piece, (pieces, dof) each."""
    c2, c3 = path.coefficients[2:] / np.diff(path.times)[:, None] ** 2
    return 2 * c2, 2 * c2 + 6 * c3


def bang_bang():
    """Return a motion of two parts, in which accelerations jump from limit to limit."""
    out = Trajectory(np.array([0.0, 0.3]), np.array([[0, 0], [0.18, 0.09]]), np.array([[0, 0], [1.2, 0.6]]))
    back = Trajectory(np.array([0.0, 0.3]), np.array([[0.18, 0.09], [0.36, 0.18]]), np.array([[1.2, 0.6], [0, 0]]))
    return [out, back]


@pytest.mark.parametrize("jerk", [np.inf, 500.0, 60.0, 5.0])
def test_a_smoothed_run_has_continuous_accelerations_within_all_limits(jerk):
    limits = MotionLimits(np.array([1.2, 0.6]), np.array([4.0, 3.0]), np.array([jerk, jerk]))
    rough = bang_bang()
    parts = smoothed(rough, limits)
    assert len(parts) == 2
    assert np.array_equal(parts[0].positions[0], [0, 0]) and np.array_equal(parts[1].positions[-1], [0.36, 0.18])
    assert np.array_equal(parts[0].positions[-1], parts[1].positions[0])
    assert np.array_equal(parts[0].velocities[-1], parts[1].velocities[0])
    first, last = (np.vstack(each) for each in zip(*map(accelerations, parts), strict=True))
    rest = np.zeros((1, 2))
    assert np.abs(np.vstack([first, rest]) - np.vstack([rest, last])).max() < 1e-6
    for part in parts:
        assert (part.peak_velocity() <= limits.velocity * (1 + 1e-9)).all()
        assert (part.peak_acceleration() <= limits.acceleration * (1 + 1e-6)).all()
        assert (part.peak_jerk() <= limits.jerk * (1 + 1e-4)).all()
    duration = sum(part.duration for part in parts)
    assert 0.6 < duration < (0.61 if jerk == np.inf else 3.0)


def test_a_tight_limit_of_jerk_takes_not_much_longer_than_it_must():
    jerk = 5.0
    limits = MotionLimits(np.array([1.2, 0.6]), np.array([4.0, 3.0]), np.array([jerk, jerk]))
    (path,) = smoothed([joined(bang_bang())], limits)
    least = np.cbrt(32 * 0.36 / jerk)  # jerk at its limit all the time
    assert least < path.duration < 1.6 * least


def test_smoothing_keeps_to_what_the_rough_motion_spans():
    path = joined(smoothed(bang_bang(), LIMITS))
    low, high = path.position_range()
    assert (low >= 0).all() and (high <= [0.36, 0.18]).all()
    t = np.linspace(0, path.duration, 50)
    assert np.allclose(path.at(t) @ np.array([1.0, -2.0]), 0.0, atol=1e-12)


def test_a_path_through_waypoints_meets_them():
    points = np.random.default_rng(0).normal(size=(7, 3))
    assert np.allclose(through(points)(np.linspace(0, 1, 7)), points)


@pytest.mark.parametrize("spacing", [0.5, 0.1])
def test_a_rounded_polyline_begins_and_ends_with_it_and_stays_near(spacing):
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [2.0, 1.0]])
    path = rounded(corners, spacing)
    points = path(np.linspace(0, 1, 500))
    assert np.allclose(points[[0, -1]], corners[[0, -1]])
    distance = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(corners):
        part = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        distance = np.minimum(distance, np.linalg.norm(points - a - part[:, None] * (b - a), axis=1))
    assert 0 < distance.max() < spacing
    jumps = np.diff(path(np.linspace(0, 1, 2001), 1), axis=0)
    assert np.abs(jumps).max() < 0.1 / spacing


def test_two_corners_give_a_straight_path():
    path = rounded(np.array([[0.0, 0.0], [1.0, 2.0]]), 10.0)
    points = path(np.linspace(0, 1, 50))
    assert np.allclose(points[:, 1], 2 * points[:, 0])
