"""Every pose of a plan is carried by a support: none beside it, rocking on it, or moved into a workspace."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from oracles.plans import verify_plan

from regrasp_opt import RegraspProblem, Status, solve_sequence
from regrasp_opt.conventions import translation
from regrasp_opt.errors import PoseError
from regrasp_opt.feasibility.standing import rest_problem
from regrasp_opt.planning.tasks import random_task

CELL = """
schema = 2
[[arms]]
robot = "nova2"
end_effector = "w"
[[supports]]
name = "table"
center = [0.0, 0.35]
size = [1.4, 1.2]
workspace = { x = [-0.4, 0.4], y = [0.15, 0.55] }
"""
POST = """
[[supports]]
name = "post"
height = 0.10
center = [0.2, 0.35]
size = [0.03, 0.03]
thickness = 0.05
"""
PLATE = """
[[supports]]
name = "plate"
height = 0.12
center = [0.36, 0.35]
size = [0.24, 0.24]
rpy = [0.25, 0.0, 0.0]
"""
NEST = """
[[supports]]
kind = "fixture"
name = "nest"
position = [0.2, 0.35, 0.0]
bodies = [
    { type = "box", name = "back", position = [0.0, 0.0365, 0.01], size = [0.06, 0.01, 0.02] },
    { type = "box", name = "side", position = [0.0365, 0.0, 0.01], size = [0.01, 0.06, 0.02] },
]
poses = [{ name = "upright", position = [0.0, 0.0, 0.0], object = "bottle" }]
"""


def sound(plan, path):
    """Return whether certificate and verifier confirm a plan."""
    plan.save(path / "plan.json")
    return plan.solved and plan.residuals().hold and verify_plan(path / "plan.json") == []


@pytest.fixture
def cell(tmp_path):
    def load(thing, supports):
        path = tmp_path / "cell.toml"
        path.write_text(CELL + supports, encoding="utf-8")
        return RegraspProblem.load(thing, path)

    return load


def test_a_post_narrower_than_the_rim_carries_no_mug(cell, tmp_path):
    """The mug's rim is hollow: on the post it would drop over it."""
    problem = cell("mug", POST)
    T = problem.pose(1, 0.2, 0.35, 0.3, support="post")
    assert problem.checker.object_problem(T) == "stands over the edge of the post"
    with pytest.raises(PoseError, match="over the edge of the post at the start"):
        solve_sequence(problem, T, problem.pose(0, -0.2, 0.35))
    rng = np.random.default_rng(2)
    task = random_task(problem, rng, needs_regrasp=True)
    for refiner in ("ipopt", "exact"):
        plan = solve_sequence(problem, task.start, task.goal, refiner, supports=["post"], max_regrasps=1)
        assert plan.status is Status.NOT_FOUND
    plan = solve_sequence(problem, task.start, task.goal)
    assert sound(plan, tmp_path)
    number = problem.rests.number("post", 1)
    poses, xi = plan.poses.copy(), plan.xi.copy()
    poses[1], xi[0] = T, (0.2, 0.35, 0.3)
    forged = replace(plan, poses=poses, xi=xi, placements=np.array([number, *plan.placements[1:]]))
    said = forged.residuals().problems
    assert "the object stands over the edge of the post at pose 1" in said
    poses[1] = translation(0.0, 0.0, 0.05) @ T
    said = replace(forged, poses=poses).residuals().problems
    assert any("does not touch the post at pose 1" in text for text in said)


def test_what_would_rock_on_a_tilted_plate_is_not_put_there(cell, tmp_path):
    """The margin is that of the whole slightly round bottom; what touches is its middle."""
    angles = np.arange(48) * (np.pi / 24)
    ring = 0.055 * np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    points = np.concatenate([[[0.0, 0.0, -0.055 * np.tan(np.radians(1.38))]], ring, 0.5 * ring + (0.0, 0.0, 0.06)])
    can = tmp_path / "can.stl"
    trimesh.convex.convex_hull(points).export(can)
    problem, level = cell(can, PLATE), cell(can, "")
    assert len(level.rests) == len(level.object.placements) > 0
    steep = [p.margin - problem.workcell.supports[1].slope >= 0.1 for p in problem.object.placements]
    assert any(steep) and sum(rest.support.name == "plate" for rest in problem.rests) < sum(steep)
    rng = np.random.default_rng(0)
    for T in (problem.rests.planar.at(*each) for each in zip(*problem.rests.planar.draw(100, rng), strict=True)):
        assert "tip" not in (rest_problem(T, problem.object, problem.workcell) or "")


