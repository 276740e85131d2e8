"""The joint problem: its choice held to brute force, its results verified, and failures that leave the plan alone."""

import itertools
from dataclasses import replace

import casadi as ca
import coal
import numpy as np
import pytest
from derivatives import assert_derivative
from scipy.spatial.transform import Rotation

from regrasp_opt import RegraspPlan, solve_sequence
from regrasp_opt.conventions import invert, translation
from regrasp_opt.errors import OptionError, UnknownNameError
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh, shape_geometry, surface_points
from regrasp_opt.motion import MeasureBounds, SearchOptions, refine_plan
from regrasp_opt.motion.refinement.bodies import Capsule, _to_obstacle, covering_capsule
from regrasp_opt.motion.refinement.candidates import CandidateCheck, first_choice
from regrasp_opt.motion.refinement.choice import States, best_choices, states_at, unreachable
from regrasp_opt.motion.refinement.measures import JointMeasures, manipulability, travel
from regrasp_opt.motion.refinement.program import joint_functions
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.robots import load_robot
from regrasp_opt.scene.collision_world import Body

SHORT = SearchOptions(starts=1, rounds=1)


@pytest.fixture(scope="module")
def plan(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    solved = solve_sequence(bottle_problem, task.start, task.goal, seed=0)
    assert solved.num_regrasps == 1
    return solved


@pytest.fixture(scope="module")
def refined(plan):
    return refine_plan(plan, options=SearchOptions(starts=2, rounds=2))


def random_states(rng, grasps):
    ids = rng.integers(0, 3, grasps)
    return States(ids, rng.normal(size=(grasps, 2)), rng.random(grasps), rng.random(grasps))


@pytest.mark.parametrize("home", [None, np.array([0.5, -1.0])])
@pytest.mark.parametrize("bounds", [MeasureBounds(), MeasureBounds(clearance=0.3, manipulability=0.2)])
def test_the_choice_is_the_best_of_all(home, bounds):
    rng = np.random.default_rng(1)
    for _ in range(5):
        layers = [(random_states(rng, 7), random_states(rng, 8)) for _ in range(2)]
        lengths = []
        for picks in itertools.product(*[range(len(s.q)) for pair in layers for s in pair]):
            states = [s.where(np.array([i])) for s, i in zip([s for pair in layers for s in pair], picks, strict=True)]
            good = all(s.clearance[0] >= bounds.clearance for s in states)
            good = good and all(s.manipulability[0] >= bounds.manipulability for s in states)
            same = all(states[i].grasp_ids[0] == states[i + 1].grasp_ids[0] for i in (0, 2))
            if good and same:
                lengths.append(travel(np.vstack([s.q for s in states]), home))
        found = best_choices(layers, "travel", bounds, home, 3)
        assert bool(found) == bool(lengths)
        if found:
            assert travel(found[0].q.reshape(-1, 2), home) == pytest.approx(min(lengths))
            assert all(not np.array_equal(other.grasp_ids, found[0].grasp_ids) for other in found[1:])


def test_the_choice_of_the_largest_clearance_has_it():
    rng = np.random.default_rng(2)
    pair = random_states(rng, 30), random_states(rng, 30)
    best = max(min(s.clearance[s.grasp_ids == g].max() for s in pair) for g in range(3))
    (found,) = best_choices([pair], "clearance", MeasureBounds())
    for side, states in enumerate(pair):
        k = np.flatnonzero((states.q == found.q[0, side]).all(axis=1))[0]
        assert states.clearance[k] >= best - 1e-6
    assert "short of the bound of at least 2 m" in unreachable([pair], MeasureBounds(clearance=2.0))
    assert best_choices([pair], "travel", MeasureBounds(clearance=2.0)) == []


def test_states_are_free_and_on_their_grasps(plan, bottle_problem):
    T, ids = plan.poses[1], plan.transitions[0].grasp_ids[:3]
    states = states_at(bottle_problem.checker, T, ids)
    cell = bottle_problem.workcell
    assert set(states.grasp_ids) == set(ids.tolist()) and len(states.q) > 3
    np.testing.assert_allclose(
        cell.arm.T_world_tcp(states.q), T @ bottle_problem.grasps.T_object_tcp[states.grasp_ids], atol=1e-6
    )
    for k in range(0, len(states.q), 40):
        assert bottle_problem.checker.is_free(T, int(states.grasp_ids[k]), states.q[k])


def test_the_residual_vanishes_at_the_solution_and_nowhere_else(bottle_problem):
    functions, robot = joint_functions(bottle_problem), bottle_problem.workcell.robot
    rng = np.random.default_rng(3)
    q = rng.uniform(-2, 2, 6)
    T = bottle_problem.workcell.T_world_base @ robot.forward(q)
    assert np.abs(np.array(functions.residual(q, T))).max() < 1e-12
    jacobian = np.array(functions.residual.jacobian()(q, T, 0)[0])
    assert_derivative(lambda x: np.array(functions.residual(x, T)).ravel(), jacobian, q)
    assert np.linalg.cond(jacobian) < 1e3
    assert np.abs(np.array(functions.residual(q + 0.1, T))).max() > 1e-3
    assert float(functions.manipulability(q)) == pytest.approx(manipulability(robot, q[None])[0], rel=1e-6)


def test_manipulability_falls_at_a_stretched_arm():
    robot = load_robot("nova2")
    bent, stretched = robot.home, robot.home.copy()
    stretched[2] = 0.0
    assert manipulability(robot, stretched[None])[0] < 1e-8 < manipulability(robot, bent[None])[0]


def inside(points, capsule):
    """Whether all points (P, 3) lie in a capsule."""
    along = capsule.b - capsule.a
    t = np.clip((points - capsule.a) @ along / max(along @ along, 1e-12), 0, 1)
    return (np.linalg.norm(points - capsule.a - t[:, None] * along, axis=1) <= capsule.radius + 1e-9).all()


def test_capsules_hold_their_bodies(bottle_problem):
    cell = bottle_problem.workcell
    mesh = Mesh("object", bottle_problem.object.vertices, bottle_problem.object.faces, np.eye(4))
    for shape in (*cell.end_effector.body, *cell.end_effector.finger_boxes(0.05, 0.005), cell.table.shape, mesh):
        local = replace(shape, pose=np.eye(4))
        assert inside(surface_points(local), covering_capsule(shape.name, shape_geometry(shape))), shape.name
    for item in cell.robot.collision.geometryObjects:
        capsule = covering_capsule(item.name, item.geometry)
        if isinstance(item.geometry, coal.Cylinder):
            local = Cylinder(item.name, item.geometry.radius, 2 * item.geometry.halfLength, np.eye(4))
            assert inside(surface_points(local), capsule)
        else:
            assert isinstance(item.geometry, coal.Sphere) and capsule.radius == item.geometry.radius


def test_balls_bound_the_distance_to_a_box_from_below():
    rng = np.random.default_rng(4)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = Rotation.random(rng=rng).as_matrix(), (0.1, 0.2, 0.3)
    box = Box("wall", np.array([0.1, 0.3, 0.2]), pose)
    obstacle = Body("wall", "wall", 0, box.pose, shape_geometry(box))
    for _ in range(60):
        a, b = rng.uniform(-1, 1, (2, 3))
        length = float(np.linalg.norm(b - a))
        capsule = Capsule("link", ca.DM(a), ca.DM(b), 0.05, length)
        found = min(float(ca.DM(d)) for d in _to_obstacle(capsule, obstacle))
        R = Rotation.align_vectors([(b - a) / length], [[0, 0, 1]])[0].as_matrix()
        body = coal.Capsule(0.05, length), coal.Transform3s(R, (a + b) / 2)
        wall = coal.Box(*box.size), coal.Transform3s(pose[:3, :3], pose[:3, 3])
        expected = coal.distance(*body, *wall, coal.DistanceRequest(), coal.DistanceResult())
        if expected > 0:
            assert expected - 0.01 <= found <= expected + 1e-6


def test_obstacles_are_part_of_the_rows(bottle_problem):
    post = Cylinder("post", 0.03, 0.4, translation(0.3, 0.3, 0.2))
    wall = Box("wall", np.array([0.02, 0.3, 0.15]), translation(0.0, 0.5, 0.075))
    cell = replace(bottle_problem.workcell, obstacles=(post, wall))
    problem = replace(bottle_problem, workcell=cell)
    functions = joint_functions(problem)
    names = functions.clearances.names
    assert all(any(name.endswith(f" and {o}") for name in names) for o in ("post", "wall"))
    T = problem.pose(0, 0.0, 0.3)
    values = np.array(functions.object_clearances.function(T)).ravel()
    assert values.min() > 0
    near = np.array(functions.object_clearances.function(problem.pose(0, 0.3, 0.3))).ravel()
    assert near[list(functions.object_clearances.names).index("object and post")] < 0


def test_a_plan_without_regrasps_is_refined_as_well(bottle_problem):
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=False)
    direct = solve_sequence(bottle_problem, task.start, task.goal)
    result = refine_plan(direct, options=SHORT)
    assert result.reason == "" and result.plan.num_regrasps == 0
    assert result.after.travel <= result.before.travel
    assert result.plan.residuals().hold and result.plan.cost == pytest.approx(direct.cost)


