"""What the exact check has against a choice of grasps and configurations, and plans that nothing was prepared for."""

from dataclasses import replace

import numpy as np
import pytest
from transforms import IN_THE_BASE

from regrasp_opt.errors import OptionError
from regrasp_opt.motion import MeasureBounds, SearchOptions, refine_plan
from regrasp_opt.motion.refinement import search as joint_search
from regrasp_opt.motion.refinement.candidates import CandidateCheck, first_choice
from regrasp_opt.motion.refinement.choice import States, unreachable

SHORT = SearchOptions(starts=1, rounds=1)


@pytest.fixture
def check(bottle_plan):
    return CandidateCheck(bottle_plan, MeasureBounds())


def test_the_plans_own_choice_is_verified(check, bottle_plan):
    found = check.candidate(bottle_plan.xi, first_choice(bottle_plan))
    assert found is not None and check.refused == "" and found.measures.clearance > 0


def test_poses_that_cannot_be_are_named(check, bottle_plan):
    choice = first_choice(bottle_plan)
    assert check.candidate(bottle_plan.xi + 5.0, choice) is None
    assert check.refused == "a pose lies outside the workspace"
    assert check.candidate(IN_THE_BASE[None], choice) is None
    assert check.refused == "pose 1: the object is too near to an obstacle, the base or the table's edge"


def test_configurations_that_cannot_be_are_named(check, bottle_plan):
    choice = first_choice(bottle_plan)
    robot = bottle_plan.problem.workcell.robot
    q = choice.q.copy()
    q[0, 1] = robot.upper + 0.25 * np.eye(6)[2]
    assert check.candidate(bottle_plan.xi, replace(choice, q=q)) is None
    assert check.refused == "transition 0, place: a joint is 0.25 rad beyond its limit"
    q = choice.q.copy()
    q[1, 0] = [0.0, 2.0, 0.5, 0.0, 0.0, 0.0]  # through the table
    assert check.candidate(bottle_plan.xi, replace(choice, q=q)) is None
    assert check.refused == "transition 1, pick: bodies are nearer than their clearance"


def test_a_configuration_that_cannot_be_put_on_its_grasp_leaves_the_poses_and_is_named(bottle_plan, monkeypatch):
    monkeypatch.setattr(joint_search, "PLACED", 0.0)  # no residual is that small
    result = refine_plan(bottle_plan, options=SHORT)
    assert "transition 0: the arm misses the grasp by" in result.reason
    np.testing.assert_array_equal(result.plan.poses, bottle_plan.poses)


def test_a_plan_is_refined_without_any_energy(bottle_plan, monkeypatch):
    """Only the joint travel counts then, and the cost is that of the plan."""
    monkeypatch.setattr("regrasp_opt.planning.problem_data.find_arm_energy", lambda _: None)
    plan = replace(bottle_plan, problem=replace(bottle_plan.problem, model_folder=None))
    result = refine_plan(plan, options=SHORT)
    assert result.reason == "" and result.after.travel < result.before.travel
    assert result.plan.cost == bottle_plan.cost and result.plan.residuals().hold


def test_a_weight_below_zero_is_refused():
    for weight in (-0.1, float("nan")):
        with pytest.raises(OptionError, match="cost_weight is"):
            SearchOptions(cost_weight=weight)


def test_why_no_choice_keeps_to_the_bounds_is_told_apart():
    q = np.zeros((2, 6))
    states = States(np.array([0, 1]), q, np.array([0.01, 0.05]), np.array([0.2, 0.1]))
    assert unreachable([(states, states)], MeasureBounds(clearance=0.1)).startswith(
        "transition 0: the clearance of its best"
    )
    both = MeasureBounds(clearance=0.04, manipulability=0.15)  # each by another grasp
    assert unreachable([(states, states)], both).endswith("keeps to the bounds on clearance and manipulability at once")
    nothing = states.where(np.zeros(2, dtype=bool))
    said = unreachable([(states, states), (states, nothing)], MeasureBounds())
    assert said == "transition 1: no shared grasp has a free configuration"
