"""Langevin dynamics against what is known about it: diffusion, and the stationary distribution of a quadratic."""

import numpy as np
import pytest

from regrasp_opt.connectivity import CostOptions, SequenceObjective
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.grasps import GraspSet
from regrasp_opt.solvers import Candidates, LangevinRefiner

BOUNDS = np.array([[-0.45, 0.1], [0.45, 0.6]])
MIDDLE, HALF = BOUNDS.mean(axis=0), np.ptp(BOUNDS, axis=0) / 2
STIFFNESS = 1.5
CHAINS = 2000


@pytest.fixture
def quadratic():
    """Return an objective that is ``STIFFNESS / 2 |u|^2`` in the scaled position u, and flat in the yaw.

    ``silu(a u) + silu(-a u)`` is ``a^2 u^2 / 2`` near zero; one regrasp between equal ends counts the energy twice.
    """
    a = 0.5
    W, b = np.zeros((4, 24)), np.zeros(4)
    for row, (k, sign) in enumerate([(0, 1), (0, -1), (1, 1), (1, -1)]):
        W[row, 4 * k + 3], b[row] = sign * a / HALF[k], -sign * a * MIDDLE[k] / HALF[k]
    weights = W, np.full((1, 4), STIFFNESS / (2 * a * a))
    layers = [tuple(part.astype(np.float32) for part in parts) for parts in (weights, (b, np.zeros(1)))]
    model = EnergyModel(layers[0], layers[1], "silu", "paper", False, False, 1.0)
    grasps = GraspSet(np.eye(4)[None], np.zeros(1), "parallel")
    ends = np.zeros((2, 1))
    return SequenceObjective(
        GraspEnergy(model, grasps), PlanarPoses.level(np.eye(4)[None], BOUNDS), *ends, CostOptions()
    )


def run(objective, at=(0.0, 0.0), **options):
    """Return the refinement of many chains that start at scaled position `at`, and their scaled path (k, B, 3)."""
    xi = np.tile([*(MIDDLE + HALF * at), 0.0], (CHAINS, 1, 1))
    starts = Candidates(np.zeros((CHAINS, 1), dtype=int), xi, objective.cost(np.zeros((CHAINS, 1), dtype=int), xi))
    refined = LangevinRefiner(device="cpu", record=True, **options).refine(objective, starts, np.random.default_rng(0))
    path = np.stack(refined.paths, axis=1)[:, :, 0]
    return refined, (path - [*MIDDLE, 0.0]) / [*HALF, np.pi]


@pytest.mark.parametrize(("eta", "tau"), [(0.3, 0.01), (0.3, 0.04), (0.1, 0.02)])
def test_the_stationary_variance_on_a_quadratic_is_that_of_the_temperature(quadratic, eta, tau):
    """``u <- (1 - eta k) u + sqrt(2 eta tau) z`` has the variance ``tau / k / (1 - eta k / 2)`` (Eq. 7)."""
    _, path = run(quadratic, eta=eta, tau=tau, iterations=40)
    late = path[25:, :, :2]
    expected = tau / STIFFNESS / (1 - eta * STIFFNESS / 2)
    np.testing.assert_allclose(late.var(axis=(0, 1)), expected, rtol=0.08)
    np.testing.assert_allclose(late.mean(axis=(0, 1)), 0.0, atol=0.02)


def test_where_the_cost_is_flat_chains_diffuse(quadratic):
    """The mean square of a free coordinate grows by ``2 eta tau`` a step, its noise new in each chain and step."""
    eta, tau = 0.2, 0.005
    _, path = run(quadratic, eta=eta, tau=tau, iterations=12)
    np.testing.assert_allclose((path[:, :, 2] ** 2).mean(axis=1), 2 * eta * tau * np.arange(13), rtol=0.12)
    steps = np.diff(path, axis=0)
    correlated = [np.corrcoef(steps[0, :, i], steps[j, :, k])[0, 1] for i, j, k in [(0, 0, 1), (1, 0, 2), (2, 1, 2)]]
    assert np.abs(correlated).max() < 0.1


