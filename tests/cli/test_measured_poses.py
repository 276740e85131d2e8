"""`plan` with measured poses, quaternions, symmetric objects and mass properties, as they are typed."""

import json

import numpy as np
import pytest
from command import assert_refused, in_process
from scipy.spatial.transform import Rotation

GOAL = "0:-0.2,0.35,0"


@pytest.fixture
def measured(bottle_problem):
    """A pose of the bottle that is 1 degree off, and has its centre of mass 1.7 mm too high."""
    T = bottle_problem.pose(1, 0.2, 0.35, 0.4)
    T[:3, :3] = T[:3, :3] @ Rotation.from_euler("x", 1.0, degrees=True).as_matrix()
    T[2, 3] += 0.003
    return T


def quaternion(T, order="xyzw"):
    numbers = Rotation.from_matrix(T[:3, :3]).as_quat()
    return {"position": T[:3, 3].tolist(), f"quaternion_{order}": np.roll(numbers, order == "wxyz").tolist()}


def test_every_form_of_a_measured_pose_gives_the_same_plan(capsys, tmp_path, measured):
    file = tmp_path / "pose.json"
    file.write_text(json.dumps(measured.tolist()), "utf-8")
    forms = [
        file,
        json.dumps(measured.tolist()),
        json.dumps(quaternion(measured)),
        json.dumps(quaternion(measured, "wxyz")),
    ]
    plans = [in_process(capsys, "plan", "--start", form, "--goal", GOAL, "--json").data for form in forms]
    for plan in plans:
        assert plan["status"] == "solved" and len(plan["remarks"]) == 1
        assert plan["remarks"][0].startswith("the start was measured 1.7 mm and 1.0 degrees")
        np.testing.assert_allclose(plan["poses"], plans[0]["poses"], atol=1e-6)


def test_plan_check_and_show_say_what_was_measured(capsys, tmp_path, measured):
    pose, plan, page = json.dumps(measured.tolist()), tmp_path / "plan.json", tmp_path / "page.html"
    made = in_process(capsys, "plan", "--start", pose, "--goal", GOAL, "--out", plan)
    checked = in_process(capsys, "check", plan)
    for outcome in (made, checked):
        assert outcome.code == 0 and "note: the start was measured 1.7 mm and 1.0 degrees" in outcome.out
    assert in_process(capsys, "check", plan, "--json").data["remarks"]
    assert in_process(capsys, "show", plan, "--html", page).code == 0
    assert "the start was measured 1.7 mm and 1.0 degrees" in page.read_text("utf-8")
    assert in_process(capsys, "plan", "--start", pose, "--json").data["status"] == "solved"  # the goal is drawn


def test_the_tolerance_is_in_metres_and_degrees(capsys, measured):
    pose = json.dumps(measured.tolist())
    refused = in_process(capsys, "plan", "--start", pose, "--goal", GOAL, "--tolerance", "0.001,5")
    assert_refused(refused, "the nearest resting pose is 1:0.200,0.350,")
    assert_refused(
        in_process(capsys, "plan", "--start", pose, "--tolerance", "0.004,0.5"), "the nearest resting pose is"
    )
    for text in ("0.002", "a,b", "0.1,-3", "nan,1"):
        assert_refused(in_process(capsys, "plan", "--tolerance", text), "tolerance is ")


BAD = {
    "keys": ({"position": [0, 0, 0], "quaternion": [0, 0, 0, 1]}, "has the keys position, quaternion; give 'position'"),
    "both": ({"position": [0] * 3, "quaternion_xyzw": [0, 0, 0, 1], "quaternion_wxyz": [1, 0, 0, 0]}, "has the keys"),
    "zero": (
        {"position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 0]},
        "quaternion of length 0; give a unit",
    ),
    "short": ({"position": [0, 0], "quaternion_xyzw": [0, 0, 0, 1]}, "needs 3 numbers as its position"),
    "text": ({"position": "here", "quaternion_xyzw": [0, 0, 0, 1]}, "is not a number"),
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_no_quaternion_is_refused(capsys, name):
    pose, said = BAD[name]
    assert_refused(in_process(capsys, "plan", "--start", json.dumps(pose)), said)


def test_json_that_is_cut_short_is_refused(capsys):
    assert_refused(in_process(capsys, "plan", "--start", '{"position": [0'), "is not valid JSON; give four rows")


def test_symmetry_is_said(capsys):
    ends = ("--start", "0:0.2,0.35,0", "--goal", "2:-0.2,0.35,0")
    plain, free = (in_process(capsys, "plan", *ends, *more, "--json").data for more in ((), ("--symmetry",)))
    assert "remarks" not in plain and free["num_regrasps"] <= plain["num_regrasps"]
    assert_refused(
        in_process(capsys, "plan", "--object", "mug", "--symmetry"), "'mug' has no axis of rotational symmetry"
    )


def test_mass_properties_are_typed(capsys):
    options = ("--mass", "0.4", "--center-of-mass", "0,0,0.04", "--inertia", "1e-3,0,0,1e-3,0,2e-4")
    data = in_process(capsys, "inspect", "--object", "bottle", *options, "--json").data["object"]
    assert data["mass"] == 0.4 and data["center_of_mass"] == [0.0, 0.0, 0.04]
    np.testing.assert_allclose(data["inertia"], np.diag([1e-3, 1e-3, 2e-4]))
    np.testing.assert_allclose(np.square(data["radii_of_gyration"]) * 0.4, [2e-4, 1e-3, 1e-3])
    assert data["mass_properties_given"] == ["center_of_mass", "inertia", "mass"]
    shown = in_process(capsys, "inspect", "--object", "bottle", *options).out
    assert "0.400 kg" in shown and "0.0, 0.0, 40.0 mm in the frame of the mesh, as given" in shown
    assert_refused(in_process(capsys, "inspect", "--object", "bottle", "--center-of-mass", "0,0"), "give 3 numbers")
    assert_refused(
        in_process(capsys, "prepare", "nova2-w", "--mass", "1"), "--mass has no meaning for the energy of an arm"
    )
