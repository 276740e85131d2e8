"""Obstacles that are put in when a plan is asked for: no training, no refusal, and in the way like any others."""

import json

import numpy as np
import pytest

from regrasp_opt import RegraspPlan, RegraspProblem, prepare, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import OptionError, PlanFileError, PoseError, WorkcellError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh
from regrasp_opt.motion import plan_motion
from regrasp_opt.planning.tasks import random_task

WALL = {"type": "box", "name": "wall", "position": [0.0, 0.35, 0.1], "size": [0.02, 0.5, 0.2]}
POST = {"type": "cylinder", "name": "post", "position": [0.2, 0.2, 0.2], "radius": 0.03, "length": 0.4}
FILE = "".join(
    "\n[[obstacles]]\n" + "".join(f"{key} = {json.dumps(value)}\n" for key, value in each.items())
    for each in (WALL, POST)
)


@pytest.fixture(scope="module")
def cluttered(bottle_problem):
    return bottle_problem.with_obstacles([WALL, POST])


@pytest.fixture(scope="module")
def blocked_plan(cluttered):
    task = random_task(cluttered, np.random.default_rng(4), needs_regrasp=True)
    return solve_sequence(cluttered, task.start, task.goal)


def test_they_block_what_the_same_obstacles_of_a_file_block(bottle_problem, cluttered, tmp_path):
    from importlib.resources import files

    text = (files("regrasp_opt") / "data" / "workcells" / "nova2-w.toml").read_text("utf-8")
    (tmp_path / "cell.toml").write_text(text + FILE, "utf-8")
    of_file = RegraspProblem.load("bottle", tmp_path / "cell.toml", grasps=bottle_problem.grasps)
    assert of_file.workcell.fingerprint() == cluttered.workcell.fingerprint()
    rng, less = np.random.default_rng(0), 0
    for _ in range(12):
        T = cluttered.pose(int(rng.integers(5)), *rng.uniform([-0.4, 0.15, 0], [0.4, 0.55, 6]))
        np.testing.assert_array_equal(cluttered.feasible_grasps(T), of_file.feasible_grasps(T))
        less += int((bottle_problem.feasible_grasps(T) & ~cluttered.feasible_grasps(T)).sum())
    assert less > 20


def test_nothing_is_made_anew_for_them(bottle_problem, cluttered):
    assert cluttered.grasps is bottle_problem.grasps and cluttered.placements is bottle_problem.placements
    assert cluttered.energy.fingerprint() == bottle_problem.energy.fingerprint()
    assert len(bottle_problem.workcell.obstacles) == 0
    twice = cluttered.with_obstacles([Box("lid", np.array([0.1, 0.1, 0.1]), translation(0.4, 0.5, 0.4))])
    assert [shape.name for shape in twice.workcell.obstacles] == ["wall", "post", "lid"]
    assert twice.workcell.as_loaded.fingerprint() == bottle_problem.workcell.fingerprint()


def test_shapes_and_keys_mean_the_same(bottle_problem, cluttered):
    shapes = [
        Box("wall", np.array([0.02, 0.5, 0.2]), translation(0.0, 0.35, 0.1)),
        Cylinder("post", 0.03, 0.4, translation(0.2, 0.2, 0.2)),
    ]
    assert bottle_problem.with_obstacles(shapes).workcell.fingerprint() == cluttered.workcell.fingerprint()


def test_plans_keep_clear_of_them_and_keep_them(blocked_plan, tmp_path):
    assert blocked_plan.solved and blocked_plan.residuals().hold
    blocked_plan.save(tmp_path / "plan.json")
    loaded = RegraspPlan.load(tmp_path / "plan.json")
    assert [shape.name for shape in loaded.problem.workcell.obstacles] == ["wall", "post"]
    assert loaded.residuals().hold and loaded.problem.model_folder is not None
    content = json.loads((tmp_path / "plan.json").read_text("utf-8"))
    for obstacle in content["workcell"]["obstacles"]:  # onto the object at the goal
        if obstacle["name"] == "post":
            obstacle["position"] = [*blocked_plan.poses[-1][:2, 3].tolist(), 0.2]
    (tmp_path / "moved.json").write_text(json.dumps(content), "utf-8")
    with pytest.raises(PlanFileError, match=r"the obstacles of the plan '.*' were changed in its file; plan again"):
        RegraspPlan.load(tmp_path / "moved.json")


