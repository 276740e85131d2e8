"""What obstacles rule out is infeasible by the exact check, and much of what they make infeasible is ruled out."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from regrasp_opt import RegraspProblem, solve_sequence
from regrasp_opt.connectivity import BLOCKED, exact_energy
from regrasp_opt.conventions import planar_transform, translation
from regrasp_opt.feasibility.dataset import random_poses
from regrasp_opt.geometry.shapes import Box, Cylinder, Mesh
from regrasp_opt.planning.tasks import random_task

SCENES = Path(__file__).parents[2] / "docs" / "scenes"
SPHERE = trimesh.creation.icosphere(2, 0.08)
SHAPES = {
    "box": Box("box", np.array([0.15, 0.1, 0.25]), translation(0.15, 0.35, 0.125)),
    "cylinder": Cylinder("cylinder", 0.06, 0.3, translation(-0.15, 0.4, 0.15)),
    "mesh": Mesh("mesh", np.array(SPHERE.vertices), np.array(SPHERE.faces), translation(0.0, 0.45, 0.1)),
    "hanging": Box("hanging", np.array([0.3, 0.3, 0.05]), translation(0.3, 0.4, 0.3)),
}


@pytest.mark.parametrize("tool", ["nova2-w", "nova2-s1"])
@pytest.mark.parametrize("name", SHAPES)
def test_nothing_feasible_is_ruled_out_and_much_of_the_rest_is(tool, name):
    base = RegraspProblem.load("mug", tool)
    problem = base.with_obstacles([SHAPES[name]])
    numbers, xi = random_poses(problem.placement_poses, problem.workcell.bounds.array, 80, np.random.default_rng(2))
    T = planar_transform(xi) @ problem.placement_poses[numbers]
    before, after = (np.array([each.feasible_grasps(pose) for pose in T]) for each in (base, problem))
    ruled_out = problem.ruled_out(numbers, xi)
    assert not (ruled_out & after).any()
    lost = before & ~after
    assert lost.sum() > 50 and (ruled_out & lost).sum() > 0.25 * lost.sum()
    np.testing.assert_array_equal(base.ruled_out(numbers, xi), base.ruled_out(numbers, xi) & ruled_out)


@pytest.mark.parametrize("scene", ["shelf", "tilted-plate", "shelf-between"])
def test_supports_that_the_object_is_not_on_are_obstacles(scene):
    """Without the rule about them, the search would have to find out by exact checks."""
    problem = RegraspProblem.load("bottle", SCENES / f"{scene}.toml")
    numbers, xi = problem.rests.planar.draw(80, np.random.default_rng(2))
    after = np.array([problem.feasible_grasps(T) for T in problem.rests.planar.at(numbers, xi)])
    known, ruled_out = problem.rules.free_space(numbers, xi), problem.ruled_out(numbers, xi)
    assert not (ruled_out & after).any()
    assert (ruled_out & ~known).sum() > 0.1 * (~after & ~known).sum()


def test_only_candidates_are_asked_about():
    problem = RegraspProblem.load("mug", "nova2-w").with_obstacles([SHAPES["box"]])
    numbers, xi = np.array([0, 0]), np.array([[0.15, 0.2, 0.3], [-0.4, 0.3, 0.0]])
    asked = np.zeros((2, len(problem.grasps)), dtype=bool)
    asked[0, ::2] = True
    found = problem.rules.behind_obstacles(numbers, xi, asked)
    everything = problem.rules.behind_obstacles(numbers, xi, np.ones_like(asked))
    assert everything[0].any() and not everything[1].any()
    np.testing.assert_array_equal(found[0], everything[0] & asked[0])


def test_with_one_regrasp_obstacles_are_asked_about_grasps_of_start_or_goal_only():
    problem = RegraspProblem.load("mug", "nova2-w").with_obstacles([SHAPES["box"], SHAPES["mesh"]])
    numbers, xi = random_poses(problem.placement_poses, problem.workcell.bounds.array, 30, np.random.default_rng(3))
    everything, free = problem.ruled_out(numbers, xi), problem.rules.free_space(numbers, xi)
    there = problem.rules.behind_obstacles(numbers, xi, np.zeros_like(free)).any(axis=1)  # the object is in an obstacle
    start, goal = (problem.feasible_grasps(T) for T in problem.rests.planar.at(numbers[:2], xi[:2]))
    useful = start | goal
    objective = problem.objective(exact_energy(start), exact_energy(goal))
    alone, pairs = objective.ruled_out(numbers[:, None], xi[:, None])[:, 0], objective.ruled_out(numbers, xi)
    np.testing.assert_array_equal(alone[:, useful], everything[:, useful])
    np.testing.assert_array_equal(alone[~there][:, ~useful], free[~there][:, ~useful])
    np.testing.assert_array_equal(pairs, everything)
    assert (everything & ~free)[:, useful].any() and (everything & ~alone)[:, ~useful].any()

    lattice = problem.lattice
    asked = np.arange(0, len(lattice.xi), 40)
    before = lattice.energies.copy()
    ids = np.flatnonzero(useful)
    np.testing.assert_array_equal(np.setdiff1d(lattice.settle(asked, ids), asked), [])
    blocked = (lattice.energies >= BLOCKED) & (before < BLOCKED)
    whole = problem.ruled_out(lattice.placements[asked], lattice.xi[asked])
    expected = whole & (before[asked] < 10.0) & useful
    np.testing.assert_array_equal(blocked[asked] & useful & (before[asked] < 10.0), expected)
    assert expected.any() and not np.delete(blocked, asked, axis=0).any()
    assert len(lattice.settle(asked, ids)) == 0 and len(lattice.settle(asked, np.arange(len(useful)))) > 0


def test_where_the_object_is_in_an_obstacle_every_grasp_is_ruled_out():
    problem = RegraspProblem.load("mug", "nova2-w").with_obstacles([SHAPES["box"]])
    assert problem.ruled_out(np.array([0]), np.array([[0.15, 0.35, 0.0]])).all()


def test_the_same_seed_gives_the_same_plan_however_often_it_is_asked_for():
    problem = RegraspProblem.load("mug", "nova2-w").with_obstacles([SHAPES["box"], SHAPES["cylinder"]])
    rng = np.random.default_rng(4)
    for _ in range(3):
        task = random_task(problem, rng, needs_regrasp=True)
        first, second = (solve_sequence(problem, task.start, task.goal, seed=1) for _ in range(2))
        np.testing.assert_array_equal(first.poses, second.poses)
        assert first.solved and first.residuals().hold
