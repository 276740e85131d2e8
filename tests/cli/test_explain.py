"""What the command line says where there is no plan, of one pose, and of an object that no grasp fits."""

import pytest
import trimesh
from command import in_process

FAR, GOAL = ("--start", "0:-0.44,0.59,30"), ("--goal", "1:0.28,0.38,120")


@pytest.fixture
def patient(monkeypatch):
    """Let no remedy be left out for lack of time."""
    monkeypatch.setattr("regrasp_opt.planning.remedies.Remedies._late", lambda self: False)


def test_a_plan_that_fails_says_why(capsys):
    said = in_process(capsys, "plan", *FAR, *GOAL)
    assert said.code == 1 and not said.err
    first, cause, start, goal, pair, hint = said.out.splitlines()
    assert first == "start_infeasible: no grasp is feasible at the start pose"
    assert cause.startswith("  cause: out of reach; ")
    assert start.startswith("  start 0:-0.440,0.590,30.0: none of 200 grasps feasible; ")
    assert goal.startswith("  goal 1:0.280,0.380,120.0: 16 of 200") and pair.startswith("  start - goal: no shared")
    assert hint == "--explain tries what would help"
    told = in_process(capsys, "plan", *FAR, *GOAL, "--json").data["explanation"]
    assert told["causes"][0]["cause"] == "out_of_reach" and told["remedies"] == []
    assert sum(reason["count"] for reason in told["poses"][0]["failures"]) == 200


def test_what_would_help_is_tried_when_asked_for(capsys, patient):
    told = in_process(capsys, "plan", *FAR, *GOAL, "--explain", "--json").data["explanation"]
    moved = next(r for r in told["remedies"] if r["change"] == "place")
    assert moved["helps"] and told["untried"] == []
    placement = moved["text"].split(" at ")[1]
    solved = in_process(capsys, "plan", "--start", placement, *GOAL, "--refiner", "exact", "--json")
    assert solved.code == 0 and solved.data["num_regrasps"] <= moved["num_regrasps"]


def test_a_refused_pose_is_explained_and_stays_an_error(capsys, patient):
    said = in_process(capsys, "plan", "--start", "0:0.2,0.7,0", *GOAL, "--explain")
    assert said.code == 2 and said.err.count("\n") == 1 and "outside the workspace" in said.err
    assert said.out.startswith("start: pose 0:0.200,0.700,0.0: the given pose is outside the workspace")
    assert "another place helps" in said.out


def test_inspect_explains_one_pose(capsys, patient):
    said = in_process(capsys, "inspect", "--object", "mug", "--pose", "0:-0.44,0.59,30")
    assert said.code == 0 and said.out.startswith("pose 0:-0.440,0.590,30.0: ")
    data = in_process(capsys, "inspect", "--pose", "0:0.2,0.35,30", "--json").data
    assert data["explanation"]["poses"][0]["feasible"] > 0 and data["explanation"]["causes"] == []
    wrong = in_process(capsys, "inspect", "--pose", "9:0.2,0.35,30")
    assert wrong.code == 2 and wrong.err.startswith("error: the pose names placement 9")


def test_inspect_describes_an_object_that_no_grasp_fits(capsys, tmp_path):
    trimesh.creation.box((0.12, 0.13, 0.14)).export(tmp_path / "crate.stl")
    said = in_process(capsys, "inspect", "--object", tmp_path / "crate.stl", "--workcell", "nova2-w")
    assert said.code == 2 and said.err.count("\n") == 1
    assert "it is too wide: opposite sides are at least 120 mm apart, and the gripper takes 94 mm" in said.err
    assert "object crate" in said.out and "workcell nova2-w" in said.out
