"""The second proof notices every kind of fault."""

from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.benchmarks import motion_recheck
from regrasp_opt.benchmarks.motion_recheck import recheck
from regrasp_opt.motion import Phase
from regrasp_opt.motion.lines import line
from regrasp_opt.motion.timing import through
from regrasp_opt.motion.trajectory import Trajectory


def changed(motion, phase, **changes):
    """Return `motion` with the first segment of `phase` changed."""
    number = next(n for n, segment in enumerate(motion.segments) if segment.phase is phase)
    segments = list(motion.segments)
    segments[number] = replace(segments[number], **changes)
    return replace(motion, segments=tuple(segments)), segments[number]


def first(motion, phase):
    return next(segment for segment in motion.segments if segment.phase is phase)


@pytest.fixture(autouse=True)
def _coarse(monkeypatch):
    """Samples every 5 mm and 2 degrees: the faults below are larger."""
    monkeypatch.setattr(motion_recheck, "STEP", 5e-3)
    monkeypatch.setattr(motion_recheck, "TURN", np.deg2rad(2.0))


def problems(motion):
    return " | ".join(recheck(motion).problems)


def test_speeding_is_noticed(motion):
    fast = first(motion, Phase.TRANSFER).trajectory.slowed(0.98)
    text = problems(changed(motion, Phase.TRANSFER, trajectory=fast)[0])
    assert "of its limit" in text and text.count("transition 0, transfer") >= 1


def test_a_jump_of_the_arm_and_of_the_jaw_is_noticed(motion):
    path = first(motion, Phase.LIFT).trajectory
    shifted = Trajectory(path.times, path.positions + 1e-4, path.velocities)
    assert "the arm jumps" in problems(changed(motion, Phase.LIFT, trajectory=shifted)[0])
    assert "the jaw jumps" in problems(changed(motion, Phase.APPROACH, jaw=(0.05, 0.05))[0])


def test_a_missing_phase_is_noticed(motion):
    without = tuple(s for s in motion.segments if s.phase is not Phase.RELEASE)
    assert "has the phases" in problems(replace(motion, segments=without))


def test_another_grasp_is_noticed(motion):
    other = next(int(g) for g in motion.plan.transitions[0].grasp_ids if g != first(motion, Phase.GRASP).grasp_id)
    assert "misses the grasp" in problems(changed(motion, Phase.GRASP, grasp_id=other)[0])


def test_a_way_through_the_table_is_noticed(motion):
    """The lift is replaced by a dive of 30 mm and back."""
    lift = first(motion, Phase.LIFT).trajectory
    robot = motion.plan.problem.workcell.robot
    dive = through(line(robot, lift.positions[0], np.array([0.0, 0.0, -1.0]), 0.03))
    s = np.linspace(0, 1, 20)
    positions = np.concatenate([dive(s), dive(s[::-1])[1:], lift.positions[1:]])
    times = np.linspace(0, 30, len(positions))
    text = problems(changed(motion, Phase.LIFT, trajectory=Trajectory(times, positions, np.zeros_like(positions)))[0])
    assert "the object sinks into the table" in text and "meets table" in text


def test_a_transfer_that_scrapes_over_the_table_is_noticed(motion):
    """Carrying the object from grasp to release without lifting it collides."""
    lift, lower = first(motion, Phase.LIFT).trajectory, first(motion, Phase.LOWER).trajectory
    ends = np.array([lift.positions[0], lower.positions[-1]])
    low = Trajectory(np.array([0.0, 20.0]), ends, np.zeros_like(ends))
    found = recheck(changed(motion, Phase.TRANSFER, trajectory=low)[0])
    assert found.collisions > 0 and "object meets table" in " ".join(found.problems)


def test_an_approach_with_too_wide_a_hand_is_noticed(motion):
    """Turned by a quarter about its axis, the palm and fingers run into the object or what is beside it."""
    path = first(motion, Phase.APPROACH).trajectory
    turned = Trajectory(path.times, path.positions + np.pi / 2 * np.eye(6)[5], path.velocities)
    found = recheck(changed(motion, Phase.APPROACH, trajectory=turned)[0])
    assert found.collisions > 0 and "meets object" in " ".join(found.problems)


def test_joints_beyond_their_limits_are_noticed(motion):
    path = first(motion, Phase.RETURN).trajectory
    turned = Trajectory(path.times, path.positions + 4 * np.pi * np.eye(6)[5], path.velocities)
    assert "a joint leaves its limits" in problems(changed(motion, Phase.RETURN, trajectory=turned)[0])
