"""Shelves, tilted boards and nests: the verifiers accept what is done with them, and notice every kind of damage."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from verifying import motion_findings, support_of

from oracles.files import read_cell
from oracles.plans import PlanVerifier
from regrasp_opt import RegraspProblem, load_workcell, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.motion import Phase, plan_motion
from regrasp_opt.motion.trajectory.cartesian_path import line
from regrasp_opt.motion.trajectory.time_parameterization import through
from regrasp_opt.motion.trajectory.trajectory import Trajectory
from regrasp_opt.objects import load_object
from regrasp_opt.planning.pose_text import parse_pose

SCENES = Path(__file__).parents[2] / "docs" / "scenes"
RACK = """name = "near cheek", position = [0.06, -0.04, 0.035]"""
ROOF = """
[[supports]]
name = "roof"
height = {}
center = [0.32, 0.38]
size = [0.3, 0.4]
thickness = 0.02
"""
PLATE = """schema = 2
[[arms]]
robot = "nova2"
end_effector = "w"
[[supports]]
name = "table"
center = [0.0, 0.35]
size = [0.5, 0.7]
[[supports]]
name = "plate"
height = 0.15
center = [0.4, 0.35]
size = [0.24, 0.24]
rpy = [{}, 0.0, 0.3]
friction = {}
"""


@pytest.fixture(scope="module")
def plan():
    """Return a plan out of a rack into a cup, by way of the shelf."""
    problem = RegraspProblem.load("bottle", SCENES / "shelf-between.toml")
    ends = [parse_pose(text, "end", problem) for text in ("rack/lying", "cup/upright")]
    found = solve_sequence(problem, *ends)
    assert [station.support for station in found.stations] == ["rack", "shelf", "cup"]
    return found


@pytest.fixture(scope="module")
def content(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    plan.save(path)
    return json.loads(path.read_text("utf-8"))


@pytest.fixture(scope="module")
def verifier(content):
    return PlanVerifier(content)


@pytest.fixture(scope="module")
def moved(plan):
    motion = plan_motion(plan)
    assert motion.solved, motion.reason
    return motion


def first(count):
    return range(min(count, 1))


def test_files_say_what_the_package_reads(tmp_path):
    (tmp_path / "plate.toml").write_text(PLATE.format(0.17, 0.5), encoding="utf-8")
    for path in (*SCENES.glob("*.toml"), tmp_path / "plate.toml"):
        mine = read_cell({"source": str(path), "name": path.stem}).supports
        for one, other in zip(mine, map(support_of, load_workcell(path).supports), strict=True):
            for a, b in zip(one.bodies, other.bodies, strict=True):
                assert (a.name, a.kind) == (b.name, b.kind) and np.allclose([*a.size], [*b.size])
                np.testing.assert_allclose(a.T, b.T, atol=1e-9)
            if hasattr(one, "poses"):
                assert all(
                    np.allclose(a[0], b[0]) and a[1] == b[1] for a, b in zip(one.poses, other.poses, strict=True)
                )
            else:
                np.testing.assert_allclose(one.seen(np.eye(3)), other.seen(np.eye(3)), atol=1e-9)
                assert all(np.allclose(one.space[axis], other.space[axis]) for axis in "xy")


def test_a_plan_over_several_supports_has_no_fault(content, verifier):
    assert verifier.problems(content) == []
    assert content["supports"] == ["shelf"]


def test_each_claim_about_a_support_is_judged(content, verifier):
    for change, said in (
        ({"supports": ["rack"]}, "off what rack holds"),
        ({"supports": ["attic"]}, "pose 1: there is no support 'attic'"),
        ({"supports": []}, "0 supports are named for 3 poses"),
    ):
        found = verifier.problems({**content, **change}, first)
        assert any(said in text for text in found), found
    poses = np.array(content["poses"])
    for number, move, said in (
        (0, (0.0, 1e-5, 0.0), "pose 0: it is 1e-05 off what rack holds"),
        (2, (0.0, 0.0, 1e-5), "pose 2: it is 1e-05 off what cup holds"),
        (1, (0.0, 0.0, 2e-5), "pose 1: it is 2e-05 m above the shelf"),
        (1, (0.0, 0.0, -0.12), "pose 1: it is -0.12 m above the shelf"),
        (1, (0.2, 0.0, 0.0), "pose 1: it stands over the edge of the shelf"),
        (1, (0.2, 0.0, 0.0), "pose 1: its centre of mass is outside the workspace in x"),
    ):
        wrong = poses.copy()
        wrong[number, :3, 3] += move
        found = verifier.problems({**content, "poses": wrong.tolist()}, first)
        assert said in found, found


def changed_cell(content, folder, *changes, more=""):
    """Return a verifier of the same plan in a cell whose file was changed afterwards."""
    text = Path(content["workcell"]["source"]).read_text("utf-8")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "cell.toml").write_text(text.replace("\n[[obstacles]]", more + "\n[[obstacles]]"), encoding="utf-8")
    return PlanVerifier({**content, "workcell": {**content["workcell"], "source": str(folder / "cell.toml")}})


@pytest.mark.parametrize(
    ("changes", "more", "said"),
    [
        ([('"lying", position = [-0.1,', '"lying", position = [-0.099,')], "", "it is 0.001 off what rack holds"),
        ([('object = "bottle"', 'object = "mug"')], "", "pose 0: it is"),
        ([(RACK, RACK.replace("-0.04", "-0.033"))], "", "object and rack near cheek are -0.002"),
        ([("height = 0.12", "height = 0.13")], "", "pose 1: it is -0.01 m above the shelf"),
        ([('name = "shelf"', 'name = "shelf"\nrpy = [0.02, 0.0, 0.0]')], "", "m above the shelf"),
        ([("size = [0.3, 0.4]", "size = [0.1, 0.1]")], "", "pose 1: it stands over the edge of the shelf"),
        ([], ROOF.format(0.2), "pose 1: object and roof are"),
        ([], ROOF.format(0.3), "and roof are"),
        ([], ROOF.format(0.08).replace("0.32, 0.38", "0.0, 0.45"), "pose 2: object and roof are"),
    ],
)
def test_changes_of_the_cell_are_noticed(content, tmp_path, changes, more, said):
    found = changed_cell(content, tmp_path, *changes, more=more).problems(content, first)
    assert any(said in text for text in found), found


def test_a_nest_may_be_touched_but_not_entered(content, tmp_path):
    """The bottle is 5 mm from the cheek of the rack."""
    pose = np.array(content["poses"][0])
    for to, free in (("-0.036", True), ("-0.0345", True), ("-0.0335", False)):
        found = changed_cell(content, tmp_path, (RACK, RACK.replace("-0.04", to))).pose_problems(pose)
        assert (found == []) is free, found
    beside = changed_cell(content, tmp_path, more=ROOF.format(0.08).replace("0.32, 0.38", "-0.25, 0.19"))
    assert beside.pose_problems(pose) == []  # a board below the bottle, whose plane it is above


@pytest.mark.parametrize(
    ("tilt", "friction", "said"),
    [(0.17, 0.5, None), (0.17, 0.15, "it would slide off the plate"), (0.44, 0.5, "it would tip over")],
)
def test_gravity_is_seen_on_a_tilted_board(tmp_path, tilt, friction, said):
    """A standing bottle, 2 cm from where the plate is highest; its margin is 0.41."""
    (tmp_path / "plate.toml").write_text(PLATE.format(tilt, friction), encoding="utf-8")
    cell = read_cell({"source": str(tmp_path / "plate.toml"), "name": "plate"})
    body = load_object("bottle")
    verifier = PlanVerifier(None, cell, (np.array(body.vertices), np.array(body.faces)), name="bottle")
    T = cell.supports[1].T @ translation(0.04, 0.05, 0.0)
    found = verifier.pose_problems(T, exact=True)
    assert found == ([said] if said else []), found
    assert verifier.pose_problems(T, name="table")[0].startswith("it is 0.1")
    off = verifier.pose_problems(T @ translation(0.08, 0.0, 0.0))
    assert "its centre of mass is outside the workspace in x" in off


COARSE = {"step": 5e-3, "turn": np.deg2rad(2.0)}
"""The faults below are larger."""


def with_lift(motion, transition, move):
    """Return what is found where the lift begins with a straight move (3,) in the base frame, and back."""
    segments = list(motion.segments)
    number = next(n for n, s in enumerate(segments) if (s.phase, s.transition) == (Phase.LIFT, transition))
    lift, robot = segments[number].trajectory, motion.plan.problem.workcell.robot
    length = float(np.linalg.norm(move))
    there = through(line(robot, lift.positions[0], np.array(move) / length, length))(np.linspace(0, 1, 20))
    positions = np.concatenate([there, there[::-1][1:], lift.positions[1:]])
    slow = Trajectory(np.linspace(0, 30, len(positions)), positions, np.zeros_like(positions))
    segments[number] = replace(segments[number], trajectory=slow)
    return " | ".join(motion_findings(replace(motion, segments=tuple(segments)), **COARSE).problems)


def test_a_motion_over_several_supports_has_no_fault(moved):
    found = motion_findings(moved, **COARSE)
    assert found.problems == [] and found.collisions == 0


def test_ways_through_supports_are_noticed(moved):
    assert "transition 0, lift: object sinks into rack near cheek" in with_lift(moved, 0, (0.0, -0.02, 0.0))
    assert "transition 1, lift: object sinks into shelf" in with_lift(moved, 1, (0.0, 0.0, -0.02))


def test_other_supports_are_kept_clear_of_while_an_object_is_lifted(moved, tmp_path):
    """A board is put over the shelf afterwards, where the object is lifted to."""
    text = (SCENES / "shelf-between.toml").read_text("utf-8")
    (tmp_path / "cell.toml").write_text(text.replace("\n[[obstacles]]", ROOF.format(0.24) + "\n[[obstacles]]"))
    cell = load_workcell(tmp_path / "cell.toml")
    plan = replace(moved.plan, problem=replace(moved.plan.problem, workcell=cell))
    found = " | ".join(motion_findings(replace(moved, plan=plan), **COARSE).problems)
    assert "transition 0, lower: object meets roof" in found and "transition 1, lift: object meets roof" in found
