"""Forward kinematics of every kind of arm, held to Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from regrasp_opt.robots import load_robot

NOVA2 = load_robot("nova2")


def test_forward_and_link_transforms_agree_with_pinocchio(any_robot):
    rng = np.random.default_rng(1)
    model, data = any_robot.model, any_robot.model.createData()
    q = rng.uniform(any_robot.lower, any_robot.upper, (50, any_robot.dof))
    tips, frames = any_robot.forward(q), any_robot.link_transforms(q)
    for k in range(len(q)):
        pin.framesForwardKinematics(model, data, q[k])
        np.testing.assert_allclose(tips[k], data.oMf[model.getFrameId(any_robot.tip_frame)].homogeneous, atol=1e-12)
        np.testing.assert_allclose(frames[k], [placement.homogeneous for placement in list(data.oMi)[1:]], atol=1e-12)


@given(st.lists(st.floats(-7, 7), min_size=6, max_size=6))
def test_forward_of_the_nova2_at_any_angles(q):
    robot = NOVA2
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(q))
    expected = data.oMf[robot.model.getFrameId("flange")].homogeneous
    np.testing.assert_allclose(robot.forward(q), expected, atol=1e-12)


@pytest.mark.parametrize("shape", [(), (3,), (2, 4), (0,)])
def test_batch_shapes(nova2, shape):
    q = np.zeros((*shape, 6))
    assert nova2.forward(q).shape == (*shape, 4, 4)
    assert nova2.link_transforms(q).shape == (*shape, 6, 4, 4)


def test_nova2_at_zero_stands_straight_up_with_the_tool_to_minus_y(nova2):
    T = nova2.forward(np.zeros(6))
    np.testing.assert_allclose(T[:3, 2], (0, -1, 0), atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], (0, -0.1175 - 0.088004, 0.2234 + 0.28 + 0.22501 + 0.12), atol=1e-12)


def test_nova2_at_home_points_the_tool_down_over_the_table(nova2):
    T = nova2.forward(nova2.home)
    np.testing.assert_allclose(T[:3, 2], (0, 0, -1), atol=1e-9)
    np.testing.assert_allclose(T[:3, 3], (0, 0.35, 0.46), atol=0.005)


def test_no_configuration_is_beyond_the_reach(any_robot):
    q = np.random.default_rng(2).uniform(any_robot.lower, any_robot.upper, (2000, any_robot.dof))
    distance = np.linalg.norm(any_robot.forward(q)[:, :3, 3], axis=1)
    assert distance.max() <= any_robot.max_reach
    assert distance.max() > 0.6 * any_robot.max_reach
