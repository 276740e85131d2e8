"""The verifier of plans names every kind of fault, in cells of every kind of body."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from collisions import colliding_links
from scipy.spatial.transform import Rotation
from verifying import body_verifier, plan_problems, plan_verifier

from oracles.plans import PlanVerifier
from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.robots import load_robot

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def plan(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    found = solve_sequence(bottle_problem, task.start, task.goal)
    assert found.num_regrasps == 1
    return found


@pytest.fixture(scope="module")
def verifier(bottle_problem):
    return plan_verifier(bottle_problem)


@pytest.fixture(scope="module")
def content(plan, tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "plan.json"
    plan.save(path)
    return json.loads(path.read_text("utf-8"))


def with_pose(plan, number, T):
    poses = plan.poses.copy()
    poses[number] = T
    return replace(plan, poses=poses)


def with_transition(plan, **changes):
    return replace(plan, transitions=(replace(plan.transitions[0], **changes), *plan.transitions[1:]))


def first(count):
    return range(min(count, 1))


@pytest.mark.parametrize("name", ["mug", "pentagon"])
def test_good_plans_have_no_fault(name):
    problem = RegraspProblem.load(name, "nova2-w")
    verifier, rng = plan_verifier(problem), np.random.default_rng(3)
    for number in range(2):
        task = random_task(problem, rng, needs_regrasp=True if number else None)
        plan = solve_sequence(problem, task.start, task.goal, seed=number)
        assert plan.solved and plan_problems(plan, verifier=verifier) == []


def test_the_command_verifies_what_was_saved(content, tmp_path):
    paths = [str(tmp_path / name) for name in ("good.json", "bad.json")]
    for path in paths:
        Path(path).write_text(json.dumps(content), encoding="utf-8")
        content = {**content, "status": "not_found"}
    run = [sys.executable, "-m", "tests.oracles"]
    good = subprocess.run([*run, paths[0]], cwd=ROOT, capture_output=True, text=True, check=False)
    both = subprocess.run([*run, *paths], cwd=ROOT, capture_output=True, text=True, check=False)
    assert good.returncode == 0 and "good.json: verified" in good.stdout, good.stderr
    assert both.returncode == 1 and "status is not_found" in both.stdout


def test_where_the_object_stands_is_judged(plan, verifier):
    problem, T = plan.problem, plan.poses[1]
    tilted = T @ np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_euler("x", 25.0, degrees=True).as_matrix()
    leaning = T @ tilt
    leaning[2, 3] -= (problem.object.vertices @ leaning[2, :3] + leaning[2, 3]).min()
    stretched = T.copy()
    stretched[:3, :3] *= 1.001
    for pose, said in (
        (translation(0.0, 0.0, 0.01) @ T, "pose 1: it is 0.01 m above the table"),
        (translation(0.0, 0.0, 2e-5) @ T, "pose 1: it is 2e-05 m above the table"),
        (problem.pose(0, 0.0, 2.0), "pose 1: it stands over the edge of the table"),
        (leaning, "pose 1: it would tip over"),
        (problem.pose(0, 0.0, 0.0), "pose 1: object and base_link/0 are"),
        (problem.pose(0, 0.0, 2.0), "pose 1: its centre of mass is outside the workspace in y"),
        (tilted, "pose 1: it is"),
        (stretched, "pose 1: it is not a rigid pose"),
    ):
        assert any(said in text for text in plan_problems(with_pose(plan, 1, pose), first, verifier)), said


def test_missing_transitions_and_grasps_are_named(plan, verifier):
    short = plan_problems(replace(plan, transitions=plan.transitions[:1]), first, verifier)
    assert short == ["there are 1 transitions between 3 poses"]
    nothing = {name: getattr(plan.transitions[0], name)[:0] for name in ("grasp_ids", "q_pick", "q_place", "clearance")}
    assert plan_problems(with_transition(plan, **nothing), first, verifier) == ["transition 0 has no grasp"]


def test_what_is_wrong_with_a_configuration_is_named(plan, verifier):
    row = plan.transitions[0]
    where = f"transition 0, grasp {row.grasp_ids[0]}: "
    turned = plan_problems(with_transition(plan, q_pick=row.q_pick + 20.0 * np.eye(6)[0]), first, verifier)
    assert where + "pick: a joint is beyond its limit" in turned
    nudged = plan_problems(with_transition(plan, q_place=row.q_place + 1e-4), first, verifier)
    assert nudged[0].startswith(where + "place: the arm misses the grasp by ")
    # with the arm hanging down beside itself, links are in the table
    sunk = plan_problems(with_transition(plan, q_pick=row.q_pick * 0 + [0.0, 2.0, 0.5, 0, 0, 0]), first, verifier)
    assert any("table and link" in text and "m apart" in text for text in sunk)
    boast = plan_problems(with_transition(plan, clearance=row.clearance + 3e-4), first, verifier)
    assert len(boast) >= 1 and all("m apart, not" in text for text in boast)
    assert plan_problems(with_transition(plan, clearance=row.clearance - 1e-3), first, verifier) == []


def test_links_that_meet_are_named(plan, verifier):
    T, q = plan.poses[0], np.array([0, 0, 2.618, 1.5, 0, 0])
    assert any("link" in text and "apart, not 0.00000 m" in text for text in verifier.collisions(q, T, 0.05))


def test_a_grasp_that_holds_nothing_is_named(plan, verifier):
    T, width = plan.problem.grasps.T_object_tcp, plan.problem.grasps.width
    for pose, opening in zip(T, width.tolist(), strict=True):
        assert verifier.hold_problem(pose, opening) is None
    back, turned = T[0] @ translation(0.0, 0.0, -0.103), T[0] @ translation(0.0, 0.0, 0.0)
    turned[:3, :2] = np.column_stack([T[0, :3, 1], -T[0, :3, 0]])
    assert "touches nothing" in verifier.hold_problem(back, float(width[0]))
    assert "touches nothing" in verifier.hold_problem(T[0], float(width[0]) + 0.006)
    assert "in the object" in verifier.hold_problem(T[0], float(width[0]) - 0.006)
    assert "cannot be" in verifier.hold_problem(T[0], 0.2)


def test_cups_that_do_not_seal_are_named():
    suction = RegraspProblem.load("bottle", "nova2-s1", grasps=suction_grasps())
    verifier = plan_verifier(suction)
    for T in suction.grasps.T_object_tcp:
        assert verifier.hold_problem(T, 0.0) is None
    T = suction.grasps.T_object_tcp[0]
    assert "off the surface" in verifier.hold_problem(T @ translation(0.0, 0.0, -0.009), 0.0)
    assert "over nothing" in verifier.hold_problem(T @ translation(0.5, 0.0, 0.0), 0.0)


def suction_grasps():
    from regrasp_opt.grasps import sample_grasps
    from regrasp_opt.objects import load_object
    from regrasp_opt.scene import load_workcell

    return sample_grasps(load_object("bottle"), load_workcell("nova2-s1").end_effector, 20, seed=0)


def obstacle(kind, pose):
    if kind == "box":
        return Box("part", np.array([0.06, 0.06, 0.2]), pose)
    if kind == "cylinder":
        return Cylinder("part", 0.03, 0.2, pose)
    shape = trimesh.creation.box((0.06, 0.06, 0.2))
    if kind == "concave":
        wall = trimesh.creation.box((0.02, 0.5, 0.2))
        wall.apply_translation([0.2, 0.0, 0.0])
        shape = trimesh.util.concatenate([shape, wall])
    return Mesh("part", np.array(shape.vertices), np.array(shape.faces), pose)


@pytest.mark.parametrize("kind", ["box", "cylinder", "mesh", "concave"])
def test_obstacles_of_every_kind_are_seen(bottle_problem, plan, kind):
    cell = replace(bottle_problem.workcell, obstacles=(obstacle(kind, translation(0.2, 0.5, 0.1)),))
    verifier = body_verifier(bottle_problem.object, cell)
    assert [text[:15] for text in verifier.pose_problems(bottle_problem.pose(0, 0.2, 0.5))] == ["object and part"]
    assert verifier.pose_problems(bottle_problem.pose(0, -0.2, 0.4)) == []
    assert verifier.pose_problems(bottle_problem.pose(0, 0.26, 0.2)) == []
    standing = int(np.argmax([placement.pose[2, 2] for placement in bottle_problem.placements]))
    between = bottle_problem.pose(standing, 0.3, 0.5)  # inside the hull of the two parts
    assert verifier.pose_problems(between) == []
    q, T = plan.transitions[0].q_pick[0], plan.poses[0]
    hand = np.eye(4)
    hand[:3, 3] = (T @ plan.problem.grasps.T_object_tcp[plan.transitions[0].grasp_ids[0]])[:3, 3] + [0, 0, 0.05]
    cell = replace(bottle_problem.workcell, obstacles=(obstacle(kind, hand),))
    assert any("part" in text for text in body_verifier(bottle_problem.object, cell).collisions(q, T, 0.06))


def test_what_is_fixed_to_a_link_may_not_touch_the_next_one(bottle_problem, plan, tmp_path):
    robot, q = bottle_problem.workcell.robot, plan.transitions[0].q_pick[0]
    _, T_base_2, T_base_3, *_ = robot.link_transforms(q)
    in_3 = (np.linalg.inv(T_base_2) @ T_base_3 @ [-0.11, 0.0, -0.009, 1.0])[
        :3
    ]  # the middle of link 3, seen from link 2
    text = Path(robot.urdf_path).read_text("utf-8").removesuffix("</robot>\n")
    text += '<link name="bracket"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>'
    text += f'<joint name="to_bracket" type="fixed"><origin xyz="{" ".join(map(str, in_3))}"/>'
    (tmp_path / "arm.urdf").write_text(f'{text}<parent link="link2"/><child link="bracket"/></joint></robot>')
    arm = replace(bottle_problem.workcell.arm, robot=load_robot(tmp_path / "arm.urdf", tip="flange", home=robot.home))
    cell = replace(bottle_problem.workcell, arm=arm)
    assert set(colliding_links(cell.robot, q)) == {"bracket", "link3"}
    said = body_verifier(bottle_problem.object, cell).collisions(q, plan.poses[0], 0.06)
    assert any("bracket" in text and "link3" in text for text in said)


def test_what_is_wholly_inside_a_closed_body_is_seen(bottle_problem):
    """A box around the object touches it nowhere; so does a shell with two walls, and what is in its hollow is free."""
    crate = trimesh.creation.icosphere(subdivisions=2, radius=0.3)
    crate.vertices += 0.01 * np.sin(40 * crate.vertices)  # no longer convex
    T = bottle_problem.pose(0, 0.2, 0.5)

    def problems(mesh):
        shape = Mesh("crate", np.array(mesh.vertices), np.array(mesh.faces), T)
        cell = replace(bottle_problem.workcell, obstacles=(shape,))
        return [text for text in body_verifier(bottle_problem.object, cell).pose_problems(T) if "crate" in text]

    assert len(problems(crate)) == 1
    hollow = crate.copy()
    hollow.vertices *= 0.9
    hollow.invert()
    assert problems(trimesh.util.concatenate([crate, hollow])) == []


def damages(content):
    """Yield (name, content) of plans that are damaged in one place each."""

    def copy():
        return json.loads(json.dumps(content))

    for key in ("q_pick", "q_place"):
        for joint in range(6):
            one = copy()
            one["transitions"][0][key][0][joint] += 0.01
            yield f"{key} {joint}", one
    ids = content["transitions"][0]["grasp_ids"]
    for change in (0.004, -0.004):
        one = copy()
        one["grasps"][ids[0]]["width"] += change
        yield f"width {change}", one
    for axis in range(3):
        one = copy()
        one["poses"][1][axis][3] += 0.001
        yield f"pose {axis}", one
        one = copy()
        one["grasps"][ids[0]]["T_object_tcp"][axis][3] += 0.002
        yield f"grasp {axis}", one


def test_plans_damaged_in_one_place_are_caught(content):
    verifier = PlanVerifier(content)
    assert verifier.problems(content) == []
    for name, one in damages(content):
        assert verifier.problems(one), name
