"""Why there is no plan: what is to blame is known beforehand, and what is said to help is tried."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from regrasp_opt import RegraspPlan, RegraspProblem, load_workcell, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import GraspError, PoseError
from regrasp_opt.feasibility.diagnosis import Cause, Reason, obstructions
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.planning.explanation import Change
from regrasp_opt.planning.remedies import Remedies
from regrasp_opt.scene.support import WorkspaceBounds

GOAL = 1, 0.28, 0.38, 2.1


def failing(problem, start, goal=GOAL, **options):
    plan = solve_sequence(problem, problem.pose(*start), problem.pose(*goal), "exact", **options)
    assert not plan.solved
    return plan


def first(explanation, change):
    return next(remedy for remedy in explanation.helpful if remedy.change is change)


def mesh_problem(folder, mesh, cell="nova2-w"):
    mesh.export(folder / "part.stl")
    return RegraspProblem.load(folder / "part.stl", cell)


@pytest.fixture(scope="module")
def lid():
    return Box("lid", np.array([0.3, 0.3, 0.01]), translation(0.25, 0.35, 0.14))


@pytest.mark.parametrize("place", [(0, 0.2, 0.35, 0.5), (4, 0.1, 0.16, 0.5), (0, -0.44, 0.59, 0.5)])
def test_nothing_in_the_way_means_feasible(bottle_problem, place, lid):
    for problem in (bottle_problem, bottle_problem.with_obstacles([lid])):
        T = problem.pose(*place)
        found = obstructions(problem.checker, T)
        np.testing.assert_array_equal([frozenset() in sets for sets in found], problem.feasible_grasps(T))
        assert all(not a < b for sets in found for a in sets for b in sets)


def test_without_an_obstacle_those_are_feasible_that_it_alone_was_in_the_way_of(bottle_problem, lid):
    problem = bottle_problem.with_obstacles([lid])
    plan = failing(problem, (0, 0.25, 0.35, 0.5), (1, -0.28, 0.38, 2.1))
    told = plan.explain(remedies=False)
    start = told.poses[0]
    more = bottle_problem.feasible_grasps(start.T).sum()
    assert start.feasible == 0 and start.but_for["obstacle 'lid'"] == more > 0
    assert told.causes[0] == Reason(Cause.GRIPPER_IN_OBSTACLE, ("obstacle 'lid'",))
    assert sum(start.failures.values()) == start.grasps == 200


def test_an_obstacle_is_blamed_by_name_and_what_helps_is_true(bottle_problem, lid):
    post = Box("post", np.array([0.03, 0.03, 0.1]), translation(-0.5, 0.7, 0.05))
    problem = bottle_problem.with_obstacles([post, lid])
    told = failing(problem, (0, 0.25, 0.35, 0.5), (1, -0.28, 0.38, 2.1)).explain(time_limit=600)
    assert all("'lid'" in str(cause) for cause in told.causes if cause.bodies)
    assert first(told, Change.OBSTACLE).value == {"without": ["lid"]}
    moved = first(told, Change.PLACE)
    plan = solve_sequence(problem, moved.value["start"], told.poses[-1].T, "exact", max_regrasps=moved.num_regrasps)
    assert plan.solved and plan.num_regrasps <= moved.num_regrasps
    assert told.untried == () and "taking an obstacle away helps: without 'lid' (a plan" in str(told)
    assert json.loads(json.dumps(told.data()))["causes"][0]["bodies"] == ["obstacle 'lid'"]


def test_out_of_reach(bottle_problem):
    bounds = WorkspaceBounds((-2.0, 2.0), (-2.0, 2.0))
    table = replace(bottle_problem.workcell.table, size=np.array([6.0, 6.0]), workspace=bounds)
    cell = replace(bottle_problem.workcell, supports=(table,))
    problem = RegraspProblem.load("bottle", cell, grasps=bottle_problem.grasps)
    told = failing(problem, (0, 0.0, 1.1)).explain(time_limit=600)
    assert told.causes == (Reason(Cause.OUT_OF_REACH),)
    nearer = np.array(first(told, Change.PLACE).value["start"])
    assert problem.feasible_grasps(nearer).any() and nearer[1, 3] < 1.1
    with pytest.raises(PoseError, match="out of reach"):
        solve_sequence(problem, problem.pose(0, 0.0, 1.6), problem.pose(*GOAL), "exact")
    told = problem.explain(problem.pose(0, 0.0, 1.6), time_limit=600)
    assert told.causes == (Reason(Cause.OUT_OF_REACH),) and "out of reach" in told.poses[0].refused
    assert problem.feasible_grasps(first(told, Change.PLACE).value["pose"]).any()


def test_too_wide(tmp_path):
    with pytest.raises(GraspError, match=r"it is too wide: .* 110 mm apart, and the gripper takes 94 mm; .*\(r140\)"):
        mesh_problem(tmp_path, trimesh.creation.box((0.11, 0.12, 0.13)))
    problem = mesh_problem(tmp_path, trimesh.creation.box((0.11, 0.115, 0.035)))
    flat = next(k for k, p in enumerate(problem.placement_poses) if abs(p[2, 2]) > 0.9)
    told = problem.explain(problem.pose(flat, 0.1, 0.35, 0.3), time_limit=600)
    assert [cause.cause for cause in told.causes] == [Cause.TOO_WIDE, Cause.GRIPPER_IN_TABLE]
    tool = first(told, Change.TOOL).value["end_effector"]
    other = RegraspProblem.load(tmp_path / "part.stl", load_workcell("nova2-w", end_effector=tool))
    assert other.feasible_grasps(told.poses[0].T).any()


def test_the_table(tmp_path):
    problem = mesh_problem(tmp_path, trimesh.creation.box((0.07, 0.06, 0.003)))
    told = problem.explain(problem.pose(0, 0.1, 0.35, 0.3), time_limit=600)
    assert told.causes[0] == Reason(Cause.GRIPPER_IN_TABLE)
    assert {remedy.value["end_effector"][0] for remedy in told.helpful if remedy.change is Change.TOOL} == {"s"}


def test_limits_name_the_joint(tmp_path, bottle_problem):
    start, goal = bottle_problem.pose(0, 0.2, 0.35, 0.5), bottle_problem.pose(0, -0.2, 0.35, 0.5)
    robot = bottle_problem.workcell.robot
    held = bottle_problem.checker.configurations(start, np.flatnonzero(bottle_problem.feasible_grasps(start)))
    turns = np.unique(np.concatenate(held)[:, 0] % (2 * np.pi))
    k = int(np.diff(turns).argmax())
    low, high = (
        float(turns[k]) + 0.1,
        float(turns[k + 1]) - 0.1,
    )  # where no configuration that holds the bottle has joint 1
    assert high > low
    text = robot.urdf.decode().replace('lower="-6.28" upper="6.28"', f'lower="{low}" upper="{high}"', 1)
    (tmp_path / "arm.urdf").write_text(text, "utf-8")
    home = [(low + high) / 2, *robot.home[1:].tolist()]
    cell = f'schema = 1\n[robot]\nmodel = "arm.urdf"\ntip = "flange"\nhome = {home}\n'
    cell += '[end_effector]\nmodel = "w"\n[table]\ncenter = [0.0, 0.35]\nsize = [1.4, 1.2]\n'
    cell += "[workspace]\nx = [-0.45, 0.45]\ny = [0.1, 0.6]\n"
    (tmp_path / "cell.toml").write_text(cell, "utf-8")
    problem = RegraspProblem.load("bottle", tmp_path / "cell.toml", grasps=bottle_problem.grasps)
    told = solve_sequence(problem, start, goal, "exact").explain(remedies=False)
    assert told.causes[0] == Reason(Cause.JOINT_LIMIT, ("'joint1'",))
    assert told.poses[0].but_for["joint limit of 'joint1'"] >= bottle_problem.feasible_grasps(start).sum()


def test_no_shared_grasp_and_the_regrasps_it_takes(bottle_problem, tmp_path):
    plan = failing(bottle_problem, (0, -0.25, 0.40, 0.5), max_regrasps=0)
    told = plan.explain(time_limit=600)
    (pair,) = told.pairs
    assert told.causes == (Reason(Cause.NOT_SHARED),) and pair.shared == 0
    assert sum(pair.at_second.values()) == told.poses[0].feasible
    assert sum(pair.at_first.values()) == told.poses[1].feasible
    more = first(told, Change.REGRASPS)
    assert told.between.with_both > 0 and more.value == {"max_regrasps": 1} == {"max_regrasps": more.num_regrasps}
    assert all(remedy.num_regrasps == 0 for remedy in told.helpful if remedy.change is not Change.REGRASPS)
    plan.save(tmp_path / "plan.json")
    loaded = RegraspPlan.load(tmp_path / "plan.json").explain(remedies=False)
    assert str(loaded) == str(plan.explain(remedies=False))


def test_more_grasps_and_another_search_are_tried(bottle_problem):
    few = replace(bottle_problem, grasps=bottle_problem.grasps.subset(range(1, 200, 20)))
    plan = failing(few, (0, -0.25, 0.40, 0.52), (1, 0.28, 0.38, 2.09), max_regrasps=1)
    told = plan.explain(time_limit=600)
    assert first(told, Change.GRASPS).value == {"grasps": 30, "seed": 1}
    assert plan.refiner_stats[-1]["max_regrasps"] == 1
    start, goal = bottle_problem.pose(0, -0.25, 0.40, 0.5), bottle_problem.pose(*GOAL)
    late = solve_sequence(bottle_problem, start, goal, max_regrasps=2, time_limit=1e-9)
    assert late.status.name == "TIME_LIMIT" and late.refiner_stats[-1]["num_regrasps"] == 1
    told = late.explain(time_limit=600)
    (remedy,) = told.remedies
    assert remedy.change is Change.SEARCH and remedy.helps
    assert (remedy.value == {"time_limit": None}) == (told.causes == ())
    found = solve_sequence(bottle_problem, start, goal, remedy.value.get("refiner", "ipopt"), max_regrasps=2)
    assert found.solved and found.num_regrasps == remedy.num_regrasps == 1


def test_a_solved_plan_has_counts_and_no_blame(plan):
    told = plan.explain(time_limit=600)
    assert told.causes == () == told.remedies
    assert [pair.shared for pair in told.pairs] == [len(t.grasp_ids) for t in plan.transitions]
    assert [pose.name for pose in told.poses] == ["start", *(f"pose {i + 1}" for i in range(plan.num_regrasps)), "goal"]


def test_one_pose(bottle_problem, lid):
    told = bottle_problem.explain(bottle_problem.pose(0, 0.2, 0.35, 0.5), time_limit=600)
    assert told.causes == () and told.poses[0].feasible == 27 and "27 of 200 grasps feasible" in str(told)
    floating = translation(0.0, 0.0, 0.05) @ bottle_problem.pose(0, 0.2, 0.35, 0.5)
    told = bottle_problem.explain(floating, time_limit=600)
    assert told.causes == (Reason(Cause.REFUSED),) and "floats 50.0 mm" in str(told)
    T = np.array(first(told, Change.PLACE).value["pose"])
    assert T[2, 3] == pytest.approx(floating[2, 3] - 0.05, abs=1e-6)
    inside = bottle_problem.with_obstacles([replace(lid, pose=translation(0.25, 0.35, 0.03))])
    told = inside.explain(inside.pose(0, 0.2, 0.35, 0.5), time_limit=600)
    assert "'lid'" in str(told.causes[0]) and first(told, Change.OBSTACLE).value == {"without": ["lid"]}
    with pytest.raises(PoseError, match="rigid"):
        bottle_problem.explain(2 * np.eye(4))


def test_what_the_time_does_not_suffice_for_is_said(bottle_problem, monkeypatch):
    plan = failing(bottle_problem, (0, -0.44, 0.59, 0.5))
    monkeypatch.setattr(Remedies, "_late", lambda self: True)
    told = plan.explain(time_limit=600)
    assert told.remedies == () and Change.TOOL in told.untried
    assert "not tried, as the time ran out: taking an obstacle away, another place" in str(told)


def test_another_place_is_on_the_same_support(tmp_path, bottle_problem):
    text = 'schema = 2\n[[arms]]\nrobot = "nova2"\nend_effector = "w"\n[[supports]]\nname = "table"\n'
    text += 'center = [0.0, 0.35]\nsize = [1.0, 0.7]\n[[supports]]\nname = "shelf"\nheight = 0.34\n'
    text += "center = [0.30, 0.42]\nsize = [0.24, 0.24]\nthickness = 0.02\n"
    (tmp_path / "cell.toml").write_text(text, "utf-8")
    problem = RegraspProblem.load("bottle", tmp_path / "cell.toml", grasps=bottle_problem.grasps)
    told = problem.explain(problem.pose(0, 0.34, 0.5, 0.5, support="shelf"), time_limit=600)
    assert "outside the workspace of the support 'shelf'" in str(told)
    T = np.array(first(told, Change.PLACE).value["pose"])
    assert problem.station(T).support == "shelf" and problem.feasible_grasps(T).any()
