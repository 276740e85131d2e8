"""In which order the search refines, verifies and accepts; what recipes start from; and how tasks are drawn."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from regrasp_opt import CostOptions, Recipe, Status, solve_sequence
from regrasp_opt.benchmarks.paper.cross_effector import constant_energy
from regrasp_opt.connectivity import BLOCKED, SequenceObjective
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.planning import deepening, recipes, tasks
from regrasp_opt.planning.recipes import RECIPES, as_recipe, paper_recipe
from regrasp_opt.planning.tasks import random_graspable_pose, random_task
from regrasp_opt.solvers import Candidates, LangevinRefiner, LatticeRefiner, NlpRefiner, PoseLattice, lattice_starts


class Recorder:
    """A refiner that keeps its starts and returns them as they are."""

    name = "recorder"

    def __init__(self):
        self.batches = []

    def refine(self, objective, starts, rng):
        self.batches.append(starts)
        return replace(LatticeRefiner().refine(objective, starts, rng), stats={"batch": len(starts)})


@pytest.fixture
def unprovable(monkeypatch):
    """Let no candidate be verified; return the list of their numbers of regrasps."""
    tried = []

    def refuse(poses, energies):
        assert energies.shape[0] == len(poses)
        tried.append(len(poses) - 2)
        return False

    monkeypatch.setattr(deepening, "verify_sequence", refuse)
    return tried


def test_batches_are_refined_in_turn_then_the_lattice_is_verified_then_the_search_goes_deeper(
    bottle_problem, task, unprovable
):
    recorder = Recorder()
    recipe = Recipe(recorder, batches=(2, 3), verified=2, fallback=4)
    plan = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=2)
    assert plan.status is Status.NOT_FOUND and plan.transitions == () and np.isnan(plan.cost)
    assert [len(starts) for starts in recorder.batches] == [2, 3, 2, 3]
    assert [starts.xi.shape[1] for starts in recorder.batches] == [1, 1, 2, 2]
    tried = [unprovable.count(n) for n in (1, 2)]
    assert unprovable == sorted(unprovable) and all(0 < count <= 2 + 2 + 4 for count in tried)
    assert [(entry["num_regrasps"], entry["refiner"]) for entry in plan.refiner_stats] == [
        (n, name) for n in (1, 2) for name in ("recorder", "recorder", "lattice")
    ]
    assert [entry.get("batch") for entry in plan.refiner_stats] == [2, 3, None] * 2
    assert not any("accepted" in entry for entry in plan.refiner_stats)
    chains = [starts.placements[:, 0].tolist() + starts.xi[:, 0, 0].tolist() for starts in recorder.batches[:2]]
    assert chains[0] != chains[1][: len(chains[0])]
    assert set(plan.timings) >= {"ends", "starts", "refine", "verify", "total"}


def test_what_failed_checks_find_out_is_blocked_in_the_lattice_of_this_search_alone(bottle_problem, task, monkeypatch):
    """So the chains that come next avoid it, also with more regrasps."""
    shown, blind = [], replace(bottle_problem)
    energy = ProblemEnergy(constant_energy(), blind.grasps, blind.rests.planar)
    vars(blind).update(checker=bottle_problem.checker, rules=bottle_problem.rules, energy=energy)
    free = blind.free_lattice.energies.copy()

    def starts(lattice, *rest):
        shown.append((lattice, lattice.energies.copy(), found := lattice_starts(lattice, *rest)))
        return found

    monkeypatch.setattr(deepening, "lattice_starts", starts)
    verified = deepening.verify_sequence
    monkeypatch.setattr(deepening, "verify_sequence", lambda *what: verified(*what) and False)
    monkeypatch.setattr(deepening, "PORTION", 10)
    recipe = Recipe(LatticeRefiner(), batches=(1,), verified=1, fallback=30)
    plan = solve_sequence(blind, task.start, task.goal, recipe, max_regrasps=1)
    assert plan.refiner_stats[-1]["chains"] == 30 and len(shown) == 3
    lattice, last = shown[-1][:2]
    new = np.argwhere((last >= BLOCKED) & (free < BLOCKED))
    assert len(new) > 5
    for number, grasp in new:
        T = blind.rests.planar.at(lattice.placements[number], lattice.xi[number])
        assert not blind.checker.feasible(T, np.array([grasp])).any()
    np.testing.assert_array_equal(blind.free_lattice.energies, free)


def test_without_a_fallback_nothing_unrefined_is_verified(bottle_problem, task, unprovable):
    recipe = Recipe(Recorder(), batches=(3,), verified=2, fallback=0)
    plan = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=1)
    assert len(unprovable) <= 2 and [entry["refiner"] for entry in plan.refiner_stats] == ["recorder"]


def test_a_plan_that_is_not_accepted_is_followed_by_the_next(bottle_problem, task):
    seen = []
    recipe = Recipe(Recorder(), batches=(6,), verified=6, fallback=0)

    def third(plan):
        seen.append(plan)
        return len(seen) == 3

    plan = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=1, accept=third)
    assert plan is seen[2] and all(one.solved and one.residuals().hold for one in seen)
    assert [one.cost for one in seen] == sorted(one.cost for one in seen)
    assert plan.refiner_stats[-1]["accepted"] >= 2 and plan.refiner_stats[-1]["threshold_passed"] in (0, 1)
    assert "accept" in plan.timings
    none = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=1, accept=lambda _: False)
    assert none.status is Status.NOT_FOUND
    shown = []
    direct = solve_sequence(
        bottle_problem, task.start, task.start, recipe, accept=lambda one: shown.append(one) or True
    )
    assert direct.num_regrasps == 0 and shown == [direct]


def test_the_papers_recipe_accepts_the_cheapest_below_the_threshold_and_verifies_it_once(
    bottle_problem, task, unprovable, monkeypatch
):
    recipe = Recipe(Recorder(), batches=(8,), verified=5, fallback=0, check="threshold")
    blocked = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=3)
    entry = blocked.refiner_stats[-1]
    assert blocked.status is Status.NOT_FOUND and 1 <= entry["threshold_passed"] <= 5
    assert unprovable == [entry["num_regrasps"]] and "accepted" not in entry
    monkeypatch.undo()
    plan = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=3)
    assert plan.solved and plan.refiner_stats[-1]["accepted"] >= 0
    assert plan.num_regrasps == plan.refiner_stats[-1]["num_regrasps"] and plan.residuals().hold
    never = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=3, accept=lambda _: False)
    assert never.status is Status.NOT_FOUND and len(never.refiner_stats) == len(plan.refiner_stats)
    strict = replace(bottle_problem)
    model = replace(bottle_problem.energy.model, threshold=-1.0)
    vars(strict).update(energy=type(bottle_problem.energy)(model, strict.grasps, strict.rests.planar))
    vars(strict).update(lattice=bottle_problem.lattice)
    none = solve_sequence(strict, task.start, task.goal, recipe, max_regrasps=2)
    assert none.status is Status.NOT_FOUND
    assert [entry["threshold_passed"] for entry in none.refiner_stats] == [0, 0]


def test_recipes_are_what_the_documentation_says():
    warm = LangevinRefiner(iterations=10, eta=0.1, tau=0.01, anneal=True, device="numpy")
    assert as_recipe("ipopt") == Recipe(NlpRefiner(), "lattice", (1, 1, 6), 8, 400, "verification", "exact", warm)
    assert as_recipe("ipopt").stages == ["lattice", "langevin", "ipopt"]
    assert as_recipe("langevin-ipopt") == Recipe(NlpRefiner(), "langevin", fallback=0)
    assert as_recipe("lattice") == Recipe(LatticeRefiner(), "lattice", (400,), 400, 0)
    assert as_recipe("langevin") == Recipe(LangevinRefiner(), "random", (1000,), 50, 0)
    paper = Recipe(LangevinRefiner(keep_best=False), "random", (1000,), 50, 0, "threshold", "learned")
    assert as_recipe("paper") == paper_recipe(50) == paper
    assert paper_recipe(10).verified == 10
    assert set(RECIPES) == {"ipopt", "langevin-ipopt", "lattice", "langevin", "paper"}
    recipe, refiner = Recipe(LatticeRefiner()), Recorder()
    assert as_recipe(recipe) is recipe and as_recipe(refiner).refiner is refiner


@pytest.mark.parametrize("wrong", [{"batches": ()}, {"batches": (2, 0)}, {"verified": 0}, {"fallback": -1}])
def test_recipes_out_of_range_are_refused(wrong):
    with pytest.raises(OptionError, match="a recipe needs batches and verified of at least 1"):
        Recipe(LatticeRefiner(), **wrong)
    assert Recipe(LatticeRefiner(), batches=(1,), verified=1, fallback=0).verified == 1


@pytest.fixture
def small(make_energy):
    rng = np.random.default_rng(0)
    energy, bounds = make_energy(), np.array([[-0.2, 0.1], [0.2, 0.4]])
    placements = np.array([np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])])
    planar = PlanarPoses.level(placements, bounds)
    objective = SequenceObjective(energy, planar, *rng.normal(size=(2, 12)), CostOptions())
    return objective, PoseLattice.build(energy, planar)


@pytest.mark.parametrize(("starts", "count"), [("lattice", 5), ("random", 5), ("langevin", 5)])
def test_start_points_are_as_many_as_are_refined_and_verified(small, starts, count, monkeypatch):
    monkeypatch.setattr(recipes, "LANGEVIN_SAMPLES", 16)
    objective, lattice = small
    recipe = Recipe(LatticeRefiner(), starts, batches=(2, 3), fallback=4)
    asked = []
    found = recipe.start_points(lambda: asked.append(1) or lattice, objective, 2, np.random.default_rng(3))
    assert len(found) == count and found.xi.shape == (count, 2, 3) and found.placements.shape == (count, 2)
    assert len(asked) == (starts == "lattice")
    np.testing.assert_allclose(found.cost, objective.cost(found.placements, found.xi), rtol=1e-3, atol=1e-3)
    again = recipe.start_points(lambda: lattice, objective, 2, np.random.default_rng(3))
    np.testing.assert_array_equal(found.xi, again.xi)
    if starts == "langevin":
        assert found.cost.tolist() == sorted(found.cost)
        random = replace(recipe, starts="random").start_points(lambda: lattice, objective, 2, np.random.default_rng(3))
        assert found.cost.max() < random.cost.min() + 1.0


def toy(shared, monkeypatch):
    """Return a problem whose poses are numbers, 0 and 1 by turns, and whose two grasps are shared as told."""
    drawn = []

    def pose(problem, rng):
        drawn.append(len(drawn) % 2)
        return drawn[-1]

    monkeypatch.setattr(tasks, "random_graspable_pose", pose)
    table = {0: np.array([True, False]), 1: np.array([shared, True])}
    return SimpleNamespace(feasible_grasps=lambda T: table[T], object=SimpleNamespace(name="toy")), drawn


@pytest.mark.parametrize("shared", [False, True])
def test_tasks_share_a_grasp_or_do_not_as_asked(shared, monkeypatch):
    problem, drawn = toy(shared, monkeypatch)
    for wanted in (None, not shared):
        assert random_task(problem, None, needs_regrasp=wanted) == (0, 1, int(shared))
    assert len(drawn) == 4
    with pytest.raises(GraspError, match=f"no two poses of 'toy' share {'no' if shared else 'a'} grasp"):
        random_task(problem, None, needs_regrasp=shared)
    assert len(drawn) == 4 + 2 * 500


def test_ends_that_are_given_are_kept(monkeypatch):
    problem, drawn = toy(True, monkeypatch)
    assert random_task(problem, None, start=1, goal=0) == (1, 0, 1) and drawn == []
    assert random_task(problem, None, start=1) == (1, 0, 1)
    assert random_task(problem, None, goal=0) == (1, 0, 1)
    with pytest.raises(GraspError, match="give --start and --goal"):
        random_task(problem, None, start=1, goal=0, needs_regrasp=True)
    assert drawn == [0, 1]


def test_random_poses_rest_in_the_workspace_with_a_feasible_grasp(bottle_problem):
    rng = np.random.default_rng(2)
    low, high = bottle_problem.workcell.bounds.array
    poses = [random_graspable_pose(bottle_problem, rng) for _ in range(5)]
    for T in poses:
        center = (T[:3, :3] @ bottle_problem.object.center_of_mass + T[:3, 3])[:2]
        assert (low <= center).all() and (center <= high).all() and bottle_problem.feasible_grasps(T).any()
    assert len({T.tobytes() for T in poses}) == 5
    np.testing.assert_array_equal(random_graspable_pose(bottle_problem, np.random.default_rng(2)), poses[0])


def test_an_object_that_can_be_grasped_nowhere_is_named(bottle_problem, monkeypatch):
    nothing = np.zeros(len(bottle_problem.grasps), dtype=bool)
    monkeypatch.setattr(type(bottle_problem), "feasible_grasps", lambda self, T: nothing)
    monkeypatch.setattr(tasks, "_ATTEMPTS", 3)
    with pytest.raises(GraspError, match="no pose of 'bottle' with a feasible grasp was found in 3 tries"):
        random_graspable_pose(bottle_problem, np.random.default_rng(0))


def test_the_cheapest_candidate_comes_first():
    many = Candidates(np.arange(4)[:, None], np.zeros((4, 1, 3)), np.array([3.0, 1.0, 2.0, 1.0]))
    assert many.best(3).placements[:, 0].tolist() == [1, 3, 2]
