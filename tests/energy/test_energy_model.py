from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from derivatives import assert_derivative
from transforms import random_transforms

from regrasp_opt.conventions import planar_transform
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.energy.export import grasp_function
from regrasp_opt.energy.features import pair_features
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.energy.network import ACTIVATIONS, activate
from regrasp_opt.geometry.planar_poses import PlanarPoses


@pytest.mark.parametrize("activation", ACTIVATIONS)
@pytest.mark.parametrize("features", ["paper", "tcp"])
@pytest.mark.parametrize("bounded", [True, False])
@pytest.mark.parametrize("use_width", [True, False])
def test_energy_is_the_mlp_of_its_features(make_energy, activation, features, bounded, use_width):
    energy = make_energy(activation=activation, features=features, bounded=bounded, use_width=use_width)
    T = random_transforms(np.random.default_rng(1), 5)
    for pose, row in zip(T, energy(T), strict=True):
        x = pair_features(np.broadcast_to(pose, (len(energy), 4, 4)), energy.grasps, features, use_width)
        for W, b in zip(energy.model.weights[:-1], energy.model.biases[:-1], strict=True):
            x = activate(activation, x @ W.T.astype(float) + b)
        f = (x @ energy.model.weights[-1].T.astype(float) + energy.model.biases[-1])[:, 0]
        np.testing.assert_allclose(row, np.log1p(np.exp(f)) if bounded else f, atol=1e-12)


def test_batches_keep_their_shape_and_single_precision_is_close(make_energy):
    energy = make_energy()
    T = random_transforms(np.random.default_rng(2), 6).reshape(2, 3, 4, 4)
    double, single = energy(T), energy(T, np.float32)
    assert double.shape == (2, 3, len(energy)) and single.dtype == np.float32
    np.testing.assert_allclose(single, double, atol=1e-4)
    assert energy(np.zeros((0, 4, 4))).shape == (0, len(energy))


def test_a_large_batch_equals_its_parts(make_energy, monkeypatch):
    energy = make_energy()
    T = random_transforms(np.random.default_rng(3), 20)
    whole = energy(T)
    monkeypatch.setattr("regrasp_opt.energy.model._CHUNK_ELEMENTS", 3 * len(energy) * energy.model.hidden)
    np.testing.assert_allclose(energy(T), whole, atol=1e-13)


@pytest.mark.parametrize("features", ["paper", "tcp"])
def test_casadi_energy_equals_numpy_for_planar_and_full_poses(make_energy, features):
    energy = make_energy(features=features)
    rng = np.random.default_rng(4)
    T_p, xi = random_transforms(rng, 1)[0], np.array([0.3, -0.2, 2.0])
    expressions = CasadiEnergy(energy.model, len(energy))
    x, T = ca.MX.sym("xi", 3), ca.MX.sym("T", 4, 4)
    layer = expressions.layer(energy.planar_layers(PlanarPoses.level(T_p[None], np.zeros((2, 2))))[0])
    planar = ca.Function("planar", [x], [expressions.planar_expression(layer, x)])
    full = ca.Function("full", [T], [expressions.pose_expression(energy, T)])
    pose = planar_transform(xi) @ T_p
    np.testing.assert_allclose(np.array(planar(xi))[:, 0], energy(pose), atol=1e-12)
    np.testing.assert_allclose(np.array(full(pose))[:, 0], energy(pose), atol=1e-12)


def test_fingerprint_changes_with_what_the_value_depends_on_only(make_energy):
    energy, same, other = make_energy(), make_energy(), make_energy(seed=9)
    same.model.metadata["note"] = "metadata is not part of the value"
    assert energy.fingerprint() == same.fingerprint() != other.fingerprint()
    assert GraspEnergy(energy.model, energy.grasps.subset([1, 0])).fingerprint() != energy.fingerprint()
    kinds = ({"activation": "tanh"}, {"features": "paper"}, {"use_width": False}, {"bounded": False})
    hashes = {replace(energy.model, **kind).fingerprint() for kind in ({}, {"threshold": 2.0}, *kinds)}
    assert len(hashes) == 1 + len(kinds)  # the threshold is not part of the value


@pytest.mark.parametrize("features", ["tcp", "paper"])
@pytest.mark.parametrize("bounded", [True, False])
def test_the_energy_of_a_free_grasp_is_that_of_the_set(make_energy, features, bounded):
    energy = make_energy(features=features, bounded=bounded)
    function = grasp_function(energy.model)
    T = energy.grasps.T_object_tcp[3]
    expected = energy(T)
    for k in range(0, len(energy), 5):
        found = float(function(T, energy.grasps.T_object_tcp[k], energy.grasps.width[k]))
        assert found == pytest.approx(expected[k], abs=1e-10)


def test_the_energy_of_a_free_grasp_can_be_differentiated(make_energy):
    energy = make_energy()
    function = grasp_function(energy.model)
    T, g = energy.grasps.T_object_tcp[:2]
    symbol = ca.MX.sym("g", 4, 4)
    gradient = ca.Function("d", [symbol], [ca.jacobian(function(T, symbol, 0.05), ca.vec(symbol))])
    flat = g.ravel(order="F")
    assert_derivative(
        lambda x: float(function(T, x.reshape(4, 4, order="F"), 0.05)), np.array(gradient(g))[0], flat, tolerance=1e-5
    )
