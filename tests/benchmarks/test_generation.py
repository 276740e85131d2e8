import numpy as np
import pytest

from regrasp_opt.benchmarks.harness.generation import GENERATORS, OneStepTask, distinct, generate
from regrasp_opt.benchmarks.harness.instances import PosePool
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.conventions import planar_transform


@pytest.fixture(scope="module")
def task(bottle_problem):
    """Return a pair of bottle poses that share no grasp."""
    pool = PosePool.draw(bottle_problem, 0, 40)
    i, j = np.argwhere((pool.feasible.astype(int) @ pool.feasible.T.astype(int)) == 0)[0]
    return OneStepTask(bottle_problem, bottle_problem.energy, pool.T[[i, j]])


@pytest.mark.parametrize("name", GENERATORS)
def test_every_generator_ranks_equally_many_poses_of_each_placement(bottle_problem, task, name):
    found = generate(task, GENERATORS[name], CostOptions(), 5, np.random.default_rng(0))
    assert np.bincount(found.placements[:, 0]).tolist() == [5] * len(bottle_problem.placements)
    assert (np.diff(found.cost) >= 0).all()
    low, high = bottle_problem.workcell.bounds.array
    assert (found.xi[:, 0, :2] >= low).all() and (found.xi[:, 0, :2] <= high).all()


def test_most_of_our_poses_are_valid(bottle_problem, task):
    found = generate(task, GENERATORS["lattice"], CostOptions(), 40, np.random.default_rng(0))
    top = found.take(slice(0, 20))
    assert task.verdicts(top.placements[:, 0], top.xi[:, 0]).mean() >= 0.9
    assert distinct(top.placements[:, 0], top.xi[:, 0]) == 20


def test_verdicts_are_those_of_the_full_check(bottle_problem, task):
    rng = np.random.default_rng(1)
    numbers = rng.integers(len(bottle_problem.placements), size=12)
    xi = np.column_stack([rng.uniform(*bottle_problem.workcell.bounds.array, (12, 2)), rng.uniform(0, 6, 12)])
    poses = planar_transform(xi) @ bottle_problem.placement_poses[numbers]
    full = np.array([bottle_problem.feasible_grasps(T) for T in poses])
    expected = [(row & task.feasible[0]).any() and (row & task.feasible[1]).any() for row in full]
    assert task.verdicts(numbers, xi).tolist() == expected


def test_poses_in_one_cell_count_once():
    xi = np.array([[0.1, 0.2, 0.3], [0.1001, 0.2, 0.3], [0.1, 0.2, 0.6]])
    assert distinct(np.array([0, 0, 0]), xi) == 2
    assert distinct(np.array([0, 1, 0]), xi) == 3
