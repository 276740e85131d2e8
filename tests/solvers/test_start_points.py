"""Batches of candidates: random starts, and what a refiner may give back."""

import numpy as np
import pytest

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.solvers import random_starts
from regrasp_opt.solvers.base import keep_better, wrap_yaw

BOUNDS = np.array([[-0.45, 0.1], [0.45, 0.6]])


@pytest.fixture
def objective(make_energy):
    placements = np.array([np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0]), np.diag([-1.0, 1.0, -1.0, 1.0])])
    return SequenceObjective(make_energy(5), PlanarPoses.level(placements, BOUNDS), *np.zeros((2, 5)), CostOptions())


def test_random_starts_are_uniform_over_placements_and_the_workspace(objective):
    starts = random_starts(objective, 2, 3000, np.random.default_rng(0))
    assert starts.xi.shape == (3000, 2, 3) and starts.placements.shape == (3000, 2)
    np.testing.assert_allclose(np.bincount(starts.placements.ravel(), minlength=3) / 6000, 1 / 3, atol=0.03)
    low, high = np.append(BOUNDS[0], 0.0), np.append(BOUNDS[1], 2 * np.pi)
    shares = (starts.xi.reshape(-1, 3) - low) / (high - low)
    assert (shares >= 0).all() and (shares <= 1).all()
    for column in shares.T:
        np.testing.assert_allclose(np.histogram(column, 5, (0, 1))[0] / 6000, 0.2, atol=0.03)
    assert abs(np.corrcoef(starts.xi[:, 0, 0], starts.xi[:, 1, 0])[0, 1]) < 0.06
    np.testing.assert_allclose(starts.cost, objective.cost(starts.placements, starts.xi), atol=1e-3)
    assert starts.cost.dtype == np.float64 and len(random_starts(objective, 1, 0, np.random.default_rng(0))) == 0


def test_the_start_comes_back_where_it_is_cheaper(objective):
    rng = np.random.default_rng(1)
    starts, others = (random_starts(objective, 1, 40, rng) for _ in range(2))
    kept = keep_better(objective, starts, others.xi)
    costs = [starts.cost, objective.cost(starts.placements, others.xi)]
    np.testing.assert_array_equal(kept.cost, np.minimum(*costs))
    worse = costs[1] > costs[0]
    assert 0 < worse.sum() < 40
    np.testing.assert_array_equal(kept.xi, np.where(worse[:, None, None], starts.xi, others.xi))
    np.testing.assert_array_equal(kept.placements, starts.placements)


def test_yaws_are_wrapped_to_one_turn_and_nothing_else_moves():
    xi = np.array([[7.0, -7.0, -0.5], [1.0, 2.0, 7.0], [0.0, 0.0, 0.0]])
    wrapped = wrap_yaw(xi)
    np.testing.assert_array_equal(wrapped[:, :2], xi[:, :2])
    np.testing.assert_allclose(wrapped[:, 2], [2 * np.pi - 0.5, 7.0 - 2 * np.pi, 0.0])
    assert xi[0, 2] == -0.5  # what came in is left alone