def test_the_refined_plan_travels_less_and_is_verified(plan, refined, tmp_path):
    assert refined.reason == "" and refined.plan is not plan
    assert refined.after.travel < refined.discrete.travel < refined.before.travel
    assert refined.plan.num_regrasps == plan.num_regrasps
    np.testing.assert_array_equal(refined.plan.placements, plan.placements)
    np.testing.assert_array_equal(refined.plan.poses[[0, -1]], plan.poses[[0, -1]])
    assert refined.plan.residuals().hold
    measured = CandidateCheck(refined.plan, MeasureBounds()).before
    assert measured.travel == pytest.approx(refined.after.travel)
    assert measured.clearance == pytest.approx(refined.after.clearance)
    refined.plan.save(tmp_path / "plan.json")
    assert RegraspPlan.load(tmp_path / "plan.json").residuals().hold


def test_travel_counts_the_way_from_home_and_back(plan):
    home = plan.problem.workcell.robot.home
    result = refine_plan(plan, home=home, options=SHORT)
    choice = first_choice(result.plan)
    assert result.after.travel == pytest.approx(travel(np.vstack([home, choice.q.reshape(-1, 6), home])))
    assert result.after.travel < result.before.travel


def test_what_is_held_does_not_become_worse(plan):
    result = refine_plan(plan, hold=["clearance", "manipulability"], options=SHORT)
    assert result.after.travel <= result.before.travel
    assert result.after.clearance >= result.before.clearance - 1e-6
    assert result.after.manipulability >= result.before.manipulability - 1e-6


