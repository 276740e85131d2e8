import casadi as ca
import numpy as np
import pytest
from derivatives import assert_derivative

from regrasp_opt.energy.network import ACTIVATIONS, activate, casadi_activation


def _functions(name):
    z = ca.MX.sym("z")
    return [ca.Function(part, [z], [value]) for part, value in casadi_activation(name, z)._asdict().items()]


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_numpy_and_casadi_agree_and_neither_overflows(name):
    z = np.concatenate([np.linspace(-6, 6, 41), [-800.0, 800.0]])
    value = _functions(name)[0]
    np.testing.assert_allclose(activate(name, z.copy()), [float(value(v)) for v in z], atol=1e-12)


@pytest.mark.parametrize("name", ACTIVATIONS)
@pytest.mark.parametrize("order", [0, 1])
def test_derivatives_match_finite_differences(name, order):
    functions = _functions(name)
    for z in (-2.3, -0.4, 0.7, 3.1):
        slope = np.array([float(functions[order + 1](z))])
        assert_derivative(lambda x: float(functions[order](x[0])), slope, np.array([z]))


@pytest.mark.parametrize(("name", "torch_name"), [("silu", "silu"), ("selu", "selu"), ("tanh", "tanh")])
def test_activations_are_those_of_torch(name, torch_name):
    import torch

    z = np.linspace(-5, 5, 101)
    expected = getattr(torch.nn.functional, torch_name)(torch.as_tensor(z)).numpy()
    np.testing.assert_allclose(activate(name, z.copy()), expected, atol=1e-12)
