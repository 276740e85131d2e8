"""What the planner refuses, whom it does not believe, and what it still answers when there is nothing to find."""

from dataclasses import replace

import numpy as np
import pytest
from transforms import IN_THE_BASE

from regrasp_opt import Recipe, Status, solve_sequence
from regrasp_opt.errors import GraspError, ModelError, OptionError, PoseError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.planning.model_store import load_prepared_energy
from regrasp_opt.planning.prepare import prepare
from regrasp_opt.solvers import LatticeRefiner


class Moving:
    """A refiner that claims the starts, moved, as its candidates."""

    name = "moving"

    def __init__(self, move):
        self.move = move

    def refine(self, objective, starts, rng):
        found = LatticeRefiner().refine(objective, starts, rng)
        return replace(found, candidates=replace(found.candidates, xi=self.move(found.candidates.xi)))


@pytest.mark.parametrize(
    "move",
    [lambda xi: xi + 5.0, lambda xi: xi * np.nan, lambda xi: 0 * xi + IN_THE_BASE],
    ids=["outside the workspace", "not a number", "in the robot's base"],
)
def test_a_refiner_is_not_believed(bottle_problem, task, move):
    recipe = Recipe(Moving(move), batches=(4,), verified=4, fallback=0)
    plan = solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=1)
    assert plan.status is Status.NOT_FOUND and plan.transitions == ()


def test_a_direct_plan_that_is_not_accepted_is_followed_by_one_with_a_regrasp(bottle_problem, task):
    seen = []

    def with_a_regrasp(plan):
        seen.append(plan.num_regrasps)
        return plan.num_regrasps > 0

    plan = solve_sequence(bottle_problem, task.start, task.start, "lattice", accept=with_a_regrasp)
    assert plan.solved and seen[0] == 0 and seen[-1] == plan.num_regrasps == 1
    assert plan.residuals().hold


def test_fewer_chains_than_are_asked_for_end_the_batches(bottle_problem, task):
    sizes = []

    class Counting(LatticeRefiner):
        def refine(self, objective, starts, rng):
            sizes.append(len(starts))
            return super().refine(objective, starts, rng)

    class Three(Recipe):
        def start_points(self, lattice, objective, num_regrasps, rng):
            return super().start_points(lattice, objective, num_regrasps, rng).take(slice(0, 3))

    recipe = Three(Counting(), batches=(2, 2, 2), verified=1, fallback=0)
    solve_sequence(bottle_problem, task.start, task.goal, recipe, max_regrasps=1, accept=lambda plan: False)
    assert sizes == [2, 1]


def test_a_placement_that_is_not_there_is_refused(bottle_problem):
    last = len(bottle_problem.placements) - 1
    for number in (-1, last + 1):
        with pytest.raises(PoseError, match=f"no placement {number}; 'bottle' has placements 0 to {last}"):
            bottle_problem.pose(number, 0.0, 0.3)


def test_no_workers_prepare_nothing(bottle_problem, tmp_path):
    with pytest.raises(OptionError, match="jobs is 0; give a number of worker processes"):
        prepare(bottle_problem.object, bottle_problem.workcell, out=tmp_path / "model", jobs=0)
    assert list(tmp_path.iterdir()) == []


def test_a_guess_needs_a_row_for_each_pose(bottle_problem, task):
    with pytest.raises(OptionError, match=r"the guess has shape \(1, 3\); give 2 rows"):
        bottle_problem.nlp(task.start, task.goal, placements=[0, 1], guess=np.zeros((1, 3)))


def test_a_checker_needs_a_grasp(bottle_problem):
    with pytest.raises(GraspError, match="the grasp set is empty"):
        FeasibilityChecker(bottle_problem.object, bottle_problem.workcell, bottle_problem.grasps.subset([]))


def test_an_energy_of_other_grasps_is_refused(bottle_problem, monkeypatch):
    folder = bottle_problem.model_folder
    key = bottle_problem.energy.model.metadata["key"]
    assert load_prepared_energy(folder, "default", key).hidden == bottle_problem.energy.model.hidden
    monkeypatch.setattr("regrasp_opt.planning.model_store.read_report", lambda _: {"grasps_fingerprint": "others"})
    with pytest.raises(ModelError, match="was trained with another grasp set"):
        load_prepared_energy(folder, "default", key)
