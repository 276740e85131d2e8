"""The verification of a plan: true plans hold, and every kind of false claim is found and named."""

import re
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.scene import Support


@pytest.mark.parametrize("name", ["bottle", "mug", "pentagon", "figurine"])
def test_every_accepted_transition_holds(name):
    problem, rng = RegraspProblem.load(name, "nova2-w"), np.random.default_rng(7)
    task = random_task(problem, rng, needs_regrasp=True)
    plan = solve_sequence(problem, task.start, task.goal)
    residuals = plan.residuals()
    assert plan.solved and residuals.hold, residuals.problems
    assert len(residuals.transitions) == plan.num_regrasps + 1
    for transition, certificate in zip(plan.transitions, residuals.transitions, strict=True):
        shape = (len(transition.grasp_ids), 2)
        assert certificate.position_error.shape == certificate.rotation_error.shape == shape
        assert certificate.limit_margin.shape == certificate.collision_margin.shape == shape
        assert certificate.position_error.max() < 1e-6 and certificate.rotation_error.max() < 1e-6
        assert certificate.limit_margin.min() >= -1e-9
        assert certificate.collision_margin.min() > -1e-4
    assert (residuals.placement_error < 1e-6).all()


def with_transition(plan, i, **changes):
    transitions = list(plan.transitions)
    transitions[i] = replace(transitions[i], **changes)
    return replace(plan, transitions=tuple(transitions))


def only_problem(plan, i):
    """Return what the residuals say, having asserted that all of it is about transition `i`."""
    residuals = plan.residuals()
    assert not residuals.hold
    assert all(text.startswith(f"transition {i}:") for text in residuals.problems), residuals.problems
    return residuals.problems


@pytest.mark.parametrize("i", [0, 1])
@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("side", ["q_pick", "q_place"])
def test_a_joint_off_by_a_tenth(plan, i, joint, side):
    q = getattr(plan.transitions[i], side).copy()
    q[-1, joint] += 0.1 if q[-1, joint] < 0 else -0.1
    grasp = plan.transitions[i].grasp_ids[-1]
    text = only_problem(with_transition(plan, i, **{side: q}), i)[0]
    assert f"grasp {grasp} at its {side.removeprefix('q_')}" in text and "misses the grasp" in text


def test_a_joint_beyond_its_limit(plan):
    q = plan.transitions[0].q_place.copy()
    q[0, 3] += 4 * np.pi
    problems = only_problem(with_transition(plan, 0, q_place=q), 0)
    assert len(problems) == 1 and "beyond its limit" in problems[0]


def test_a_swapped_grasp(plan):
    ids = plan.transitions[1].grasp_ids.copy()
    ids[0] = next(g for g in range(len(plan.problem.grasps)) if g not in ids)
    assert any("misses the grasp" in text for text in only_problem(with_transition(plan, 1, grasp_ids=ids), 1))


def test_a_transition_without_grasps(plan):
    none = np.zeros((0, 6))
    empty = with_transition(plan, 1, grasp_ids=np.zeros(0, np.int64), q_pick=none, q_place=none, clearance=np.zeros(0))
    assert only_problem(empty, 1) == ("transition 1: no grasp is shared by its two poses",)


def test_a_claimed_clearance_that_is_too_large(plan):
    boast = plan.transitions[0].clearance + 0.01
    assert all("clearance" in text for text in only_problem(with_transition(plan, 0, clearance=boast), 0))


@pytest.mark.parametrize("i", [0, 1, 2])
def test_a_moved_pose_touches_the_transitions_on_both_sides(plan, i):
    assert plan.num_regrasps == 1
    poses = plan.poses.copy()
    poses[i, 0, 3] += 1e-3
    problems = replace(plan, poses=poses).residuals().problems
    named = {text.split(":")[0] for text in problems if text.startswith("transition")}
    assert named == {f"transition {k}" for k in (i - 1, i) if 0 <= k <= 1}
    assert any("stable placement" in text for text in problems) == (i == 1)


def test_the_cost_is_a_record_that_no_verification_looks_at(plan):
    assert replace(plan, cost=plan.cost + 1.0).residuals().problems == plan.residuals().problems == ()


def test_a_pose_that_is_no_placement_or_outside(plan):
    off, unknown = plan.xi.copy(), plan.placements.copy()
    off[0, 0] += 0.01
    unknown[0] = 99
    assert any(
        re.fullmatch("pose 1 is .* away from stable placement .*", text)
        for text in replace(plan, xi=off).residuals().problems
    )
    assert "pose 1 names placement 99, which does not exist" in replace(plan, placements=unknown).residuals().problems
    outside, poses = plan.xi.copy(), plan.poses.copy()
    outside[0, 0] += 1.0
    poses[1, 0, 3] += 1.0
    assert "pose 1 lies outside the workspace" in replace(plan, xi=outside, poses=poses).residuals().problems


@pytest.mark.parametrize("i", [0, 1, 2])
def test_an_object_over_the_edge_of_the_table(plan, i):
    T, body, cell = plan.poses[i], plan.problem.object, plan.problem.workcell
    vertices = body.vertices @ T[:3, :3].T + T[:3, 3]

    def refused(points, margin):
        """Whether the pose is refused on a table that reaches `margin` beyond `points`."""
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        table = Support.table(0.0, (low + high) / 2, high - low, cell.table.thickness)
        problem = replace(plan.problem, workcell=replace(cell, supports=(table,)))
        texts = replace(plan, problem=problem, transitions=()).residuals().problems
        return f"the object stands over the edge of the table at pose {i}" in texts

    assert refused(vertices[vertices[:, 2] < 1e-6, :2], -1e-4)
    assert not refused(vertices[:, :2], 1e-4)


def test_a_missing_transition(plan):
    problems = replace(plan, transitions=plan.transitions[:1]).residuals().problems
    assert problems and "3 poses but 1 transitions" in problems[0]


def test_an_arm_in_collision(plan):
    """Every branch of the arm that the checker refused is refused by the verification as well."""
    checker, transition = plan.problem.checker, plan.transitions[0]
    refused = 0
    for k, grasp in enumerate(transition.grasp_ids.tolist()):
        free = checker.configurations(plan.poses[0], np.array([grasp]))[0]
        for q in checker.branches(plan.poses[:1], np.array([grasp])).q:
            if np.abs(free - q).max(axis=1).min() > 1e-6:
                picks = transition.q_pick.copy()
                picks[k] = q
                problems = only_problem(with_transition(plan, 0, q_pick=picks), 0)
                assert any("nearer than their clearance" in text and " and " in text for text in problems)
                refused += 1
        if refused > 5:
            return
    assert refused


def test_each_intermediate_pose_is_held_against_its_own_placement(plan):
    xi = np.tile(plan.xi[:1], (3, 1))
    xi[1, 1] += 0.01
    placements = np.array([99, plan.placements[0], plan.placements[0]])
    many = replace(
        plan,
        poses=plan.poses[[0, 1, 1, 1, -1]],
        placements=placements,
        xi=xi,
        transitions=(plan.transitions[0], *3 * plan.transitions[-1:]),
    )
    residuals = many.residuals()
    np.testing.assert_allclose(residuals.placement_error, [np.inf, 0.01, 0.0], atol=1e-9)
    said = [text for text in residuals.problems if text.startswith("pose")]
    assert len(said) == 2 and "pose 1 names placement 99" in said[0] and "pose 2 is 0.01 away" in said[1]
