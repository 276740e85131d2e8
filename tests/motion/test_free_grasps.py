"""Free grasps: settled by the sampler's rules, with derivatives that hold, and plans where ten grasps hold none."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from regrasp_opt import RegraspPlan, RegraspProblem, Status, solve_sequence
from regrasp_opt.energy.export import grasp_function
from regrasp_opt.errors import OptionError
from regrasp_opt.grasps import gripper_free
from regrasp_opt.grasps.antipodal import FRICTION, contact_depths
from regrasp_opt.grasps.clearance import WIDENINGS
from regrasp_opt.grasps.projection import GraspProjector
from regrasp_opt.grasps.suction import NO_SEAL
from regrasp_opt.motion import FreeGraspOptions, solve_with_free_grasps
from regrasp_opt.motion.free_grasps.program import STEP, ChainSolve, FreeGraspProgram, displaced, random_move
from regrasp_opt.planning.tasks import random_task


def moved(T, rng, count, kind="parallel"):
    """Return `count` tool poses (count, 4, 4) off the surface, near random ones of `T`."""
    D = np.tile(np.eye(4), (count, 1, 1))
    D[:, :3, :3] = Rotation.from_rotvec(rng.normal(size=(count, 3)) * [0.1, 0.5, 0.1]).as_matrix()
    D[:, :3, 3] = 0.01 * rng.normal(size=(count, 3))
    return T[rng.integers(len(T), size=count)] @ D


def contacts_hold(body, effector, T, width):
    """Whether two contacts face each other inside their friction cones, by trimesh's ray casting."""
    for depth in contact_depths(effector):
        middle = T[:3, 3] + depth * T[:3, 2]
        origin = middle - 0.3 * T[:3, 1]
        points, _, faces = body.mesh.ray.intersects_location(origin[None], T[None, :3, 1], multiple_hits=True)
        along = (np.reshape(points, (-1, 3)) - middle) @ T[:3, 1]
        facing = body.mesh.face_normals[faces] @ T[:3, 1]
        for widening in WIDENINGS:
            half = (width - widening) / 2
            ends = [
                (np.abs(along - sign * half) < 1e-6) & (sign * facing >= np.cos(np.arctan(FRICTION)) - 1e-9)
                for sign in (-1, 1)
            ]
            if all(end.any() for end in ends):
                return True
    return False


@pytest.mark.parametrize("name", ["bottle", "mug"])
def test_settled_grasps_keep_the_rules_of_the_sampler(name):
    problem = RegraspProblem.load(name, "nova2-w")
    body, effector = problem.object, problem.workcell.end_effector
    projector = GraspProjector(body, effector)
    tools = moved(problem.grasps.T_object_tcp, np.random.default_rng(0), 60)
    grasps, source = projector.settle(tools)
    assert 10 < len(grasps) < 60 and (np.diff(source) > 0).all()
    assert gripper_free(grasps, body, effector).all()
    assert (grasps.width + 2 * effector.pre_opening <= effector.max_opening + 1e-9).all()
    assert all(contacts_hold(body, effector, T, w) for T, w in zip(grasps.T_object_tcp, grasps.width, strict=True))
    assert np.linalg.norm(grasps.T_object_tcp[:, :3, 3] - tools[source, :3, 3], axis=1).max() < 0.05


def test_a_sampled_grasp_settles_where_it_is(bottle_problem):
    projector = GraspProjector(bottle_problem.object, bottle_problem.workcell.end_effector)
    sampled = bottle_problem.grasps.subset(np.arange(0, 200, 10))
    grasps, source = projector.settle(sampled.T_object_tcp)
    np.testing.assert_array_equal(source, np.arange(len(sampled)))
    np.testing.assert_allclose(grasps.T_object_tcp, sampled.T_object_tcp, atol=2e-3)
    np.testing.assert_allclose(grasps.width, sampled.width, atol=max(WIDENINGS) + 1e-9)


def test_tools_beside_the_object_settle_nowhere(bottle_problem):
    projector = GraspProjector(bottle_problem.object, bottle_problem.workcell.end_effector)
    far = np.eye(4)
    far[:3, 3] = 1.0
    grasps, source = projector.settle(far[None])
    assert len(grasps) == len(source) == 0
    assert len(projector.settle(np.zeros((0, 4, 4)))[0]) == 0