def test_motions_keep_clear_of_them(blocked_plan):
    motion = plan_motion(blocked_plan)
    assert motion.solved
    scene = motion.plan.problem.workcell
    assert {shape.name for shape in scene.obstacles} == {"wall", "post"}


def test_what_is_in_the_way_from_the_start_is_named(bottle_problem, cluttered):
    start = bottle_problem.pose(0, 0.2, 0.2)  # where the post stands
    with pytest.raises(PoseError, match=r"the object overlaps the obstacle 'post' at the start pose; move it away"):
        solve_sequence(cluttered, start, bottle_problem.pose(1, -0.2, 0.4))
    inside = {**POST, "name": "pillar", "position": [0.0, 0.0, 0.3]}
    with pytest.raises(WorkcellError, match=r"'.*' collides with 'pillar'.* while the robot is at home; move the obs"):
        bottle_problem.with_obstacles([inside])


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({**WALL, "sizes": [1, 1, 1]}, "obstacle 0: unknown key 'sizes'; allowed: size, "),
        ({**WALL, "type": "ball"}, "obstacle 0: key 'type'"),
        ({key: value for key, value in POST.items() if key != "radius"}, "a cylinder needs the key 'radius'"),
        ({**WALL, "name": "table"}, "the name 'table' is taken"),
        ({"type": "mesh", "name": "m", "position": [0, 0, 1], "file": "none.stl"}, "does not exist; give a path"),
    ],
)
def test_wrong_obstacles_are_refused(bottle_problem, wrong, said):
    with pytest.raises(WorkcellError, match=said):
        bottle_problem.with_obstacles([wrong])


def test_they_are_not_prepared_for(cluttered):
    with pytest.raises(OptionError, match="obstacle 'wall' was put in later and needs no training"):
        prepare(cluttered.object, cluttered.workcell)


def turned(pose):
    return np.diag([1.0, 1.0, -1.0, 1.0]) @ pose


@pytest.mark.parametrize(
    ("shape", "said"),
    [
        (Box("a", np.array([-0.1, 0.1, 0.1]), translation(0.4, 0.5, 0.4)), r"obstacle 0, 'a', has sizes \[-0.1"),
        (Box("a", np.array([0.1, 0.1]), translation(0.4, 0.5, 0.4)), "give lengths above 0 in metres"),
        (Cylinder("a", np.nan, 0.1, translation(0.4, 0.5, 0.4)), "give lengths above 0 in metres"),
        (Cylinder("a", 0.1, 0.1, turned(translation(0.4, 0.5, 0.4))), "the pose of obstacle 0 is left-handed"),
        (Cylinder("a", 0.1, 0.1, 2 * np.eye(4)), "the pose of obstacle 0 is not a rigid transform"),
        (Mesh("a", np.zeros((0, 3)), np.zeros((0, 3), dtype=int), np.eye(4)), "at least one triangle"),
        (Mesh("a", np.eye(3), np.array([[0, 1, 5]]), np.eye(4)), "triangles of vertices that it does not hold"),
        (Mesh("a", 1e3 * np.eye(3), np.array([[0, 1, 2]]), np.eye(4)), "looks like millimetres"),
        (7, "obstacle 0 is a int; give a Box, Cylinder or Mesh, or a dict of keys"),
    ],
)
def test_shapes_that_no_body_can_have_are_refused(bottle_problem, shape, said):
    with pytest.raises(WorkcellError, match=said):
        bottle_problem.with_obstacles([shape])
