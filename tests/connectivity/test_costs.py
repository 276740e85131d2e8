import itertools

import casadi as ca
import numpy as np
import pytest
import torch
from conftest import random_transforms
from derivatives import assert_derivative
from hypothesis import given, settings
from hypothesis import strategies as st

from regrasp_opt.connectivity import CostOptions, pair_score, sequence_cost, truncated_pair_score
from regrasp_opt.connectivity.casadi_costs import (
    connectivity_functions,
    layers_parameter,
    plain_sequence_cost,
    sequence_functions,
)
from regrasp_opt.conventions import planar_transform
from regrasp_opt.energy.casadi_energy import CasadiEnergy
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


def _setting(energy, num_regrasps, seed=5):
    rng = np.random.default_rng(seed)
    placements = random_transforms(rng, num_regrasps)
    ends = rng.uniform(0, 4, size=(len(energy), 2))
    return placements, rng.normal(size=(3, num_regrasps)), ends


def _numpy_cost(energy, options, placements, xi, ends):
    middle = energy(planar_transform(xi.T) @ placements)
    return sequence_cost(np.concatenate([ends[None, :, 0], middle, ends[None, :, 1]]), options)


@pytest.mark.parametrize("num_regrasps", [1, 2, 4])
@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("options", [CostOptions(), CostOptions(alpha=0.4, lambda_reg=2.0), CostOptions(variant="J+")])
def test_fast_derivatives_equal_casadi_differentiation(make_energy, num_regrasps, bounded, options):
    energy = make_energy(bounded=bounded)
    expressions = CasadiEnergy(energy.model, len(energy))
    placements, xi, ends = _setting(energy, num_regrasps)
    parameters = layers_parameter(energy, placements)
    fast = sequence_functions(expressions, options, num_regrasps)
    plain = plain_sequence_cost(expressions, options, num_regrasps)
    x = ca.MX.sym("xi", 3, num_regrasps)
    reference = ca.Function("reference", [x], ca.hessian(plain(x, parameters, ends), ca.vec(x)))
    hessian, gradient = (np.array(part) for part in reference(xi))
    cost, fast_gradient = fast.gradient(xi, parameters, ends)
    expected = _numpy_cost(energy, options, placements, xi, ends)
    assert float(cost) == pytest.approx(expected, abs=1e-12)
    assert float(fast.cost(xi, parameters, ends)) == pytest.approx(expected, abs=1e-12)
    np.testing.assert_allclose(np.array(fast_gradient), gradient, atol=1e-10)
    np.testing.assert_allclose(np.array(fast.hessian(xi, parameters, ends, 1, 0)), hessian, atol=1e-10)


@pytest.mark.parametrize("activation", ["silu", "tanh"])
def test_gradient_and_hessian_match_finite_differences(make_energy, activation):
    energy = make_energy(activation=activation)
    placements, xi, ends = _setting(energy, 2)
    functions = sequence_functions(CasadiEnergy(energy.model, len(energy)), CostOptions(), 2)
    parameters = layers_parameter(energy, placements)

    def cost(v):
        return float(functions.cost(v.reshape(2, 3).T, parameters, ends))

    def gradient(v):
        return np.array(functions.gradient(v.reshape(2, 3).T, parameters, ends)[1])[:, 0]

    v = xi.T.ravel()
    assert_derivative(cost, gradient(v), v)
    assert_derivative(gradient, np.array(functions.hessian(xi, parameters, ends, 1, 0)), v)


def test_contract_functions_compose_differentiate_save_and_map(make_energy, tmp_path):
    energy = make_energy()
    placements, xi, ends = _setting(energy, 2)
    E, Q_pair, J_seq = connectivity_functions(energy, CostOptions(), *ends.T, placements)
    np.testing.assert_allclose(np.array(E(xi)).T, energy(planar_transform(xi.T) @ placements), atol=1e-12)
    assert float(J_seq(xi)) == pytest.approx(_numpy_cost(energy, CostOptions(), placements, xi, ends))
    assert Q_pair(xi).shape == (3, 1)
    J_seq.save(str(tmp_path / "J.casadi"))
    assert float(ca.Function.load(str(tmp_path / "J.casadi"))(xi)) == float(J_seq(xi))
    batch = np.concatenate([xi, xi + 0.1], axis=1)
    assert float(J_seq.map(2)(batch)[1]) == pytest.approx(float(J_seq(xi + 0.1)))
    x = ca.MX.sym("x", 3, 2)
    gradient = ca.Function("g", [x], [ca.gradient(J_seq(x), x)])
    assert_derivative(lambda v: float(J_seq(v.reshape(2, 3).T)), np.array(gradient(xi)).T.ravel(), xi.T.ravel())


