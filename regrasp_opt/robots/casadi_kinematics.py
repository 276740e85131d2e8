"""Forward kinematics and Jacobians of any fixed-base Pinocchio model as CasADi functions.

The product of joint placements and screw motions, ``T_base_joint = T_base_parent @ T_parent_joint(0) @ exp(S q)``
(Lynch and Park, Modern Robotics, section 4.1), with every number taken from the Pinocchio model; tests hold values and
Jacobians to Pinocchio's own. The functions are built from scalars (SX), can be differentiated, mapped, saved and turned
into C, and are called with numbers or with the symbols of a larger problem.

Joints of one degree of freedom are known: revolute, prismatic and helical about any axis, and unbounded revolute ones,
whose two coordinates are (cos, sin) as in Pinocchio.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import UnknownNameError, WorkcellError
from regrasp_opt.robots.robot import Robot


def forward_kinematics(robot: Robot) -> Any:
    """Return the `casadi.Function` ``q`` (dof,) [rad, m] -> ``T`` (4, 4) T_base_flange of `robot`."""
    return frame_kinematics(robot.model, robot.tip_frame)


def flange_jacobian(robot: Robot) -> Any:
    """Return the `casadi.Function` ``q`` (dof,) -> ``J`` (6, dof) of the flange of `robot`; see `frame_jacobian`."""
    return frame_jacobian(robot.model, robot.tip_frame)


def frame_kinematics(model: pin.Model, frame: str) -> Any:
    """Return the `casadi.Function` ``q`` (nq,) -> ``T`` (4, 4), the pose of `frame` in the base frame of `model`.

    Raises
    ------
    UnknownNameError
        If `model` has no frame of that name.
    WorkcellError
        If a joint of `model` has more than one degree of freedom, or mimics another.
    """
    q = ca.SX.sym("q", model.nq)
    joint, T_joint_frame = _frame(model, frame)
    T = joint_placements(model, q)[joint] @ ca.SX(ca.DM(T_joint_frame))
    return ca.Function("forward_kinematics", [q], [T], ["q"], ["T"])


def link_kinematics(model: pin.Model) -> Any:
    """Return the `casadi.Function` ``q`` (nq,) -> ``T`` (4, 4 n), the poses of all n moving joint frames side by side.

    They are in the base frame and in Pinocchio's order, its universe joint left out: the placement of joint k is
    ``T[:, 4 * (k - 1) : 4 * k]``.

    Raises
    ------
    WorkcellError
        If a joint of `model` has more than one degree of freedom, or mimics another.
    """
    q = ca.SX.sym("q", model.nq)
    return ca.Function("link_kinematics", [q], [ca.horzcat(*joint_placements(model, q)[1:])], ["q"], ["T"])


def frame_jacobian(model: pin.Model, frame: str) -> Any:
    """Return the `casadi.Function` ``q`` (nq,) -> ``J`` (6, nv) of the frame named `frame` of `model`.

    ``J v`` is the velocity of the frame's origin [m/s], then the frame's angular velocity [rad/s], both along the axes
    of the base frame (Pinocchio's LOCAL_WORLD_ALIGNED).

    Raises
    ------
    UnknownNameError
        If `model` has no frame of that name.
    WorkcellError
        If a joint of `model` has more than one degree of freedom, or mimics another.
    """
    q = ca.SX.sym("q", model.nq)
    joint, T_joint_frame = _frame(model, frame)
    placements = joint_placements(model, q)
    origin = (placements[joint] @ ca.SX(ca.DM(T_joint_frame)))[:3, 3]
    J = ca.SX(6, model.nv)
    subspaces = _motion_subspaces(model)
    for k in list(model.supports[joint])[1:]:
        R, p = placements[k][:3, :3], placements[k][:3, 3]
        linear, angular = R @ ca.SX(ca.DM(subspaces[k][:3])), R @ ca.SX(ca.DM(subspaces[k][3:]))
        J[:, model.idx_vs[k]] = ca.vertcat(linear + ca.cross(angular, origin - p), angular)
    return ca.Function("jacobian", [q], [J], ["q"], ["J"])


def joint_placements(model: pin.Model, q: Any) -> list[Any]:
    """Return the poses (4, 4) of all joint frames in the base frame as expressions of `q` (nq,), the universe's first.

    Raises
    ------
    WorkcellError
        If a joint of `model` has more than one degree of freedom, or mimics another.
    """
    placements = [ca.SX.eye(4)]
    subspaces = _motion_subspaces(model)
    for k in range(1, model.njoints):
        T_parent_joint = ca.SX(ca.DM(model.jointPlacements[k].homogeneous))
        first = model.idx_qs[k]
        motion = _screw(subspaces[k], q[first : first + model.nqs[k]])
        placements.append(placements[model.parents[k]] @ T_parent_joint @ motion)
    return placements


def _frame(model: pin.Model, name: str) -> tuple[int, FloatArray]:
    """Return the joint that carries the frame `name`, and its pose (4, 4) in that joint's frame."""
    if not model.existFrame(name):
        raise UnknownNameError("frame", name, {frame.name for frame in model.frames})
    frame = model.frames[model.getFrameId(name)]
    return int(frame.parentJoint), np.array(frame.placement.homogeneous)


def _motion_subspaces(model: pin.Model) -> list[FloatArray]:
    """Return the screw axis (6,) of each joint in its own frame, linear part first; zeros for the universe."""
    for joint, name in list(zip(model.joints, model.names, strict=True))[1:]:
        if joint.nv != 1 or joint.nq > 2 or joint.shortname() == "JointModelMimic":
            raise WorkcellError(
                f"joint '{name}' is a {joint.shortname()}; use revolute, prismatic or helical joints on a fixed base"
            )
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    columns = [pin.getJointJacobian(model, data, k, pin.ReferenceFrame.LOCAL) for k in range(1, model.njoints)]
    axes = [J.reshape(6, -1)[:, model.idx_vs[k]] for k, J in enumerate(columns, start=1)]
    return [np.zeros(6), *(np.where(np.abs(S) < 1e-15, 0.0, S) for S in axes)]


def _screw(S: FloatArray, q: Any) -> Any:
    """Return ``exp(S q)`` (4, 4) of a screw axis (6,) whose two parts are parallel; `q` is (1,), or (cos, sin)."""
    unbounded = q.shape[0] == 2
    linear, angular = S[:3], S[3:]
    T = ca.SX.eye(4)
    if angular.any():
        c, s = (q[0], q[1]) if unbounded else (ca.cos(q), ca.sin(q))
        K = np.array([[0, -angular[2], angular[1]], [angular[2], 0, -angular[0]], [-angular[1], angular[0], 0]])
        T[:3, :3] = ca.SX.eye(3) + s * ca.SX(ca.DM(K)) + (1 - c) * ca.SX(ca.DM(K @ K))
    if linear.any():
        T[:3, 3] = ca.SX(ca.DM(linear)) * q
    return T