def test_an_object_outside_the_workspace_is_not_moved_into_it(cell):
    """To grasp where it is not would be wrong, however near."""
    problem = cell("bottle", "")
    inside = problem.pose(0, -0.1, 0.35)
    for beyond in (0.0002, 0.004):
        with pytest.raises(PoseError, match="outside the workspace"):
            solve_sequence(problem, problem.pose(0, 0.4 + beyond, 0.3, 0.3), inside)
        with pytest.raises(PoseError, match="outside the workspace"):
            solve_sequence(problem, translation(0.0, 0.0, 0.002) @ problem.pose(0, 0.4 + beyond, 0.3, 0.3), inside)
    lifted = translation(0.0, 0.0, 0.002) @ problem.pose(0, 0.399, 0.3, 0.3)
    np.testing.assert_allclose(problem.at_rest(lifted).xi, (0.399, 0.3, 0.3), atol=1e-9)


@pytest.mark.parametrize("height", [0.0, -0.002])
def test_a_nest_whose_object_touches_the_table_holds_it(cell, height, tmp_path):
    supports = NEST.replace("0.35, 0.0]", f"0.35, {-height}]", 1)
    problem = cell("bottle", supports)
    number = problem.rests.number("nest", 0)
    T = problem.rests.planar.at(number, np.zeros(3))
    assert problem.station(T).support == "nest" and problem.checker.object_problem(T) is None
    plan = solve_sequence(problem, problem.pose(0, -0.2, 0.35), T)
    assert sound(plan, tmp_path)


@pytest.mark.parametrize("off", [1e-6, 5e-6, 9e-5, 1e-3])
def test_a_pose_in_a_nest_may_be_rounded(cell, off):
    problem = cell("bottle", NEST.replace("0.35, 0.0]", "0.35, 0.03]", 1))
    T = problem.rests.planar.at(problem.rests.number("nest", 0), np.zeros(3))
    goal = translation(off, 0.0, 0.0) @ T
    plan = solve_sequence(problem, problem.pose(0, -0.2, 0.35), goal)
    assert plan.solved
    np.testing.assert_allclose(plan.poses[-1], T, atol=1e-6)


@pytest.mark.parametrize(("step", "up"), [(0.0, 0.002), (0.004, 0.003), (0.004, 0.004)])
def test_what_was_measured_above_one_board_does_not_mean_the_one_beside_it(tmp_path, step, up):
    """Though the plane of that one may be nearer."""
    board = '[[supports]]\nname = "{}"\nheight = {}\ncenter = [{}, 0.35]\nsize = [0.49, 0.6]\n'
    arm = 'schema = 2\n[[arms]]\nrobot = "nova2"\nend_effector = "w"\n'
    path = tmp_path / "cell.toml"
    path.write_text(arm + board.format("left", 0.0, -0.25) + board.format("right", step, 0.25), encoding="utf-8")
    problem = RegraspProblem.load("bottle", path)
    T = problem.pose(0, -0.25, 0.35)
    lifted = translation(0.0, 0.0, up) @ T
    found = problem.at_rest(lifted)
    assert (found.support, found.placement, found.inside) == ("left", 0, True)
    plan = solve_sequence(problem, lifted, problem.pose(1, 0.2, 0.35, support="right"))
    np.testing.assert_allclose(plan.poses[0], T, atol=1e-9)


def test_a_placement_that_rocks_is_none_on_a_level_table_either(tmp_path):
    """Its lower side counts as one face, on which it is stable, but it would lean away from the points that touch."""
    lower = [(-18.0, -19.8, 0.3), (-3.6, -37.4, 0.5), (-58.6, -16.8, 1.4), (33.5, -54.6, 1.5), (-9.4, -64.0, 1.5)]
    middle = [(-42.6, -57.1, 1.9), (73.3, -68.0, 3.7), (-78.8, 63.7, 3.8)]
    upper = [(-42.4, 58.1), (3.0, 18.8), (-36.3, 34.1), (-31.6, 22.0), (-21.7, 20.0)]
    points = np.array([*lower, *middle, *((x, y, 24.3) for x, y in upper)])
    trimesh.convex.convex_hull(points / 1000).export(tmp_path / "slab.stl")
    problem = RegraspProblem.load(tmp_path / "slab.stl", "nova2-w")
    poses = [problem.pose(number, 0.1, 0.35, 0.4) for number in range(len(problem.object.placements))]
    stable = [rest_problem(T, problem.object, problem.workcell) is None for T in poses]
    assert stable == [True, True, False]
    assert [rest.placement for rest in problem.rests] == [0, 1]
