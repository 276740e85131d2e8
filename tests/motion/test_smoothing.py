"""Motions without stops: shorter, within limits, verified; and as they were where that fails."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from verifying import motion_findings

from regrasp_opt.motion import MotionOptions, Phase, plan_motion
from regrasp_opt.motion.trajectory import planner
from regrasp_opt.motion.trajectory import smoothing as runs_module
from regrasp_opt.motion.trajectory.connector import Connector
from regrasp_opt.motion.trajectory.smoothing_program import STEPS, Crossing, Line, fastest_run
from regrasp_opt.motion.trajectory.time_parameterization import rest_to_rest, smoothed
from regrasp_opt.motion.trajectory.trajectory import MotionLimits

VELOCITY, ACCELERATION = np.array([2.0, 1.0]), np.array([5.0, 4.0])
LIMITS = MotionLimits(VELOCITY, ACCELERATION, np.full(2, np.inf))
START, END = np.array([0.2, -0.4]), np.array([1.4, 0.3])


@pytest.fixture(scope="module")
def stopping(bottle_plan):
    return plan_motion(bottle_plan, MotionOptions(optimise=False))


def crossing(start, end, radius=np.inf):
    guess = np.linspace(start, end, STEPS + 1)
    return Crossing(guess, guess - radius, guess + radius)


def straight_line(start, end):
    """Return a line in joint space as `Line`."""
    s = np.linspace(0, 1, 13)[:, None]
    return Line(start + s * (end - start), np.tile(end - start, (13, 1)), np.zeros((13, 2)))


def test_from_rest_to_rest_it_is_as_fast_as_limits_allow():
    """The slowest joint speeds up, cruises, slows down; the knots cannot switch exactly when that would be best."""
    (found,) = fastest_run(None, crossing(START, END), None, VELOCITY, ACCELERATION)
    (found,) = smoothed([found], LIMITS)
    one = [MotionLimits(*(x[j : j + 1] for x in LIMITS)) for j in range(2)]
    alone = [rest_to_rest(START[j : j + 1], END[j : j + 1], one[j]).duration for j in range(2)]
    assert max(alone) <= found.duration < 1.05 * max(alone)
    assert np.allclose(found.positions[[0, -1]], [START, END], atol=1e-9)


def test_lines_are_followed_without_a_stop():
    corner, other = np.array([0.5, 0.2]), np.array([1.1, 0.6])
    lines = straight_line(START, corner), straight_line(other, END)
    parts = fastest_run(lines[0], crossing(corner, other), lines[1], VELOCITY, ACCELERATION)
    assert np.array_equal(parts[0].positions, lines[0].positions)
    assert np.array_equal(parts[2].positions, lines[1].positions)
    for a, b in itertools.pairwise(parts):
        assert np.allclose(a.velocities[-1], b.velocities[0], atol=1e-12)
        assert np.abs(a.velocities[-1]).max() > 0.1
    for part in parts:
        assert (part.peak_velocity() <= 1.02 * VELOCITY).all()
        assert (part.peak_acceleration() <= 1.02 * ACCELERATION).all()
    legs = [rest_to_rest(a, b, LIMITS).duration for a, b in ((START, corner), (corner, other), (other, END))]
    assert sum(part.duration for part in parts) < 0.9 * sum(legs)


def test_the_crossing_stays_between_its_bounds():
    corner = straight_line(START, np.array([0.2, 0.6]))
    way = crossing(corner.positions[-1], END, 0.02)
    parts = fastest_run(corner, way, None, VELOCITY, ACCELERATION)
    assert (parts[1].positions >= way.lower - 1e-6).all() and (parts[1].positions <= way.upper + 1e-6).all()


def test_without_stops_it_is_shorter_and_the_same_plan(motion, stopping):
    assert motion.duration < 0.9 * stopping.duration
    for a, b in zip(motion.segments, stopping.segments, strict=True):
        assert (a.phase, a.grasp_id, a.jaw) == (b.phase, b.grasp_id, b.jaw)
        if a.phase in (Phase.GRASP, Phase.RELEASE):
            assert np.array_equal(a.trajectory.positions, b.trajectory.positions)
    moving = [s for s in motion.segments if s.phase is Phase.LIFT]
    assert any(np.abs(s.trajectory.velocities[-1]).max() > 0.1 for s in moving)


def test_lines_stay_straight_for_half_their_length(motion, stopping):
    robot = motion.plan.problem.workcell.robot
    for a, b in zip(motion.segments, stopping.segments, strict=True):
        if a.phase is not Phase.LIFT:
            continue
        q = a.trajectory.at(np.linspace(0, a.trajectory.duration, 50))
        p = np.array([robot.forward(x)[:3, 3] for x in q]) - robot.forward(q[0])[:3, 3]
        whole = robot.forward(b.trajectory.positions[-1])[:3, 3] - robot.forward(q[0])[:3, 3]
        along = whole / np.linalg.norm(whole)
        assert np.linalg.norm(p - np.outer(p @ along, along), axis=1).max() < 1e-4
        assert p[-1] @ along >= min(0.5 * np.linalg.norm(whole), 0.03) - 1e-6


def test_what_cannot_be_verified_stays_as_it_was(bottle_plan, stopping, monkeypatch):
    """Only the motions of the optimisation are refused: they come last."""
    original = planner.shortened

    def refusing(connector, legs):
        with monkeypatch.context() as inside:
            inside.setattr(Connector, "accepted", lambda *_: False)
            return original(connector, legs)

    monkeypatch.setattr(planner, "shortened", refusing)
    motion = plan_motion(bottle_plan)
    for a, b in zip(motion.segments, stopping.segments, strict=True):
        assert np.array_equal(a.trajectory.positions, b.trajectory.positions)


def test_a_failure_of_ipopt_leaves_the_motion(bottle_plan, stopping, monkeypatch):
    monkeypatch.setattr(runs_module, "fastest_run", lambda *_: None)
    motion = plan_motion(bottle_plan)
    assert motion.solved and motion.duration == pytest.approx(stopping.duration, rel=1e-12)


def test_a_jump_of_speed_is_noticed(motion):
    number = next(n for n, s in enumerate(motion.segments) if s.phase is Phase.TRANSFER)
    slow = replace(motion.segments[number], trajectory=motion.segments[number].trajectory.slowed(1.5))
    segments = (*motion.segments[:number], slow, *motion.segments[number + 1 :])
    found = motion_findings(replace(motion, segments=segments), step=5e-3, turn=np.deg2rad(2.0))
    assert any("speed jumps" in text for text in found.problems)
