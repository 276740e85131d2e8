"""Odd but legal input: equal ends, angles about a half turn, the workspace's edge, one grasp, the deepest search."""

import numpy as np
import pytest

from regrasp_opt import RegraspProblem, Status, solve_sequence
from regrasp_opt.conventions import planar_transform
from regrasp_opt.errors import GraspError, PoseError
from regrasp_opt.grasps import GraspSet


def test_equal_start_and_goal_need_no_regrasp(bottle_problem, task):
    plan = solve_sequence(bottle_problem, task.start, task.start)
    assert (plan.status, plan.num_regrasps) == (Status.SOLVED, 0)
    transition = plan.transitions[0]
    np.testing.assert_array_equal(transition.grasp_ids, np.flatnonzero(bottle_problem.feasible_grasps(task.start)))
    np.testing.assert_allclose(transition.q_pick, transition.q_place)
    assert plan.residuals().hold


def upright(problem):
    """Return the pose of the placement in which the bottle stands."""
    return next(T for T in problem.placement_poses if T[2, 2] > 0.99)


@pytest.mark.parametrize("yaw", [np.pi, -np.pi, np.pi - 1e-9, np.pi + 1e-9, 3 * np.pi, 0.0, 2 * np.pi])
def test_yaws_about_a_half_turn(bottle_problem, task, yaw):
    T = planar_transform([0.0, 0.35, yaw]) @ upright(bottle_problem)
    plan = solve_sequence(bottle_problem, T, task.goal, refiner="lattice")
    assert plan.solved
    assert plan.residuals().hold


def test_a_turn_makes_no_difference(bottle_problem):
    standing = upright(bottle_problem)
    sets = [
        bottle_problem.feasible_grasps(planar_transform([0.0, 0.35, yaw]) @ standing)
        for yaw in (np.pi, -np.pi, 7 * np.pi)
    ]
    assert sets[0].any()
    np.testing.assert_array_equal(sets[0], sets[1])
    np.testing.assert_array_equal(sets[0], sets[2])


def test_a_pose_on_the_edge_of_the_workspace_counts_as_inside(bottle_problem, task):
    problem = bottle_problem
    T = planar_transform([0.2, 0.3, 0.0]) @ upright(problem)
    center = (T[:3, :3] @ problem.object.center_of_mass + T[:3, 3])[:2]
    low, high = problem.workcell.bounds.array
    for axis in (0, 1):
        for side, outward in ((low, -1.0), (high, 1.0)):
            edge = T.copy()
            edge[axis, 3] += side[axis] - center[axis]
            plan = solve_sequence(problem, edge, task.goal, refiner="lattice", max_regrasps=1)
            assert plan.status in (Status.SOLVED, Status.START_INFEASIBLE, Status.NOT_FOUND)
            edge[axis, 3] += outward * 1e-6
            with pytest.raises(PoseError, match="outside the workspace"):
                solve_sequence(problem, edge, task.goal)


def test_a_pose_rounded_to_single_precision_is_accepted(bottle_problem, task, plan):
    rounded = solve_sequence(bottle_problem, task.start.astype(np.float32), task.goal.astype(np.float32).tolist())
    assert rounded.solved and rounded.num_regrasps == plan.num_regrasps
    assert rounded.residuals().hold


def test_one_grasp(bottle_problem, task):
    start = bottle_problem.feasible_grasps(task.start)
    grasp = int(np.flatnonzero(start)[0])
    problem = RegraspProblem.load("bottle", "nova2-w", grasps=bottle_problem.grasps.subset([grasp]))
    assert len(problem.grasps) == 1
    same = solve_sequence(problem, task.start, task.start)
    assert same.solved and same.transitions[0].grasp_ids.tolist() == [0]
    assert same.residuals().hold
    assert solve_sequence(problem, task.start, task.goal).status is Status.GOAL_INFEASIBLE
    assert solve_sequence(problem, task.goal, task.start).status is Status.START_INFEASIBLE


def opposed_problem(problem, task):
    """Return a problem with one grasp for each end only, of which no chain of poses can hold both."""
    ids = [int(np.flatnonzero(problem.feasible_grasps(T))[0]) for T in (task.start, task.goal)]
    return RegraspProblem.load("bottle", "nova2-w", grasps=problem.grasps.subset(ids))


def test_the_deepest_search_that_is_allowed(bottle_problem, task, plan):
    deepest = solve_sequence(bottle_problem, task.start, task.goal, max_regrasps=8)
    np.testing.assert_array_equal(deepest.poses, plan.poses)
    two = opposed_problem(bottle_problem, task)
    found = solve_sequence(two, task.start, task.goal, refiner="lattice", max_regrasps=8)
    assert found.status in (Status.NOT_FOUND, Status.SOLVED)
    assert {entry["num_regrasps"] for entry in found.refiner_stats} == set(
        range(1, 1 + (found.num_regrasps if found.solved else 8))
    )
    if found.solved:
        assert found.residuals().hold


def test_a_chain_of_eight_regrasps_can_be_refined(bottle_problem, task):
    from regrasp_opt.connectivity import CostOptions, SequenceObjective, exact_energy
    from regrasp_opt.solvers import NlpRefiner, lattice_starts

    problem = bottle_problem
    ends = [exact_energy(problem.feasible_grasps(T)) for T in (task.start, task.goal)]
    objective = SequenceObjective(problem.energy, problem.rests.planar, *ends, CostOptions())
    rng = np.random.default_rng(0)
    starts = lattice_starts(problem.lattice, objective, 8, 1, rng)
    refined = NlpRefiner().refine(objective, starts, rng).candidates
    assert refined.xi.shape == (1, 8, 3)
    assert refined.cost[0] <= starts.cost[0] + 1e-9
    low, high = problem.workcell.bounds.array
    assert (refined.xi[..., :2] >= low - 1e-9).all() and (refined.xi[..., :2] <= high + 1e-9).all()


def test_an_empty_grasp_set_is_refused(bottle_problem, task):
    none = GraspSet(np.zeros((0, 4, 4)), np.zeros(0), "parallel")
    with pytest.raises(GraspError):
        solve_sequence(RegraspProblem.load("bottle", "nova2-w", grasps=none), task.start, task.goal)
