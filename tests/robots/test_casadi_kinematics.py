"""CasADi kinematics of many arms, held to Pinocchio."""

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from arms import FOREIGN, MIXED, arm_urdf
from derivatives import assert_derivative

from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.robots.casadi_kinematics import (
    flange_jacobian,
    forward_kinematics,
    frame_jacobian,
    frame_kinematics,
    link_kinematics,
)

MODELS = {
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
    "panda": "panda_description/urdf/panda.urdf",
    "kinova": "kinova_description/robots/kinova.urdf",
    "xarm7": "xarm_description/urdf/xarm7.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "pr2": "pr2_description/urdf/pr2.urdf",
    "baxter": "baxter_description/urdf/baxter.urdf",
    "allegro": "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "solo": "solo_description/robots/solo12.urdf",
    "pendulum": "double_pendulum_description/urdf/double_pendulum.urdf",
}
LWA = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


def mixed_model():
    """Return a model with slanted revolute, prismatic and helical axes, and unbounded joints."""
    slanted = ("continuous", "0.1 0.2 0.3", "0.4 0.5 0.6", "0.6 0 0.8", None)
    model = pin.buildModelFromXML(arm_urdf([*MIXED, slanted]))
    assert "JointModelRevoluteUnboundedUnaligned" in {joint.shortname() for joint in model.joints}
    rng = np.random.default_rng(7)
    axis = np.array([0.6, 0.0, 0.8])
    kinds = [
        pin.JointModelPrismaticUnaligned(axis),
        pin.JointModelHelicalUnaligned(axis, 0.05),
        pin.JointModelHX(0.1),
        pin.JointModelRUBX(),
        pin.JointModelRUBY(),
        pin.JointModelPY(),
        pin.JointModelRevoluteUnaligned(axis),
    ]
    parent = model.njoints - 1
    for k, kind in enumerate(kinds):
        placement = pin.SE3(pin.Quaternion(rng.normal(size=4)).normalized(), rng.normal(size=3))
        parent = model.addJoint(parent, kind, placement, f"extra{k}")
        model.addFrame(pin.Frame(f"tool{k}", parent, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    return model


def load(name):
    if name == "mixed":
        return mixed_model()
    if name == "manipulator":
        return pin.buildSampleModelManipulator()
    return pin.buildModelFromUrdf(str(FOREIGN / MODELS[name]))


def configurations(model, count):
    """Return random configurations, several turns wide where a joint has no limits."""
    rng = np.random.default_rng(3)
    return [pin.integrate(model, pin.neutral(model), rng.uniform(-3, 3, model.nv)) for _ in range(count)]


@pytest.mark.parametrize("name", [*MODELS, "mixed", "manipulator"])
def test_every_frame_and_joint_and_jacobian_is_pinocchios(name):
    model = load(name)
    data = model.createData()
    frames = [frame.name for frame in model.frames]
    links = link_kinematics(model)
    chosen = [frames[1], frames[len(frames) // 2], frames[-1]]
    poses = {frame: frame_kinematics(model, frame) for frame in chosen}
    jacobians = {frame: frame_jacobian(model, frame) for frame in chosen}
    for q in configurations(model, 5):
        pin.framesForwardKinematics(model, data, q)
        pin.computeJointJacobians(model, data, q)
        expected = np.hstack([placement.homogeneous for placement in list(data.oMi)[1:]])
        np.testing.assert_allclose(np.array(links(q)), expected, rtol=0, atol=1e-10)
        for frame in chosen:
            index = model.getFrameId(frame)
            np.testing.assert_allclose(poses[frame](q), data.oMf[index].homogeneous, rtol=0, atol=1e-10)
            expected = pin.getFrameJacobian(model, data, index, LWA)
            np.testing.assert_allclose(jacobians[frame](q), expected, rtol=0, atol=1e-10)


def test_forward_kinematics_of_our_robots(any_robot):
    fk, jacobian = forward_kinematics(any_robot), flange_jacobian(any_robot)
    assert (fk.name_in(), fk.name_out()) == (["q"], ["T"])
    q = np.random.default_rng(4).uniform(any_robot.lower, any_robot.upper, (20, any_robot.dof))
    for value, expected in zip(q, any_robot.forward(q), strict=True):
        np.testing.assert_allclose(fk(value), expected, rtol=0, atol=1e-10)
    assert_derivative(lambda x: np.array(fk(x))[:3, 3], np.array(jacobian(q[0]))[:3], q[0])


def test_derivatives_of_the_function_are_the_jacobian(nova2):
    q = ca.MX.sym("q", 6)
    T = forward_kinematics(nova2)(q)
    derivative = ca.Function("d", [q], [ca.jacobian(T[:3, 3], q)])
    value = np.random.default_rng(5).uniform(-2, 2, 6)
    np.testing.assert_allclose(derivative(value), np.array(flange_jacobian(nova2)(value))[:3], rtol=0, atol=1e-12)


def test_functions_can_be_mapped_and_saved(nova2, tmp_path):
    fk = forward_kinematics(nova2)
    fk.save(str(tmp_path / "fk.casadi"))
    q = np.random.default_rng(6).uniform(-2, 2, (6, 3))
    stacked = np.array(ca.Function.load(str(tmp_path / "fk.casadi")).map(3)(q))
    np.testing.assert_array_equal(stacked[:, 4:8], fk(q[:, 1]))


def test_unknown_frames_and_joints_are_named():
    with pytest.raises(UnknownNameError, match="unknown frame 'tol0'; known: tool0"):
        frame_kinematics(mixed_model(), "tol0")
    with pytest.raises(WorkcellError, match="JointModelFreeFlyer; use revolute"):
        link_kinematics(pin.buildSampleModelHumanoid())
