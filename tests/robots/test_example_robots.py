"""Robots that others wrote: each one of example-robot-data is an arm up to some tip, or is refused for a true reason.

`python tests/robots/test_example_robots.py` loads all of them, with what is said about them.
"""

import sys
from pathlib import Path

import pytest
from arms import FOREIGN

from regrasp_opt.errors import WorkcellError
from regrasp_opt.robots import load_robot
from regrasp_opt.robots.urdf import read_urdf

ARMS = {
    "a1": ("FR_foot", 3),
    "alex_nub_hands": ("rightNub", 10),
    "alex_psyonic_hands": ("RightWristYawIMULink", 8),
    "alex_sake_hands": ("LeftWristYawIMULink", 8),
    "alexander_v1.lowerBodyOnly": ("LEFT_FOOT_IMU_LINK", 6),
    "allegro_left_hand": ("link_15.0_tip", 4),
    "allegro_right_hand": ("link_15.0_tip", 4),
    "anymal": ("LF_FOOT", 3),
    "anymal-kinova": ("j2s6s200_end_effector", 6),
    "b1": ("FR_foot", 3),
    "b1-z1": ("gripperMover", 7),
    "baxter": ("right_gripper", 7),
    "bolt": ("FR_FOOT", 3),
    "borinot_flying_arm_2": (None, 2),
    "centauro": ("arm1_8", 7),
    "double_pendulum_continuous": (None, 2),
    "finger_edu": (None, 3),
    "g1_29dof_rev_1_0": ("right_rubber_hand", 10),
    "g1_29dof_with_hand_rev_1_0": ("right_wrist_yaw_link", 10),
    "go1": ("FR_foot", 3),
    "go2": ("FR_foot", 3),
    "hextilt_flying_arm_5": (None, 5),
    "human": ("right_hand", 13),
    "hyq_no_sensors": ("lf_foot", 3),
    "icub": ("r_gripper", 10),
    "icub_reduced": ("l_gripper", 10),
    "kinova": ("j2s6s200_end_effector", 6),
    "laikago": ("FR_foot", 3),
    "panda": ("panda_hand_tcp", 7),
    "panda_collision": ("panda_hand_tcp", 7),
    "pr2": ("r_gripper_tool_frame", 8),
    "romeo": ("r_gripper", 8),
    "romeo_laas_small": ("r_gripper", 9),
    "romeo_small": ("r_gripper", 8),
    "simple_humanoid": ("r_wrist", 10),
    "simple_humanoid_classical": ("r_wrist", 10),
    "so100": ("gripper", 5),
    "so101": ("gripper_frame_link", 5),
    "solo": ("FL_FOOT", 2),
    "solo12": ("FL_FOOT", 3),
    "talos_full_v2": ("gripper_left_base_link", 9),
    "talos_full_v2_box": ("gripper_left_base_link", 9),
    "talos_left_arm": (None, 6),
    "talos_reduced": ("gripper_left_base_link", 9),
    "talos_reduced_box": ("gripper_left_base_link", 9),
    "talos_reduced_corrected": ("gripper_left_base_link", 9),
    "tiago": ("hand_tool_link", 8),
    "tiago_dual": ("arm_left_tool_link", 8),
    "tiago_no_hand": ("wrist_ft_tool_link", 8),
    "tiago_pro": ("arm_left_tool_link", 8),
    "TwoDofs": (None, 2),
    "ur10_joint_limited_robot": (None, 6),
    "ur10_robot": (None, 6),
    "ur3_gripper": (None, 6),
    "ur3_joint_limited_robot": (None, 6),
    "ur3_robot": (None, 6),
    "ur5_gripper": (None, 6),
    "ur5_joint_limited_robot": (None, 6),
    "ur5_robot": (None, 6),
    "xarm7": (None, 7),
    "z1": (None, 6),
}
"""Tip and number of joints of what is an arm, by the name of its file."""

REFUSED = {
    "double_pendulum": (None, "joint 'joint1' needs a <limit> with finite lower and upper"),
    "double_pendulum_simple": (None, "joint 'joint1' needs a <limit> with finite lower and upper"),
    "iris": ("iris__rotor_0", "turns from -1e+16 to 1e+16 rad"),
    "iris_simple": (None, "no moving joint leads to the tip 'iris__base_link'"),
    "quadrotor_base": (None, "no moving joint leads to the tip 'base_link'"),
    "quadruped": ("FL_contact", "joint 'FL_KFE' needs a <limit> with finite lower and upper"),
    "ur3": (None, "has no <robot> with links"),
}
"""Tip and reason of what is not."""

LARGE = {f"alex_{hands}_hands" for hands in ("nub", "psyonic", "sake")} | {
    "g1_29dof_rev_1_0",
    "g1_29dof_with_hand_rev_1_0",
    "so101",
}
"""Robots with hundreds of thousands of triangles, left to the command."""

FILES = sorted(FOREIGN.rglob("*.urdf"))


def load(file, tip):
    return load_robot(file, tip=tip, package_dirs=[FOREIGN.parents[1]])


def assert_loads(file):
    tip, dof = ARMS[file.stem]
    robot = load(file, tip)
    assert robot.dof == dof and (tip is None or robot.tip_frame == tip)
    assert robot.collision.ngeoms == len(read_urdf(file).findall("link/collision"))
    joints = [item.parentJoint for item in robot.collision.geometryObjects]
    assert all(joints[i] != joints[j] for i, j in robot.self_collision_pairs())
    return robot


def test_the_tables_hold_all_files():
    assert {file.stem for file in FILES} == ARMS.keys() | REFUSED.keys() and len(FILES) > 60


@pytest.mark.parametrize("file", [f for f in FILES if f.stem in ARMS.keys() - LARGE], ids=lambda file: file.stem)
def test_arms_load_with_all_their_bodies(file):
    assert_loads(file)


@pytest.mark.parametrize("file", [f for f in FILES if f.stem in REFUSED], ids=lambda file: file.stem)
def test_what_is_not_an_arm_is_refused_for_its_reason(file):
    tip, reason = REFUSED[file.stem]
    with pytest.raises(WorkcellError) as info:
        load(file, tip)
    assert reason in str(info.value) and "\n" not in str(info.value)


if __name__ == "__main__":
    for path in FILES:
        if path.stem in ARMS:
            arm = assert_loads(path)
            print(f"{path.stem}: {arm.dof} joints to {arm.tip_frame}, {arm.collision.ngeoms} bodies", flush=True)
        else:
            try:
                sys.exit(f"{path.stem} is loaded: {load(path, REFUSED[path.stem][0])}")
            except WorkcellError as error:
                print(f"{Path(path).stem}: {error}", flush=True)