def test_suction_grasps_settle_on_the_surface_and_seal():
    problem = RegraspProblem.load("bottle", "nova2-s1")
    projector = GraspProjector(problem.object, problem.workcell.end_effector)
    grade = projector.worst_grade(problem.grasps)
    assert 0 <= grade < NO_SEAL
    grasps, _ = projector.settle(moved(problem.grasps.T_object_tcp, np.random.default_rng(1), 40), grade)
    assert len(grasps) > 10 and (grasps.width == 0).all()
    assert gripper_free(grasps, problem.object, problem.workcell.end_effector).all()
    _, distance, _ = trimesh.proximity.closest_point(problem.object.mesh, grasps.T_object_tcp[:, :3, 3])
    assert distance.max() < 1e-6
    assert projector.worst_grade(grasps) <= grade


@pytest.mark.parametrize("kind", ["parallel", "suction"])
def test_a_chain_becomes_cheaper_within_its_steps(bottle_problem, kind):
    problem, energy = bottle_problem, bottle_problem.energy
    program = FreeGraspProgram(energy.model, 1, kind)
    ends = np.array([problem.pose(0, -0.2, 0.4), problem.pose(1, 0.2, 0.4)])
    grasps = problem.grasps.subset([3, 50])
    placements, bounds = problem.rests.planar[[2]], problem.workcell.bounds.array
    start = ChainSolve(np.array([[0.0, 0.3, 0.5]]), np.zeros((2, 6)), np.inf)

    def cost(solve):
        poses = [ends[0], problem.pose(2, *solve.xi[0]), ends[1]]
        T = np.array([displaced(g, d) for g, d in zip(grasps.T_object_tcp, solve.steps, strict=True)])
        free = grasp_function(energy.model)
        pairs = [(poses[i + side], T[i], grasps.width[i]) for i in (0, 1) for side in (0, 1)]
        return sum(float(free(*pair)) for pair in pairs) + 0.1 * (solve.steps**2).sum()

    found = program.solve(placements, ends, grasps.T_object_tcp, grasps.width, start)
    assert found.cost == pytest.approx(cost(found), rel=1e-6)
    assert found.cost < cost(start)
    assert np.abs(found.steps).max() <= 1 + 1e-6
    assert np.abs(found.steps[:, 1 if kind == "parallel" else 2]).max() < 1e-6
    assert (found.xi[:, :2] >= bounds[0] - 1e-6).all() and (found.xi[:, :2] <= bounds[1] + 1e-6).all()
    assert STEP.shape == (6,)


