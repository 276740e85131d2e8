"""The second proof of plans names every kind of fault, and refuses bodies that it does not know."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.benchmarks.recheck import DATA, Recheck
from regrasp_opt.conventions import translation
from regrasp_opt.errors import OptionError
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.workcell import load_workcell


@pytest.fixture(scope="module")
def plan(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    found = solve_sequence(bottle_problem, task.start, task.goal)
    assert found.num_regrasps == 1
    return found


@pytest.fixture(scope="module")
def recheck(bottle_problem):
    return Recheck(bottle_problem)


def with_pose(plan, number, T):
    poses = plan.poses.copy()
    poses[number] = T
    return replace(plan, poses=poses)


def with_transition(plan, **changes):
    return replace(plan, transitions=(replace(plan.transitions[0], **changes), *plan.transitions[1:]))


def first_row(transition):
    return [0] if len(transition.grasp_ids) else []


def test_a_good_plan_has_no_fault(plan, recheck):
    assert recheck.problems(plan, lambda transition: range(len(transition.grasp_ids))) == []


def test_where_the_object_stands_is_judged(plan, recheck):
    problem, T = plan.problem, plan.poses[1]
    tilted = T @ np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_euler("x", 25.0, degrees=True).as_matrix()
    leaning = T @ tilt
    leaning[2, 3] -= (problem.object.vertices @ leaning[2, :3] + leaning[2, 3]).min()
    for pose, said in (
        (translation(0.0, 0.0, 0.01) @ T, "pose 1: it is 0.0100 m above the table"),
        (problem.pose(0, 0.0, 2.0), "pose 1: it stands over the edge of the table"),
        (leaning, "pose 1: it would tip over"),
        (problem.pose(0, 0.0, 0.0), "pose 1: it overlaps the robot's base"),
        (problem.pose(0, 0.0, 2.0), "pose 1 is no stable placement in the workspace"),
        (tilted, "pose 1 is no stable placement in the workspace"),
    ):
        assert said in recheck.problems(with_pose(plan, 1, pose), first_row)


def test_missing_transitions_and_grasps_are_named(plan, recheck):
    assert recheck.problems(replace(plan, transitions=plan.transitions[:1]), first_row) == ["a transition is missing"]
    nothing = {name: getattr(plan.transitions[0], name)[:0] for name in ("grasp_ids", "q_pick", "q_place", "clearance")}
    assert recheck.problems(with_transition(plan, **nothing), first_row) == ["transition 0 has no grasp"]


def test_what_is_wrong_with_a_configuration_is_named(plan, recheck):
    first = plan.transitions[0]
    where = f"transition 0, grasp {first.grasp_ids[0]}: "
    turned = recheck.problems(with_transition(plan, q_pick=first.q_pick + 20.0 * np.eye(6)[0]), first_row)
    assert where + "a joint is beyond its limit" in turned
    nudged = recheck.problems(with_transition(plan, q_place=first.q_place + 1e-4), first_row)
    assert len(nudged) == 1 and nudged[0].startswith(where + "the arm misses the grasp by ")
    # with the arm hanging down beside itself, links are in the table
    sunk = recheck.problems(with_transition(plan, q_pick=np.tile([0.0, 2.0, 0.5, 0.0, 0.0, 0.0], (1, 1))), first_row)
    assert any(text.endswith("nearer than they may be") and "table are" in text for text in sunk)


def cell_with(tmp_path, obstacle):
    path = tmp_path / "cell.toml"
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
    path.write_text(f'{text}\n[[obstacles]]\nname = "part"\nposition = [0.2, 0.5, 0.1]\n{obstacle}\n', encoding="utf-8")
    return load_workcell(path)


def test_a_cylinder_for_an_obstacle_is_seen(tmp_path, bottle_problem):
    cell = cell_with(tmp_path, 'type = "cylinder"\nradius = 0.03\nlength = 0.2')
    problem = RegraspProblem.load("bottle", cell, grasps=bottle_problem.grasps)
    recheck = Recheck(problem)
    assert list(recheck.pose_problems(problem.pose(0, 0.2, 0.5))) == ["it overlaps an obstacle"]
    assert list(recheck.pose_problems(problem.pose(0, -0.2, 0.4))) == []


def test_a_mesh_for_an_obstacle_is_refused(tmp_path, bottle_problem):
    trimesh.creation.box((0.05, 0.05, 0.2)).export(tmp_path / "part.stl")
    cell = cell_with(tmp_path, 'type = "mesh"\nfile = "part.stl"')
    with pytest.raises(OptionError, match="knows obstacles that are boxes or cylinders only"):
        Recheck(RegraspProblem.load("bottle", cell, grasps=bottle_problem.grasps))


def cell_of_robot(tmp_path, geometry):
    """Return nova2-w with a robot whose foot, a cylinder, is `geometry` instead."""
    urdf = (DATA / "robots" / "nova2" / "nova2.urdf").read_text("utf-8")
    foot = '<cylinder radius="0.066" length="0.035"/>'
    assert foot in urdf
    (tmp_path / "arm.urdf").write_text(urdf.replace(foot, geometry), encoding="utf-8")
    text = (DATA / "workcells" / "nova2-w.toml").read_text("utf-8")
    assert 'model = "nova2"' in text
    path = tmp_path / "cell.toml"
    path.write_text(text.replace('model = "nova2"', 'model = "arm.urdf"'), encoding="utf-8")
    return load_workcell(path)


def test_boxes_of_a_robot_are_known_and_meshes_refused(tmp_path, bottle_problem):
    wide = RegraspProblem.load(
        "bottle", cell_of_robot(tmp_path, '<box size="0.6 0.6 0.1"/>'), grasps=bottle_problem.grasps
    )
    T = bottle_problem.pose(0, 0.2, 0.2)
    assert list(Recheck(bottle_problem).pose_problems(T)) == []
    assert list(Recheck(wide).pose_problems(T)) == ["it overlaps the robot's base"]
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "base.stl")
    mesh = cell_of_robot(tmp_path, '<mesh filename="base.stl"/>')
    with pytest.raises(OptionError, match="knows robots of boxes, cylinders and spheres only"):
        Recheck(RegraspProblem.load("bottle", mesh, grasps=bottle_problem.grasps))
