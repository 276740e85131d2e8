"""`inspect`: one page that tells what was understood, the same as data, and a picture."""

from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pytest
import trimesh
from command import assert_refused, in_process

from regrasp_opt import RegraspProblem, load_object, load_workcell

ROBOTS = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
CELL = """
schema = 1
[robot]
model = "{urdf}"
{home}
[end_effector]
model = "{effector}"
[table]
center = [0.4, 0.0]
size = [1.4, 1.4]
[workspace]
x = [0.25, 0.60]
y = [-0.40, 0.40]
[[obstacles]]
type = "box"
name = "shelf"
position = [0.5, 0.4, 0.5]
size = [0.3, 0.02, 0.1]
"""


def cell(tmp_path, urdf, home="", effector="w"):
    path = tmp_path / "cell.toml"
    path.write_text(CELL.format(urdf=Path(urdf).as_posix(), home=home, effector=effector), "utf-8")
    return path


def test_the_page_names_what_matters(capsys):
    outcome = in_process(capsys, "inspect", "--workcell", "nova2-w", "--object", "mug")
    assert outcome.code == 0 and not outcome.err
    robot = load_workcell("nova2-w").robot
    for text in (*robot.joint_names, "flange", "cylinder r 46 x 280", "link1 - link2", "reach at most", "analytic"):
        assert text in outcome.out
    for number, placement in enumerate(load_object("mug").placements):
        assert f" {number} " in outcome.out and f"{placement.margin:.3f}" in outcome.out


def test_json_holds_the_same_numbers(capsys):
    data = in_process(capsys, "inspect", "--json").data
    problem = RegraspProblem.load("bottle", "nova2-w")
    robot = problem.workcell.robot
    np.testing.assert_allclose([j["lower"] for j in data["workcell"]["robot"]["joints"]], robot.lower)
    assert data["workcell"]["robot"]["inverse_kinematics"]["found"] >= 60
    assert sum(len(link["bodies"]) for link in data["workcell"]["robot"]["bodies"]) == robot.collision.ngeoms
    np.testing.assert_allclose(data["object"]["size"], problem.object.mesh.extents)
    np.testing.assert_allclose(
        [p["margin"] for p in data["object"]["placements"]], [p.margin for p in problem.placements]
    )
    assert data["grasps"]["count"] == len(problem.grasps)
    for m, left in enumerate(data["grasps"]["left_by_table"]):
        feasible = [problem.feasible_grasps(problem.pose(m, x, 0.35, yaw)) for x in (0.0, 0.2) for yaw in (0, 2, 4)]
        assert np.any(feasible, axis=0).sum() <= left < len(problem.grasps)


def test_one_of_the_two_alone(capsys):
    data = in_process(capsys, "inspect", "--object", "pentagon", "--json").data
    assert data["workcell"] is None and data["grasps"] is None and len(data["object"]["placements"]) == 7
    data = in_process(capsys, "inspect", "--workcell", "nova2-s1", "--json").data
    assert data["object"] is None and data["workcell"]["end_effector"]["cup_radius"] == pytest.approx(0.0125, abs=0.003)
    assert in_process(capsys, "inspect", "--workcell", "nova2-s1").code == 0


def test_what_rolls_and_what_was_repaired_is_told(tmp_path, capsys):
    trimesh.creation.cylinder(0.03, 0.1, sections=24).export(tmp_path / "can.stl")
    said = in_process(capsys, "inspect", "--object", tmp_path / "can.stl").out
    assert "it rolls there: 24 facet(s), margin at most 0.132" in said and "changes: none" in said
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.03)
    trimesh.Trimesh(ball.vertices, ball.faces[:-1], process=False).export(tmp_path / "ball.stl")
    assert_refused(in_process(capsys, "inspect", "--object", tmp_path / "ball.stl"), "not watertight")
    mended = in_process(capsys, "inspect", "--object", tmp_path / "ball.stl", "--workcell", "nova2-w", "--repair")
    assert mended.code == 0 and "no stable placement" in mended.out
    assert "changes: faces 319 -> 320, volume " in mended.out
    trimesh.util.concatenate([ball, ball.copy().apply_translation((0.025, 0, 0))]).export(tmp_path / "two.stl")
    data = in_process(capsys, "inspect", "--object", tmp_path / "two.stl", "--json").data["object"]
    assert data["changes"]["bodies"] == [2, 1] and data["changes"]["volume"][0] > data["volume"]
    assert not data["repair"] and data["thickness"] is None


