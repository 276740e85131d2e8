"""Straight lines of the tool."""

import numpy as np
import pytest

from regrasp_opt.conventions import rotation_angle
from regrasp_opt.motion.trajectory.cartesian_path import SPACING, line
from regrasp_opt.motion.trajectory.time_parameterization import through


@pytest.fixture
def robot(bottle_problem):
    return bottle_problem.workcell.robot


@pytest.mark.parametrize("direction", [(0, 0, -1), (1, 0, 0), (0.6, 0.0, 0.8)])
def test_the_tool_moves_straight_and_does_not_turn(robot, direction):
    direction = np.array(direction, dtype=float)
    waypoints = line(robot, robot.home, direction, 0.1)
    assert np.array_equal(waypoints[0], robot.home) and len(waypoints) == round(0.1 / SPACING) + 1
    start = robot.forward(robot.home)
    T = robot.forward(through(waypoints)(np.linspace(0, 1, 301)))  # between the waypoints as well
    moved = T[:, :3, 3] - start[:3, 3]
    along = moved @ direction
    assert np.linalg.norm(moved - along[:, None] * direction, axis=1).max() < 1e-5
    assert rotation_angle(start[:3, :3].T @ T[:, :3, :3]).max() < 1e-4
    assert along[-1] == pytest.approx(0.1, abs=1e-8) and (np.diff(along) > 0).all()


def test_a_line_that_leaves_the_reach_is_none(robot):
    assert line(robot, robot.home, np.array([0.0, 1.0, 0.0]), 0.6) is None


def test_a_line_that_leaves_the_joint_limits_is_none(robot):
    q = line(robot, robot.home, np.array([0.0, 0.0, -1.0]), 0.1)[-1]
    moving = np.argmax(np.abs(q - robot.home))
    assert np.abs(q - robot.home)[moving] > 0.05
    narrow = robot.upper.copy()
    narrow[moving] = robot.home[moving] + 0.01
    low = robot.lower.copy()
    low[moving] = robot.home[moving] - 0.01
    from dataclasses import replace

    assert line(replace(robot, lower=low, upper=narrow), robot.home, np.array([0.0, 0.0, -1.0]), 0.1) is None
