"""`regrasp-opt motion`: files, tables and exit codes."""

import json

import numpy as np
import pytest
import yaml

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.cli.app import run
from regrasp_opt.motion import MotionPlan, Squeeze
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="module")
def plan_path(tmp_path_factory):
    problem = RegraspProblem.load("bottle", "nova2-w")
    task = random_task(problem, np.random.default_rng(1), needs_regrasp=False)
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    solve_sequence(problem, task.start, task.goal).save(path)
    return path


def test_a_motion_is_written_and_shown(plan_path, tmp_path, capsys):
    out, csv, scene = tmp_path / "motion.json", tmp_path / "motion.csv", tmp_path / "scene"
    assert run(["motion", str(plan_path), "--out", str(out), "--csv", str(csv), "--scene", str(scene)]) == 0
    shown = capsys.readouterr().out
    assert "SOLVED" in shown and "transfer" in shown
    motion = MotionPlan.load(out)
    assert motion.solved and csv.read_text("utf-8").startswith("time,phase,arm,gripper,jaw,joint1")
    assert {p.name for p in scene.iterdir()} >= {"scene.json", "robot.urdf", "gripper.urdf", "object.stl"}


def test_files_for_other_programs(plan_path, tmp_path, capsys):
    ros, moveit, mjcf = tmp_path / "goals.yaml", tmp_path / "scenes.yaml", tmp_path / "model"
    arguments = ["--ros", str(ros), "--moveit", str(moveit), "--mjcf", str(mjcf)]
    assert run(["motion", str(plan_path), *arguments]) == 0
    assert yaml.safe_load(ros.read_text("utf-8"))["arm"] == "nova2"
    assert len(list(yaml.safe_load_all(moveit.read_text("utf-8")))) == 3
    assert {p.name for p in mjcf.iterdir()} >= {"model.xml", "trajectory.csv", "mesh0.obj"}


def test_json_and_options(plan_path, capsys):
    assert run(["motion", str(plan_path), "--json", "--no-home", "--velocity", "0.5", "--acceleration", "2"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["status"] == "solved"
    phases = [segment["phase"] for segment in content["segments"]]
    assert phases == ["approach", "grasp", "lift", "transfer", "lower", "release", "retreat"]
    assert content["duration"] == pytest.approx(sum(s["duration"] for s in content["segments"]))


def test_jerk_and_squeeze_reach_the_file(plan_path, tmp_path):
    out = tmp_path / "motion.json"
    assert (
        run(["motion", str(plan_path), "--out", str(out), "--jerk", "80", "--squeeze", "0.003", "--force", "25"]) == 0
    )
    motion = MotionPlan.load(out)
    assert motion.jerk_limits.tolist() == [80.0] * 6 and motion.squeeze == Squeeze(0.003, 25.0)


def test_no_motion_is_exit_code_one(plan_path, tmp_path, capsys):
    content = json.loads(plan_path.read_text("utf-8"))
    content["status"] = "not_found"
    unsolved = tmp_path / "unsolved.json"
    unsolved.write_text(json.dumps(content), "utf-8")
    files = [tmp_path / name for name in ("motion.csv", "goals.yaml", "scenes.yaml", "model")]
    options = zip(("--csv", "--ros", "--moveit", "--mjcf"), map(str, files), strict=True)
    assert run(["motion", str(unsolved), *(word for option in options for word in option)]) == 1
    assert "NO_PLAN" in capsys.readouterr().out and not any(file.exists() for file in files)


@pytest.mark.parametrize(
    "arguments",
    [
        ["none.json"],
        ["PLAN", "--velocity", "2"],
        ["PLAN", "--acceleration", "-1"],
        ["PLAN", "--seed", "-1"],
        ["PLAN", "--jerk", "0"],
        ["PLAN", "--squeeze", "1"],
        ["PLAN", "--force", "-1"],
    ],
)
def test_bad_input_is_exit_code_two(plan_path, arguments, capsys):
    assert run(["motion", *(str(plan_path) if a == "PLAN" else a for a in arguments)]) == 2
    err = capsys.readouterr().err
    assert err.startswith("error:") and err.count("\n") == 1
