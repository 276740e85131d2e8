"""Costs at the ends of their range: energies that overflow exp, any alpha, one grasp and thousands, long chains."""

import numpy as np
import pytest

from regrasp_opt.connectivity import CostOptions, pair_score
from regrasp_opt.connectivity.costs import sequence_cost

ALPHAS = (1e-3, 1e-1, 1.0, 1e3)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("scale", [0.0, 1.0, 1e3, 1e6])
@pytest.mark.parametrize("grasps", [1, 7, 5000])
def test_pair_scores_lie_between_their_bounds(alpha, scale, grasps):
    rng = np.random.default_rng(grasps)
    a, b = scale * rng.normal(size=(2, 3, grasps))
    score, least = pair_score(a, b, alpha), (a + b).min(axis=1)
    assert np.isfinite(score).all()
    slack = 1e-12 * max(1.0, scale)
    assert (score <= least + slack).all() and (score >= least - alpha * np.log(grasps) - slack).all()


def test_a_small_alpha_takes_the_best_grasp_and_a_large_one_the_mean():
    a, b = np.random.default_rng(0).normal(size=(2, 50))
    assert pair_score(a, b, 1e-4) == pytest.approx((a + b).min(), abs=1e-3)
    assert pair_score(a, b, 1e5) + 1e5 * np.log(50) == pytest.approx((a + b).mean(), abs=1e-3)


@pytest.mark.parametrize("variant", ["J", "J+", "Jh"])
@pytest.mark.parametrize("regrasps", range(9))
def test_chains_of_every_length_cost_the_same_backwards_and_with_grasps_in_any_order(variant, regrasps):
    rng = np.random.default_rng(regrasps)
    energies = 100 * rng.normal(size=(regrasps + 2, 5000))
    options = CostOptions(variant=variant, h=20.0)
    cost = float(sequence_cost(energies, options))
    assert np.isfinite(cost)
    assert float(sequence_cost(energies[::-1], options)) == pytest.approx(cost, rel=1e-9)
    assert float(sequence_cost(energies[:, rng.permutation(5000)], options)) == pytest.approx(cost, rel=1e-9)