@pytest.mark.parametrize("measure", ["clearance", "manipulability"])
def test_other_measures_grow(plan, measure):
    result = refine_plan(plan, measure, options=SHORT)
    assert getattr(result.after, measure) >= getattr(result.before, measure)
    assert result.reason == "" or np.array_equal(result.plan.poses, plan.poses)


def test_an_unreachable_clearance_is_named_with_its_shortfall(plan):
    result = refine_plan(plan, bounds=MeasureBounds(clearance=0.3), options=SHORT)
    assert result.plan is plan and result.after == result.before
    assert "the clearance of its best shared grasp is" in result.reason
    assert "short of the bound of at least 0.3 m; Ipopt ended with" in result.reason


def test_an_unreachable_travel_is_named_with_its_shortfall(plan):
    result = refine_plan(plan, "clearance", bounds=MeasureBounds(travel=0.5), options=SHORT)
    assert result.plan is plan
    assert "which misses the bound of at most 0.5 rad by" in result.reason and "; Ipopt ended with" in result.reason


@pytest.mark.parametrize(
    ("name", "bound", "said"),
    [
        ("manipulability", 0.5, "short of the bound of at least 0.5"),
        ("cost", -50.0, "which misses the bound of at most -50 by"),
    ],
)
def test_other_unreachable_bounds_are_named_with_their_shortfall(plan, name, bound, said):
    result = refine_plan(plan, bounds=MeasureBounds(**{name: bound}), options=SHORT)
    assert result.plan is plan and result.after == result.before and result.discrete is None
    assert f"the {name}" in result.reason and said in result.reason


def test_a_failure_of_ipopt_leaves_the_poses_and_the_best_choice_of_grasps(plan):
    before = plan.residuals()
    result = refine_plan(plan, options=SearchOptions(starts=1, rounds=1, ipopt={"max_iter": 1, "mu_init": 1e3}))
    assert "Maximum_Iterations_Exceeded" in result.reason
    assert result.stats[0]["status"] == "Maximum_Iterations_Exceeded"
    np.testing.assert_array_equal(result.plan.poses, plan.poses)
    assert result.after == result.discrete and result.after.travel < result.before.travel
    assert before.hold and result.plan.residuals().hold


