import itertools

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_opt.connectivity import CostOptions, pair_score, sequence_cost, truncated_pair_score
from regrasp_opt.connectivity.costs import sequence_cost_of_scores
from regrasp_opt.errors import OptionError

ENERGIES = st.lists(st.floats(-20, 20), min_size=1, max_size=12).map(np.array)


def test_pair_score_is_equation_4():
    a, b = np.array([0.1, 2.0, -1.0]), np.array([0.5, 0.0, 3.0])
    for alpha in (0.5, 1.0, 3.0):
        assert pair_score(a, b, alpha) == pytest.approx(-alpha * np.log(np.exp(-(a + b) / alpha).sum()))


def test_sequence_cost_is_equation_5():
    energies = np.random.default_rng(0).normal(size=(4, 6))
    scores = [pair_score(a, b) for a, b in itertools.pairwise(energies)]
    expected = sum(scores) + 0.5 * sum((p - q) ** 2 for p, q in itertools.pairwise(scores))
    assert sequence_cost(energies, CostOptions()) == pytest.approx(expected)
    assert sequence_cost(energies, CostOptions(variant="J+")) == pytest.approx(sum(scores))


def test_truncated_score_is_equation_10_with_a_plateau_of_zero():
    a, b = np.array([0.0, 1.0, 4.0]), np.array([0.0, 0.5, 4.0])
    assert truncated_pair_score(a, b, 2.0) == pytest.approx(-np.log(1 + np.exp(-1.5)))
    assert truncated_pair_score(a, b, -1.0) == 0.0


@settings(max_examples=60, deadline=None)
@given(ENERGIES, st.floats(1e-3, 1e3))
def test_pair_score_is_symmetric_bounded_and_blind_to_order(energy, alpha):
    other = energy[::-1].copy()
    score = pair_score(energy, other, alpha)
    assert score == pair_score(other, energy, alpha)
    least = (energy + other).min()
    assert least - alpha * np.log(len(energy)) - 1e-9 * (1 + abs(least)) <= score <= least + 1e-9 * (1 + abs(least))
    order = np.random.default_rng(0).permutation(len(energy))
    assert pair_score(energy[order], other[order], alpha) == pytest.approx(score, abs=1e-9)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 6), st.integers(0, 2**31))
def test_a_sequence_costs_the_same_backwards(num_regrasps, seed):
    energies = np.random.default_rng(seed).normal(size=(num_regrasps + 2, 5))
    assert sequence_cost(energies, CostOptions()) == pytest.approx(sequence_cost(energies[::-1].copy(), CostOptions()))


@pytest.mark.parametrize("variant", ["J", "J+", "Jh"])
def test_numpy_and_torch_agree(variant):
    energies = np.random.default_rng(1).normal(size=(7, 4, 9))
    options = CostOptions(alpha=0.7, variant=variant, h=0.5)
    np.testing.assert_allclose(
        sequence_cost(torch.as_tensor(energies), options).numpy(),
        sequence_cost(energies, options),
        atol=1e-12,
    )


@pytest.mark.parametrize("kind", [np.asarray, torch.as_tensor], ids=["numpy", "torch"])
@pytest.mark.parametrize("h", [-50.0, 0.0, 0.5, 50.0])
def test_batches_are_scored_one_by_one(kind, h):
    """Some pairs of the batch have no grasp below `h`, some have a few, some have all."""
    a, b = np.random.default_rng(4).normal(size=(2, 3, 8, 5))
    plain, truncated = pair_score(kind(a), kind(b), 0.7), truncated_pair_score(kind(a), kind(b), h, 0.7)
    assert tuple(plain.shape) == tuple(truncated.shape) == (3, 8)
    for i in np.ndindex(3, 8):
        total = a[i] + b[i]
        assert float(plain[i]) == pytest.approx(-0.7 * np.log(np.exp(-total / 0.7).sum()))
        kept = total[total < h]
        expected = -0.7 * np.log(np.exp(-kept / 0.7).sum()) if len(kept) else 0.0
        assert float(truncated[i]) == pytest.approx(expected, abs=1e-12)


def test_pairs_of_a_batch_may_differ_by_more_than_exp_can_hold():
    a = np.array([[0.0, 1.0], [1e4, 2e4], [-1e4, 0.0]])
    for score in (pair_score(a, a), truncated_pair_score(a, a, 1e6)):
        np.testing.assert_allclose(score, [-np.log1p(np.exp(-2.0)), 2e4, -2e4])


def test_a_grasp_at_the_threshold_does_not_count():
    assert truncated_pair_score(np.array([1.0]), np.array([1.0]), 2.0) == 0.0
    assert truncated_pair_score(np.array([1.0]), np.array([1.0]), 2.0 + 1e-9) == 2.0


def test_scores_of_a_batch_are_summed_with_their_steps():
    scores = np.array([[1.0, 3.0, 0.5], [2.0, 2.0, 2.0]])
    expected = [4.5 + 0.25 * (4.0 + 6.25), 6.0]
    np.testing.assert_allclose(sequence_cost_of_scores(scores, CostOptions(lambda_reg=0.25)), expected)
    assert sequence_cost_of_scores(np.array([1.5]), CostOptions()) == 1.5


def test_options_have_the_papers_constants_and_their_limits_are_allowed():
    options = CostOptions()
    assert (options.alpha, options.lambda_reg, options.variant, options.h) == (1.0, 0.5, "J", np.inf)
    assert options.regularisation == CostOptions(variant="Jh").regularisation == 0.5
    assert CostOptions(variant="J+").regularisation == CostOptions(lambda_reg=0.0).regularisation == 0.0
    assert CostOptions(alpha=0.5).alpha == 0.5
    for wrong in ({"alpha": np.inf}, {"alpha": -1.0}, {"lambda_reg": np.inf}, {"lambda_reg": np.nan}):
        with pytest.raises(OptionError, match="give"):
            CostOptions(**wrong)


@pytest.mark.parametrize("wrong", [{"alpha": 0.0}, {"alpha": np.nan}, {"lambda_reg": -1.0}, {"variant": "J-"}])
def test_wrong_options_are_rejected(wrong):
    with pytest.raises(OptionError, match=str(next(iter(wrong.values())))):
        CostOptions(**wrong)