@pytest.mark.parametrize(
    ("urdf", "home", "tip", "why"),
    [
        ("ur_description/urdf/ur5_robot.urdf", "home = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]", "tool0", "of that name"),
        ("ur_description/urdf/ur5_robot.urdf", 'tip = "ee_link"\nhome = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]',
         "ee_link", "asked for"),
    ],
)  # fmt: skip
def test_other_robots_and_obstacles(urdf, home, tip, why, tmp_path, capsys):
    path = cell(tmp_path, ROBOTS / urdf, home, "s1")
    data = in_process(capsys, "inspect", "--workcell", path, "--json").data["workcell"]
    assert data["robot"]["tip"]["link"] == tip and why in data["robot"]["tip"]["why"]
    assert data["obstacles"] == [
        {"name": "shelf", "kind": "box", "size": [0.3, 0.02, 0.1], "position": [0.5, 0.4, 0.5]}
    ]
    assert "shelf: box 300 x 20 x 100" in in_process(capsys, "inspect", "--workcell", path).out


def write_arm(path):
    """An arm of six joints with a body on two links, a post that stands still, and a tip of no known name."""
    joints = ["0 0 0.0892", "0 0 0", "-0.425 0 0", "-0.39225 0 0.10915", "0 -0.09465 0", "0 0.0823 0"]
    turns = ["0 0 0", "1.5707963 0 0", "0 0 0", "0 0 0", "1.5707963 0 0", "-1.5707963 0 0"]
    text = '<robot name="sixer"><link name="base"/>'
    for i, (xyz, rpy) in enumerate(zip(joints, turns, strict=True), 1):
        body = '<collision><geometry><sphere radius="0.03"/></geometry></collision>' * 2 if i in (2, 4) else ""
        parent = "base" if i == 1 else f"l{i - 1}"
        text += f'<link name="l{i}">{body}</link><joint name="j{i}" type="revolute"><parent link="{parent}"/>'
        text += f'<child link="l{i}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
        text += '<limit lower="-3" upper="3" velocity="1" effort="1"/></joint>'
    text += '<link name="post"><collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision></link>'
    text += '<joint name="fixed" type="fixed"><parent link="base"/><child link="post"/><origin xyz="0 0.5 0"/></joint>'
    path.write_text(text + "</robot>", "utf-8")


def test_what_stands_still_and_what_has_no_body_is_told(tmp_path, capsys):
    write_arm(tmp_path / "arm.urdf")
    path = cell(tmp_path, tmp_path / "arm.urdf", "home = [0.0, -1.57, 1.57, -1.57, -1.57, 0.0]", "s1")
    robot = in_process(capsys, "inspect", "--workcell", path, "--json").data["workcell"]["robot"]
    assert robot["tip"] == {"link": "l6", "why": "the arm ends there"}
    bodies = {link["link"]: link for link in robot["bodies"]}
    moved_by = {name: link["moved_by"] for name, link in bodies.items()}
    assert moved_by == {"l2": "j2", "l4": "j4", "post": "stands still, an obstacle"}
    assert bodies["post"]["bodies"] == [{"kind": "box", "size": [0.1, 0.2, 0.3]}]
    assert {"l1", "l3", "l5", "l6"} <= set(robot["links_without_body"]) and robot["never_tested"] == []
    assert "2 x sphere r 30" in in_process(capsys, "inspect", "--workcell", path).out


def test_a_page_shows_arm_and_placements(tmp_path, capsys):
    page = tmp_path / "cell.html"
    outcome = in_process(capsys, "inspect", "--workcell", "nova2-w", "--object", "mug", "--html", page)
    assert outcome.code == 0 and f"written: {page}" in outcome.out
    text = page.read_text("utf-8")
    assert "mug in nova2-w" in text and "placement 3" in text and "{{" not in text


def test_a_workcell_refused_for_its_home_is_described(tmp_path, capsys):
    write_arm(tmp_path / "arm.urdf")
    path = cell(tmp_path, tmp_path / "arm.urdf", "home = [3.0, 0.12, 0.0, 0.0, 0.0, 0.0]", "s1")
    outcome = in_process(capsys, "inspect", "--workcell", path, "--json")
    assert outcome.code == 2 and "at home" in outcome.err and len(outcome.err.splitlines()) == 1
    assert len(outcome.data["workcell"]["robot"]["joints"]) == 6


def test_bad_input_is_refused(tmp_path, capsys):
    assert_refused(in_process(capsys, "inspect", "--workcell", tmp_path / "none.toml"), "cannot be read")
    assert_refused(in_process(capsys, "inspect", "--object", "botle"), "unknown object")
