"""`plan --grasps FILE` and `prepare --grasps FILE`: grasps of other tools on the command line."""

import grasp_files
import numpy as np
import pytest
from command import assert_refused, in_process
from grasp_files import Z_APPROACH_X_CLOSING, hand_poses, write

from regrasp_opt import RegraspPlan


@pytest.fixture(scope="module")
def files(bottle_problem, tmp_path_factory):
    """Return a folder with files of the same grasps: Isaac's, GraspGen's in millimetres without a frame, and ours."""
    folder = tmp_path_factory.mktemp("grasps")
    T = hand_poses(bottle_problem.grasps.T_object_tcp[::2], 0.1034)
    write(folder / "isaac.yaml", grasp_files.isaac(T, np.ones(len(T)), gripper_frame="/World/panda_hand"))
    turned = hand_poses(bottle_problem.grasps.T_object_tcp[::2], 0.195, Z_APPROACH_X_CLOSING)
    turned[:, :3, 3] *= 1000.0
    write(folder / "graspgen.json", grasp_files.graspgen(turned, np.ones(len(T))))
    bottle_problem.grasps.subset(range(0, 200, 2)).save(folder / "ours.csv")
    return folder


def test_plans_are_made_checked_shown_and_moved_with_given_grasps(capsys, files, tmp_path):
    plan = tmp_path / "plan.json"
    made = in_process(capsys, "plan", "--grasps", files / "isaac.yaml", "--out", plan)
    assert made.code == 0, made.err
    loaded = RegraspPlan.load(plan)
    assert loaded.problem.grasps.names[0].startswith("grasp_")
    assert in_process(capsys, "check", plan).code == 0
    assert in_process(capsys, "show", plan, "--html", tmp_path / "page.html").code == 0
    assert in_process(capsys, "motion", plan, "--out", tmp_path / "motion.json").code == 0


def test_frame_and_unit_can_be_given(capsys, files, tmp_path):
    given = ("--grasps", files / "graspgen.json", "--grasp-frame", "robotiq_2f_140")
    assert_refused(in_process(capsys, "plan", "--grasps", files / "graspgen.json"), "give frame (--grasp-frame)")
    assert_refused(in_process(capsys, "plan", *given), "millimetres; give scale (--grasp-scale) 0.001")
    plan = tmp_path / "plan.json"
    made = in_process(capsys, "plan", *given, "--grasp-scale", "0.001", "--grasp-near", "0.002,3", "--out", plan)
    assert made.code == 0, made.err
    assert 80 < len(RegraspPlan.load(plan).problem.grasps) <= 100
    ours = in_process(capsys, "plan", "--grasps", files / "ours.csv", "--out", plan)
    assert ours.code == 0 and ours.err == ""


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("--grasps", "none.h5"), "none.h5"),
        (("--grasps", "none.csv"), "none.csv is missing"),
        (("--grasps", "grasps.txt"), "has no known suffix"),
        (("--grasps", "none.npz", "--grasp-near", "5"), "--grasp-near is '5'; give METRES,DEGREES"),
        (("--grasp-frame", "acronym"), "belong to a file of grasps; give --grasps"),
        (("--grasp-scale", "0.001"), "belong to a file of grasps; give --grasps"),
    ],
)
def test_bad_options_are_one_line(capsys, arguments, said):
    assert_refused(in_process(capsys, "plan", *arguments), said)
    assert_refused(in_process(capsys, "prepare", "nova2-w", "--object", "bottle", *arguments), said)


def test_prepare_takes_a_file_or_a_number(capsys, files, tmp_path):
    small = ("--object", "bottle", "--samples", "300", "--jobs", "1", "--out", tmp_path / "model", "--json")
    made = in_process(capsys, "prepare", "nova2-w", *small, "--grasps", files / "isaac.yaml")
    assert made.code == 0, made.err
    assert made.data["grasps"] == 100
    refused = in_process(capsys, "prepare", "nova2-w", "--grasp-frame", "tcp")
    assert_refused(refused, "--grasp-frame has no meaning for the energy of an arm")
    assert_refused(in_process(capsys, "prepare", "nova2-w", *small, "--grasps", "0"), "num_grasps 0")