@pytest.fixture(scope="module")
def thinned(bottle_problem):
    """Return a bottle problem of ten grasps, and ends between which these hold no plan."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        task = random_task(bottle_problem, rng, needs_regrasp=True)
        ids = np.sort(rng.permutation(len(bottle_problem.grasps))[:10])
        problem = replace(bottle_problem, grasps=bottle_problem.grasps.subset(ids))
        if not solve_sequence(problem, task.start, task.goal, max_regrasps=1).solved:
            return problem, task
    raise AssertionError("ten grasps always hold a plan")


def test_free_grasps_plan_where_ten_sampled_ones_cannot(thinned, tmp_path):
    problem, task = thinned
    plan = solve_with_free_grasps(problem, task.start, task.goal, max_regrasps=1)
    assert plan.status is Status.SOLVED
    grown = plan.problem.grasps
    np.testing.assert_array_equal(grown.T_object_tcp[:10], problem.grasps.T_object_tcp)
    used = np.unique(np.concatenate([t.grasp_ids for t in plan.transitions]))
    assert set(range(10, len(grown))) <= set(used.tolist()) and used.max() >= 10
    body, effector = problem.object, problem.workcell.end_effector
    for k in range(10, len(grown)):
        assert contacts_hold(body, effector, grown.T_object_tcp[k], grown.width[k])
    assert plan.residuals().hold
    plan.save(tmp_path / "plan.json")
    loaded = RegraspPlan.load(tmp_path / "plan.json")
    assert loaded.solved and loaded.residuals().hold
    again = solve_with_free_grasps(problem, task.start, task.goal, max_regrasps=1)
    np.testing.assert_array_equal(again.poses, plan.poses)


def out_of_reach(self, placements, ends, T, width, start):
    return start._replace(xi=start.xi + 10.0, steps=np.zeros_like(start.steps))


def test_where_no_chain_holds_the_planner_searches_the_grown_set(thinned, monkeypatch):
    problem, task = thinned
    monkeypatch.setattr(FreeGraspProgram, "solve", out_of_reach)
    options = FreeGraspOptions(rounds=3, chains=1, steps=1, searches=())
    assert not solve_with_free_grasps(problem, task.start, task.goal, max_regrasps=1, options=options).solved
    options = replace(options, searches=(1, 2, 3))
    plan = solve_with_free_grasps(problem, task.start, task.goal, max_regrasps=1, options=options)
    assert plan.status is Status.SOLVED and plan.residuals().hold
    used = np.unique(np.concatenate([t.grasp_ids for t in plan.transitions]))
    assert set(range(10, len(plan.problem.grasps))) <= set(used.tolist())  # no moved grasp is kept for nothing
    found = solve_sequence(plan.problem, task.start, task.goal, max_regrasps=1)
    assert found.solved and found.num_regrasps == plan.num_regrasps


def test_without_regrasps_one_free_grasp_must_do_for_both_ends(bottle_problem):
    problem = replace(bottle_problem, grasps=bottle_problem.grasps.subset([0, 1]))
    tasks = (random_task(bottle_problem, np.random.default_rng(k), needs_regrasp=False) for k in range(20))
    task = next(task for task in tasks if not problem.feasible_grasps(task.start).any())
    plan = solve_with_free_grasps(problem, task.start, task.goal, max_regrasps=0)
    assert plan.solved and plan.num_regrasps == 0 and len(plan.problem.grasps) > 2
    assert plan.residuals().hold


def test_suction_grasps_are_drawn_from_the_surface():
    problem = RegraspProblem.load("bottle", "nova2-s1")
    projector = GraspProjector(problem.object, problem.workcell.end_effector)
    T, width = projector.anywhere(40, np.random.default_rng(0))
    assert len(T) == 40 and (width == 0).all()
    _, distance, face = trimesh.proximity.closest_point(problem.object.mesh, T[:, :3, 3])
    assert distance.max() < 1e-6
    inward = -np.einsum("ij,ij->i", T[:, :3, 2], problem.object.mesh.face_normals[face])
    assert np.quantile(inward, 0.2) > 0.99  # but for points on an edge, which belong to two faces
    assert len(projector.settle(T, projector.worst_grade(problem.grasps))[0]) > 5


def test_random_moves_slide_contacts_along_the_surface():
    rng = np.random.default_rng(0)
    for _ in range(20):
        parallel, suction = random_move("parallel", rng), random_move("suction", rng)
        np.testing.assert_allclose(np.abs(parallel[:3, 1]), [0.0, 1.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(suction[:3, 2], [0.0, 0.0, 1.0], atol=1e-12)
        assert parallel[1, 3] == suction[2, 3] == 0
        for D in (parallel, suction):
            assert np.linalg.det(D[:3, :3]) == pytest.approx(1.0) and np.abs(D[:3, 3]).max() < 0.2


def test_a_plan_of_the_sampled_grasps_is_returned_as_it_is(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=False)
    plan = solve_with_free_grasps(bottle_problem, task.start, task.goal)
    assert plan.solved and plan.problem is bottle_problem


def test_without_success_the_status_says_why(thinned, monkeypatch):
    problem, task = thinned
    monkeypatch.setattr(
        GraspProjector, "settle", lambda self, T, grade=0: (problem.grasps.subset([]), np.zeros(0, int))
    )
    options = FreeGraspOptions(rounds=1, chains=2, searches=())
    plan = solve_with_free_grasps(problem, task.start, task.goal, max_regrasps=1, options=options)
    assert plan.status in (Status.START_INFEASIBLE, Status.GOAL_INFEASIBLE, Status.NOT_FOUND)
    assert plan.transitions == () and plan.problem is problem


def test_options_are_checked():
    with pytest.raises(OptionError, match="rounds is 0"):
        FreeGraspOptions(rounds=0)