def test_annealed_noise_falls_linearly_to_zero(quadratic):
    eta, tau, iterations = 0.2, 0.005, 10
    _, path = run(quadratic, eta=eta, tau=tau, iterations=iterations, anneal=True)
    spread = np.diff(path[:, :, 2], axis=0).var(axis=1)
    np.testing.assert_allclose(spread, 2 * eta * tau * (1 - np.arange(iterations) / iterations), rtol=0.15)


def test_without_noise_each_step_shrinks_the_distance_to_the_minimum_alike(quadratic):
    _, path = run(quadratic, at=(0.3, -0.2), eta=0.4, tau=0.0, iterations=5)
    expected = np.outer((1 - 0.4 * STIFFNESS) ** np.arange(6), [0.3, -0.2])
    np.testing.assert_allclose(path[:, 0, :2], expected, atol=3e-3)
    np.testing.assert_allclose(path[:, :, 2], 0.0, atol=1e-6)


@pytest.mark.parametrize("keep_best", [True, False])
def test_the_best_or_the_last_point_of_a_chain_comes_back(quadratic, keep_best):
    refined, path = run(quadratic, at=(0.5, 0.5), tau=0.2, iterations=15, keep_best=keep_best)
    traces = np.array(refined.traces)
    assert traces.shape == (CHAINS, 16) and path.shape == (16, CHAINS, 3)
    chosen = traces.argmin(axis=1) if keep_best else np.full(CHAINS, 15)
    np.testing.assert_allclose(refined.candidates.cost, traces[np.arange(CHAINS), chosen], atol=1e-5)
    expected = path[chosen, np.arange(CHAINS)] * [*HALF, np.pi] + [*MIDDLE, 0.0]
    np.testing.assert_allclose(refined.candidates.xi[:, 0, :2], expected[:, :2], atol=1e-6)
    turns = (refined.candidates.xi[:, 0, 2] - expected[:, 2]) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-6)
    assert (refined.candidates.xi[:, 0, 2] >= 0).all() and (refined.candidates.xi[:, 0, 2] < 2 * np.pi).all()
    assert (np.abs(path[..., :2]) <= 1 + 1e-6).all() and (np.abs(path[..., :2]) > 1 - 1e-6).any()
    assert refined.stats["evaluations"] == traces.size and refined.stats["iterations"] == 15
    np.testing.assert_allclose(refined.stats["mean_cost"], traces.mean(axis=0), rtol=1e-4)


def test_chunks_of_chains_have_noise_of_their_own(quadratic, monkeypatch):
    monkeypatch.setattr("regrasp_opt.solvers.langevin._CHUNK_ELEMENTS", 4 * 700)
    parts, path = run(quadratic, iterations=2)
    assert len(parts.candidates) == CHAINS == len(parts.status) and path.shape == (3, CHAINS, 3)
    assert len(np.unique(path[1, :, 2])) > 0.99 * CHAINS  # no chunk repeats the noise of another


@pytest.mark.parametrize("wrong", [{"iterations": -1}, {"eta": 0.0}, {"eta": np.nan}, {"tau": -0.1}])
def test_constants_that_make_no_sense_are_refused(wrong):
    with pytest.raises(OptionError, match="iterations >= 0, eta > 0 and tau >= 0"):
        LangevinRefiner(**wrong)


def test_the_constants_are_the_papers_and_no_iteration_changes_nothing(quadratic):
    refiner = LangevinRefiner()
    assert (refiner.iterations, refiner.eta, refiner.tau, refiner.anneal) == (20, 0.3, 0.1, False)
    still, path = run(quadratic, at=(0.2, 0.1), iterations=0)
    assert path.shape == (1, CHAINS, 3) and still.candidates.cost[0] == pytest.approx(still.traces[0][0], abs=1e-6)
    np.testing.assert_allclose(path[0], np.tile([0.2, 0.1, 0.0], (CHAINS, 1)), atol=1e-6)
