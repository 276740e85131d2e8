"""Every way of being infeasible is told by its name, and feasible grasps have none."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, Status, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import GraspError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.diagnosis import Cause, Reason, diagnose, summary, tally
from regrasp_opt.geometry.shapes import Box
from regrasp_opt.planning.tasks import random_graspable_pose
from regrasp_opt.scene import WorkspaceBounds, load_workcell


def checker_of(problem, **changes):
    return FeasibilityChecker(problem.object, replace(problem.workcell, **changes), problem.grasps)


def causes(checker, T):
    found = diagnose(checker, T)
    np.testing.assert_array_equal([f is None for f in found], checker.feasible(T))
    return {failure.cause for failure in tally(found)}


@pytest.mark.parametrize("seed", range(4))
def test_a_failure_is_told_where_and_only_where_the_check_fails(bottle_problem, seed):
    rng = np.random.default_rng(seed)
    low, high = bottle_problem.workcell.bounds.array
    T = bottle_problem.pose(int(rng.integers(5)), *rng.uniform(low, high), rng.uniform(0, 6))
    some = rng.choice(200, 30)
    everything = diagnose(bottle_problem.checker, T)
    assert diagnose(bottle_problem.checker, T, some) == [everything[i] for i in some]
    causes(bottle_problem.checker, T)


def test_an_object_in_the_way_comes_first(bottle_problem):
    checker, T = bottle_problem.checker, bottle_problem.pose(0, 0.0, 0.3)
    assert set(diagnose(checker, translation(0, 0, -0.01) @ T)) == {
        Reason(Cause.OBJECT, ("sinks 10.0 mm into the table",))
    }
    wall = Box("wall", np.array([0.02, 0.2, 0.2]), translation(0.0, 0.3, 0.1))
    (failure,) = set(diagnose(checker_of(bottle_problem, obstacles=(wall,)), T))
    assert str(failure) == "object is too near to the obstacle 'wall'"


def test_reach_and_table(bottle_problem):
    far = checker_of(
        bottle_problem, supports=(replace(bottle_problem.workcell.table, size=np.array([9.0, 9.0])),), obstacles=()
    )
    assert causes(far, bottle_problem.pose(0, 3.0, 0.3)) == {Cause.OUT_OF_REACH}
    T = bottle_problem.pose(0, 0.2, 0.3)
    tips = (T @ bottle_problem.grasps.T_object_tcp)[:, 2, 3]
    assert tips.min() > 0
    below = (T @ bottle_problem.grasps.T_object_tcp @ translation(0, 0, -0.02))[:, 2, 3] < 0  # just behind the tips
    found = [f for f, low in zip(diagnose(bottle_problem.checker, T), below, strict=True) if low]
    assert len(found) > 5 and found.count(Reason(Cause.GRIPPER_IN_TABLE)) > 0.8 * len(found)


def test_limits_are_told_from_reach(bottle_problem):
    robot = bottle_problem.workcell.robot
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (300, 6))
    q[:, 1] = np.random.default_rng(1).uniform(2.7, np.pi, 300)  # beyond its limit, and not all have another branch
    T = robot.forward(q)
    assert robot.reaches(T).all()
    assert 0 < len(set(robot.solve_ik(T).pose_index)) < 300
    T[:, :3, 3] *= (robot.max_reach + 0.01) / np.linalg.norm(T[:, :3, 3], axis=1)[:, None]
    assert not robot.reaches(T).any()


def test_obstacles_are_named_with_what_hits_them(bottle_problem):
    T = bottle_problem.pose(4, 0.25, 0.35)
    roof = Box("roof", np.array([0.3, 0.3, 0.01]), translation(0.25, 0.35, 0.23))
    found = tally(diagnose(checker_of(bottle_problem, obstacles=(roof,)), T))
    assert found[Reason(Cause.GRIPPER_IN_OBSTACLE, ("obstacle 'roof'",))] > 0
    fence = Box("fence", np.array([0.5, 0.02, 0.5]), translation(0.2, 0.16, 0.3))
    found = tally(diagnose(checker_of(bottle_problem, obstacles=(fence,)), T))
    assert found[Reason(Cause.ARM_IN_OBSTACLE, ("obstacle 'fence'",))] > 0


def test_arm_in_itself_in_table_and_in_the_object(bottle_problem):
    places = [(m, x, y, yaw) for m in range(5) for x in (-0.1, 0.2, 0.42) for y in (0.16, 0.4) for yaw in (0.3, 2.0)]
    seen = {cause for m, *xi in places for cause in causes(bottle_problem.checker, bottle_problem.pose(m, *xi))}
    assert {Cause.JOINT_LIMIT, Cause.ARM_IN_TABLE, Cause.SELF_COLLISION, Cause.GRIPPER_IN_TABLE} <= seen
    through = bottle_problem.grasps.T_object_tcp.copy()
    through[:, :3, 3] += 0.16 * through[:, :3, 2]  # the wrist where the object is
    deep = FeasibilityChecker(
        bottle_problem.object, bottle_problem.workcell, replace(bottle_problem.grasps, T_object_tcp=through)
    )
    assert Cause.ARM_IN_OBJECT in causes(deep, bottle_problem.pose(4, 0.2, 0.35))


def test_self_collisions_name_both(bottle_problem):
    failures = [f for y in (0.16, 0.2) for f in tally(diagnose(bottle_problem.checker, bottle_problem.pose(4, 0.1, y)))]
    pairs = [f.bodies for f in failures if f.cause is Cause.SELF_COLLISION]
    assert pairs and all(len(pair) == 2 and all(name.startswith("'") for name in pair) for pair in pairs)


def test_the_summary_counts_and_advises():
    table, reach = Reason(Cause.GRIPPER_IN_TABLE), Reason(Cause.OUT_OF_REACH)
    text = summary([table, None, reach, table])
    assert text == f"2 gripper in table, 1 out of reach; {Cause.OUT_OF_REACH.advice}"
    assert summary([table, None]) == f"1 gripper in table; {Cause.GRIPPER_IN_TABLE.advice}"
    posts = [Reason(Cause.ARM_IN_OBSTACLE, (f"obstacle 'post{k}'",)) for k in range(9)]
    assert summary([*posts, table]).endswith(f"4 otherwise; {Cause.ARM_IN_OBSTACLE.advice}")
    assert summary([*[table] * 98, reach, reach]).endswith(Cause.GRIPPER_IN_TABLE.advice)
    assert summary([*[table] * 9, reach]).endswith(Cause.OUT_OF_REACH.advice)
    assert summary([None]) == "all are feasible"
    assert all(cause.advice for cause in Cause)


def test_plans_say_why_an_end_has_no_grasp(bottle_problem):
    problem = bottle_problem
    T = next(
        T for x in np.linspace(0.3, 0.45, 16) if not problem.feasible_grasps(T := problem.pose(0, -x, 0.59, 0.5)).any()
    )
    plan = solve_sequence(problem, T, problem.pose(1, 0.2, 0.35))
    assert plan.status is Status.START_INFEASIBLE
    assert plan.message == f"no grasp is feasible at the start pose: {summary(diagnose(problem.checker, T))}"


def test_a_workspace_without_graspable_poses_says_why(tmp_path, monkeypatch):
    monkeypatch.setattr("regrasp_opt.planning.tasks._ATTEMPTS", 30)
    text = (files("regrasp_opt") / "data" / "workcells" / "nova2-w.toml").read_text("utf-8")
    (tmp_path / "far.toml").write_text(text, "utf-8")
    cell = load_workcell(tmp_path / "far.toml")
    far = replace(
        cell,
        supports=(replace(cell.table, size=np.array([3.0, 3.0]), workspace=WorkspaceBounds((0.0, 0.1), (0.9, 0.92))),),
    )
    problem = RegraspProblem.load("bottle", far)
    with pytest.raises(GraspError, match=r"in 30 tries: \d+ (out of reach|gripper in table|joint limit)"):
        random_graspable_pose(problem, np.random.default_rng(0))