def test_a_refusal_by_the_exact_check_leaves_the_poses_as_they_were(plan, monkeypatch):
    refusal = "transition 0, pick: bodies are nearer than their clearance"
    monkeypatch.setattr(
        CandidateCheck, "_refusal", lambda self, xi, choice: "" if np.array_equal(xi, plan.xi) else refusal
    )
    result = refine_plan(plan, options=SHORT)
    np.testing.assert_array_equal(result.plan.poses, plan.poses)
    assert result.after == result.discrete
    assert result.reason == refusal
    assert result.stats[0]["status"] == "Solve_Succeeded"


def test_a_refusal_by_the_final_verification_leaves_the_plan_as_it_was(plan, monkeypatch):
    residuals = RegraspPlan.residuals
    monkeypatch.setattr(
        RegraspPlan, "residuals", lambda self: replace(residuals(self), problems=("pose 1 lies outside the workspace",))
    )
    result = refine_plan(plan, options=SHORT)
    assert result.plan is plan
    assert result.reason == "the refined plan fails the final verification: pose 1 lies outside the workspace"


def test_a_short_step_is_taken_where_the_whole_one_is_refused(plan, monkeypatch):
    refused = []

    def refusal(self, xi, choice):
        refused.append(xi)
        return "too far" if len(refused) == 3 else ""

    monkeypatch.setattr(CandidateCheck, "_refusal", refusal)
    result = refine_plan(plan, options=SHORT)
    assert result.stats[0]["step"] == 0.5
    np.testing.assert_allclose(refused[3], (refused[0] + refused[2]) / 2)


def test_bad_input_is_refused(plan, bottle_problem):
    with pytest.raises(UnknownNameError, match="unknown measure 'speed'; known: clearance, manip"):
        refine_plan(plan, "speed")
    with pytest.raises(OptionError, match="give 6 joint values within their limits"):
        refine_plan(plan, home=np.full(6, 100.0))
    with pytest.raises(OptionError, match="home must be 6 joint values"):
        refine_plan(plan, home="robot")
    with pytest.raises(OptionError, match="give 6 joint values within their limits"):
        refine_plan(plan, home=np.full(6, np.nan))
    for name in ("travel", "clearance", "manipulability", "cost"):
        with pytest.raises(OptionError, match=f"the bound on the {name} is nan; give a number"):
            MeasureBounds(**{name: float("nan")})
    with pytest.raises(OptionError, match="cannot set up the plugin 'ipopt'"):
        refine_plan(plan, options=SearchOptions(starts=1, rounds=1, ipopt={"no_such_option": 1}))
    with pytest.raises(OptionError, match="starts is 0"):
        SearchOptions(starts=0)
    unsolved = solve_sequence(bottle_problem, plan.poses[0], plan.poses[-1], max_regrasps=0)
    with pytest.raises(OptionError, match="the plan is not solved"):
        refine_plan(unsolved)


def test_bounds_say_which_is_broken():
    measures = JointMeasures(5.0, 0.01, 0.02, -3.0)
    assert MeasureBounds().shortfall(measures) == ""
    assert (
        MeasureBounds(travel=4.0)
        .shortfall(measures)
        .startswith("the travel is 5 rad, which misses the bound of at most 4")
    )
    assert "0.01 m" in MeasureBounds(clearance=0.02).shortfall(measures)
    tight = MeasureBounds(clearance=0.005).tightened(measures, ["clearance", "travel"])
    assert (tight.clearance, tight.travel) == (0.01, 5.0)


def test_the_grasp_is_where_the_plan_says(refined):
    plan = refined.plan
    cell, grasps = plan.problem.workcell, plan.problem.grasps
    for i, transition in enumerate(plan.transitions):
        for q, T in ((transition.q_pick[0], plan.poses[i]), (transition.q_place[0], plan.poses[i + 1])):
            tcp = cell.T_world_base @ cell.robot.forward(q) @ cell.end_effector.T_flange_tcp
            np.testing.assert_allclose(invert(T) @ tcp, grasps.T_object_tcp[transition.grasp_ids[0]], atol=1e-8)