def test_extreme_energies_and_alpha_stay_finite(make_energy):
    energy = make_energy()
    placements, xi, ends = _setting(energy, 2)
    for alpha in (1e-3, 1e3):
        functions = sequence_functions(CasadiEnergy(energy.model, len(energy)), CostOptions(alpha=alpha), 2)
        arguments = xi, layers_parameter(energy, placements), ends * 1e3
        assert np.isfinite(float(functions.cost(*arguments)))
        assert np.isfinite(np.array(functions.hessian(*arguments, 1, 0))).all()


@pytest.mark.parametrize("wrong", [{"alpha": 0.0}, {"alpha": np.nan}, {"lambda_reg": -1.0}, {"variant": "J-"}])
def test_wrong_options_are_rejected(wrong):
    with pytest.raises(OptionError, match=str(next(iter(wrong.values())))):
        CostOptions(**wrong)


def test_the_truncated_cost_has_no_solver_functions(make_energy):
    with pytest.raises(OptionError, match="not differentiable"):
        sequence_functions(CasadiEnergy(make_energy().model, 12), CostOptions(variant="Jh", h=1.0), 1)


def test_score_jacobian_and_weighted_hessian_match_finite_differences(make_energy):
    energy = make_energy()
    placements, xi, ends = _setting(energy, 3)
    functions = sequence_functions(CasadiEnergy(energy.model, len(energy)), CostOptions(), 3)
    parameters = layers_parameter(energy, placements)
    multipliers = np.array([0.3, 0.0, 2.0, 1.0])

    def scores(v):
        return np.array(functions.scores(v.reshape(3, 3).T, parameters, ends)[0])[:, 0]

    def weighted_gradient(v):
        x = v.reshape(3, 3).T
        gradient = np.array(functions.gradient(x, parameters, ends)[1])[:, 0]
        return 0.7 * gradient + np.array(functions.scores(x, parameters, ends)[1]).T @ multipliers

    v = xi.T.ravel()
    assert_derivative(scores, np.array(functions.scores(xi, parameters, ends)[1]), v)
    assert_derivative(weighted_gradient, np.array(functions.hessian(xi, parameters, ends, 0.7, multipliers)), v)


@pytest.mark.parametrize("h", [-5.0, 1.5, 100.0])
def test_truncated_casadi_cost_equals_numpy(make_energy, h):
    energy = make_energy()
    placements, xi, ends = _setting(energy, 2)
    options = CostOptions(variant="Jh", h=h)
    _, _, J = connectivity_functions(energy, options, *ends.T, placements)
    assert float(J(xi)) == pytest.approx(_numpy_cost(energy, options, placements, xi, ends), abs=1e-9)


def test_blocks_of_grasps_give_the_same_derivatives(make_energy, monkeypatch):
    energy = make_energy(grasps=23)
    placements, xi, ends = _setting(energy, 2)
    arguments = xi, layers_parameter(energy, placements), ends
    whole = sequence_functions(CasadiEnergy(energy.model, 23), CostOptions(), 2)
    monkeypatch.setattr("regrasp_opt.energy.casadi_blocks.BLOCK", 5)
    blocked = sequence_functions(CasadiEnergy(energy.model, 23), CostOptions(), 2)
    for name in ("gradient", "scores"):
        for a, b in zip(getattr(whole, name)(*arguments), getattr(blocked, name)(*arguments), strict=True):
            np.testing.assert_allclose(np.array(a), np.array(b), atol=1e-12)
    hessians = [np.array(f.hessian(*arguments, 0.5, [1.0, 0.0, 2.0])) for f in (whole, blocked)]
    np.testing.assert_allclose(*hessians, atol=1e-12)
