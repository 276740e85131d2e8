"""The threshold `h` of Eq. 3, and the figures that say how good an energy is on held-out labels."""

import numpy as np
import pytest

from regrasp_opt.energy.calibration import (
    HeldOut,
    area_under_roc,
    average_precision,
    best_threshold,
    calibrate,
    reliability_curve,
)


def calibrated(energies, feasible, model, seed=0):
    """Return `model` calibrated on poses 0, 1, ... whose energies and feasibility (B, G) are given."""
    return calibrate(model, [HeldOut(energies, feasible)], seed)


def ranked(count=400, seed=0):
    """Return energies (M,) and labels that follow them loosely."""
    rng = np.random.default_rng(seed)
    energy = np.round(rng.exponential(2.0, count), 2)  # rounded, so that there are ties
    return energy, rng.random(count) < np.exp(-energy)


def test_the_threshold_tells_grasps_that_both_poses_share_from_those_that_one_has(make_energy):
    """Feasible grasps cost 0.2 or 0.4, others 5 or 6: a sum is at most 0.8 where both are feasible, else at least 5.2.

    Counting grasps that are feasible at either pose would put it between 6.4 and 10.
    """
    rng = np.random.default_rng(1)
    feasible = rng.random((12, 9)) < 0.5
    energies = np.where(feasible, rng.choice([0.2, 0.4], (12, 9)), rng.choice([5.0, 6.0], (12, 9)))
    model = calibrated(energies, feasible, make_energy().model)
    assert 0.8 < model.threshold < 5.2
    for a, b in np.ndindex(12, 12):
        shared = energies[a] + energies[b] <= model.threshold
        np.testing.assert_array_equal(shared, feasible[a] & feasible[b])
    figures = model.metadata["held_out"]
    assert figures["f1"] == figures["shared_f1"] == figures["auroc"] == figures["average_precision"] == 1.0
    assert 0.4 < figures["threshold"] < 5.0 and figures["poses"] == 12
    assert figures["feasible_share"] == pytest.approx(feasible.mean())


def test_the_threshold_has_the_best_f1_over_pairs_of_poses(make_energy):
    rng = np.random.default_rng(2)
    energies = rng.exponential(1.5, (30, 20))
    feasible = rng.random((30, 20)) < np.exp(-energies)
    model = calibrated(energies, feasible, make_energy().model)
    pairs = [np.repeat(np.arange(30), 30), np.tile(np.arange(30), 30)]
    total, shared = (energies[pairs[0]] + energies[pairs[1]]).ravel(), (feasible[pairs[0]] & feasible[pairs[1]]).ravel()

    def f1(h):
        said = total <= h
        return 2 * (said & shared).sum() / (said.sum() + shared.sum())

    best, figures = max(f1(h) for h in np.linspace(0, 6, 200)), model.metadata["held_out"]
    assert f1(model.threshold) > best - 0.01 and figures["shared_f1"] == pytest.approx(best, abs=0.02)
    said = energies <= energies.reshape(-1, 1, 1)
    single = 2 * (said & feasible).sum(axis=(1, 2)) / (said.sum(axis=(1, 2)) + feasible.sum())
    assert figures["f1"] == pytest.approx(single.max())


def test_a_seed_draws_the_same_pairs_and_what_the_model_was_is_kept(make_energy):
    rng = np.random.default_rng(3)
    energies, feasible = rng.exponential(1.0, (40, 5)), rng.random((40, 5)) < 0.5
    before = make_energy().model
    before.metadata["training"] = {"seed": 4}
    first, again, other = (calibrated(energies, feasible, before, seed) for seed in (0, 0, 1))
    assert first.threshold == again.threshold and first.metadata == again.metadata
    assert first.metadata["held_out"]["shared_f1"] != other.metadata["held_out"]["shared_f1"]
    assert first.metadata["training"] == {"seed": 4} and "held_out" not in before.metadata
    assert first.fingerprint() == before.fingerprint()


@pytest.mark.parametrize("bounded", [True, False])
def test_the_probability_of_an_energy_is_that_of_its_kind(make_energy, bounded):
    """``exp(-E)`` for a bounded energy, ``1 / (1 + exp(E))`` else: labels drawn with it lie on the diagonal."""
    rng = np.random.default_rng(4)
    energies = rng.exponential(1.0, (200, 60)) if bounded else rng.normal(0.0, 2.0, (200, 60))
    probability = np.exp(-energies) if bounded else 1 / (1 + np.exp(energies))
    feasible = rng.random((200, 60)) < probability
    bins = calibrated(energies, feasible, make_energy(bounded=bounded).model).metadata["held_out"]["reliability"]
    assert len(bins) == 10 and sum(part["count"] for part in bins) == energies.size
    for number, part in enumerate(bins):
        assert number / 10 <= part["predicted"] <= (number + 1) / 10
        assert part["observed"] == pytest.approx(part["predicted"], abs=4 * 0.5 / np.sqrt(part["count"]))


def test_bins_that_are_empty_are_left_out_and_certainty_has_one():
    curve = reliability_curve(np.array([0.0, 0.05, 1.0, 0.3]), np.array([False, True, True, False]))
    assert [part["count"] for part in curve] == [2, 1, 1]
    assert [part["observed"] for part in curve] == [0.5, 0.0, 1.0]
    assert [part["predicted"] for part in curve] == pytest.approx([0.025, 0.3, 1.0])
    assert len(reliability_curve(np.linspace(0, 1, 50), np.ones(50, dtype=bool), bins=4)) == 4


def test_the_area_is_the_share_of_pairs_in_order():
    energy, positive = ranked()
    below = energy[positive][:, None] - energy[~positive][None, :]
    assert area_under_roc(energy, positive) == pytest.approx(((below < 0) + 0.5 * (below == 0)).mean())


def test_average_precision_is_that_of_each_hit():
    energy, positive = ranked()
    order = np.argsort(energy, kind="stable")
    precisions = [positive[order][: k + 1].mean() for k in range(len(order)) if positive[order][k]]
    assert average_precision(energy, positive) == pytest.approx(np.mean(precisions))


def test_no_threshold_has_a_higher_f1():
    energy, positive = ranked()
    energy = energy + np.arange(len(energy)) * 1e-6  # no ties: every threshold can be chosen

    def f1(h):
        said = energy <= h
        return 2 * (said & positive).sum() / (said.sum() + positive.sum())

    found = best_threshold(energy, positive)
    assert found.f1 == pytest.approx(max(f1(h) for h in energy)) == f1(found.threshold)
    assert np.abs(energy - found.threshold).min() > 0  # between two of them, not on one
