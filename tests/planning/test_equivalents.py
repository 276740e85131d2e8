"""Goals that a symmetry makes equal: the planner takes the best of them, and says which."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles.plans import verify_plan

from regrasp_opt import RegraspPlan, RegraspProblem, solve_sequence
from regrasp_opt.errors import OptionError
from regrasp_opt.objects.symmetry import turn_about
from regrasp_opt.planning.at_rest import TOLERANCE
from regrasp_opt.planning.equivalents import equivalent_goals
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.planning.verification import PoseFeasibility


def equal_goals(problem, goal, fold):
    center = problem.object.center_of_mass
    return [goal @ turn_about(center, np.array([0, 0, 2 * np.pi * k / fold])) for k in range(fold)]


@pytest.fixture(scope="module")
def far_turned(bottle_problem):
    """A task that needs a regrasp, but not if the goal may be turned about the bottle's axis."""
    rng = np.random.default_rng(3)
    for _ in range(30):
        task = random_task(bottle_problem, rng, needs_regrasp=True)
        feasible = bottle_problem.feasible_grasps(task.start)
        if any((bottle_problem.feasible_grasps(T) & feasible).any() for T in equal_goals(bottle_problem, task.goal, 4)):
            return task
    raise AssertionError("no such task was drawn")


@pytest.mark.parametrize("refiner", ["ipopt", "exact"])
def test_a_goal_anyhow_about_the_axis_is_one(bottle_problem, far_turned, refiner, tmp_path):
    start, goal, _ = far_turned
    plain = solve_sequence(bottle_problem, start, goal, refiner)
    plan = solve_sequence(bottle_problem, start, goal, refiner, symmetry=True)
    assert plain.num_regrasps >= 1 and plain.given == (None, None)
    assert plan.solved and plan.num_regrasps == 0 and plan.residuals().hold
    given = plan.given[1]
    np.testing.assert_allclose(given.T, goal, atol=1e-12)
    turned = goal @ turn_about(bottle_problem.object.center_of_mass, given.turn)
    np.testing.assert_allclose(plan.poses[-1], turned, atol=1e-9)
    assert np.degrees(np.linalg.norm(given.turn)) == pytest.approx(90.0) or np.degrees(
        np.linalg.norm(given.turn)
    ) == pytest.approx(180.0)
    assert len(plan.remarks) == 1 and "the goal is planned at" in plan.remarks[0]
    assert "degrees about the object's axis of symmetry" in plan.remarks[0]
    plan.save(tmp_path / "plan.json")
    again = RegraspPlan.load(tmp_path / "plan.json")
    np.testing.assert_allclose(again.given[1].turn, given.turn)
    assert again.residuals().hold and again.remarks == plan.remarks
    assert verify_plan(tmp_path / "plan.json") == []


@pytest.mark.parametrize("seed", range(4))
def test_no_more_regrasps_are_needed_and_the_cost_is_that_of_the_goal_taken(bottle_problem, seed):
    task = random_task(bottle_problem, np.random.default_rng(seed), needs_regrasp=True)
    plan = solve_sequence(bottle_problem, task.start, task.goal, symmetry=True)
    each = [solve_sequence(bottle_problem, task.start, T) for T in equal_goals(bottle_problem, task.goal, 4)]
    assert plan.solved and plan.residuals().hold
    assert plan.num_regrasps == min(one.num_regrasps for one in each if one.solved)
    taken = solve_sequence(bottle_problem, task.start, plan.poses[-1])
    assert taken.num_regrasps == plan.num_regrasps
    if plan.num_regrasps:
        ends = (np.where(bottle_problem.feasible_grasps(plan.poses[k]), 0.0, 1.0) for k in (0, -1))
        known = [solve_energy(bottle_problem, plan.poses[k], end) for k, end in zip((0, -1), ends, strict=True)]
        cost = bottle_problem.objective(*known).cost(plan.placements[None], plan.xi[None])[0]
        assert plan.cost == pytest.approx(cost)


def solve_energy(problem, T, infeasible):
    from regrasp_opt.planning.ends import known_energy

    return known_energy(problem.energy, T, infeasible == 0.0)


def test_of_a_body_of_revolution_some_goal_shares_a_grasp(tmp_path):
    trimesh.creation.cylinder(0.03, 0.1, sections=64).export(tmp_path / "can.stl")
    problem = RegraspProblem.load(tmp_path / "can.stl")
    start, goal = (
        PoseFeasibility(problem.checker, T) for T in (problem.pose(0, 0.2, 0.35), problem.pose(1, -0.2, 0.35))
    )
    both = equivalent_goals(problem, start, goal, TOLERANCE)
    assert len(both.members) >= 24 and both.members[0] is goal
    assert np.array_equal(both.all(), np.any([pose.all() for pose in both.members], axis=0))
    for pose in both.members[1:]:  # a turn about the upright axis is a yaw
        assert problem.at_rest(pose.T).placement == 1 and problem.at_rest(pose.T).motion < 1e-6
    plan = solve_sequence(problem, start.T, goal.T, symmetry=True)
    plain = solve_sequence(problem, start.T, goal.T)
    assert plan.solved and plan.residuals().hold and plan.num_regrasps <= plain.num_regrasps


def test_goals_where_the_object_cannot_be_are_left_out(bottle_problem):
    """Lying at the edge of the workspace, turned about its own axis, the bottle stays there; none is lost."""
    goal = PoseFeasibility(bottle_problem.checker, bottle_problem.pose(1, 0.3, 0.35))
    start = PoseFeasibility(bottle_problem.checker, bottle_problem.pose(0, 0.0, 0.35))
    poses = equivalent_goals(bottle_problem, start, goal, TOLERANCE).members
    assert len(poses) == 4
    found = {bottle_problem.at_rest(pose.T).placement for pose in poses}
    assert len(found) == 4  # it lies on another side each
    blocked = bottle_problem.with_obstacles([{"type": "box", "name": "wall", "size": [0.02, 0.02, 0.02],
                                              "position": [0.3, 0.35, 0.01]}])  # fmt: skip
    there = PoseFeasibility(blocked.checker, goal.T)
    assert len(equivalent_goals(blocked, start, there, TOLERANCE).members) == 1


def test_symmetry_of_what_has_none_is_refused():
    problem = RegraspProblem.load("mug")
    T = problem.pose(0, 0.1, 0.35)
    with pytest.raises(OptionError, match="'mug' has no axis of rotational symmetry; omit symmetry"):
        solve_sequence(problem, T, T, symmetry=True)


def test_an_unsolved_plan_keeps_the_goal_that_was_asked_for(bottle_problem, far_turned):
    plan = solve_sequence(
        bottle_problem, far_turned.start, far_turned.goal, symmetry=True, max_regrasps=0, accept=lambda plan: False
    )
    assert not plan.solved and plan.given == (None, None)
    np.testing.assert_array_equal(plan.poses[-1], replace(plan).poses[-1])
    np.testing.assert_allclose(plan.poses[-1], far_turned.goal, atol=1e-12)
