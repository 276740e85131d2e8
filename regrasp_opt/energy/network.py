"""The network behind the energy, written once for NumPy, torch, CasADi and ONNX, and its activation functions.

Layers are affine maps with one activation between them; a bounded energy passes the output through softplus. A backend
knows how to do each of these on its own arrays. The derivative passes for solvers walk the same layers
(`regrasp_opt.energy.casadi_energy`). SELU is the paper's choice. It is not C1, which costs a second-order solver its
convergence, so SiLU is our default.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Literal, NamedTuple, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray

Activation = Literal["silu", "selu", "tanh"]
ACTIVATIONS: tuple[Activation, ...] = ("silu", "selu", "tanh")

_SELU_SCALE = 1.0507009873554805
_SELU_ALPHA = 1.6732632423543772


class Derivatives(NamedTuple):
    """Value, first and second derivative of an activation, elementwise."""

    value: Any
    first: Any
    second: Any


def activate(name: Activation, z: NDArray[Any]) -> NDArray[Any]:
    """Return the activation of `z`, in its dtype; `z` is overwritten."""
    if name == "tanh":
        return np.tanh(z, out=z)
    if name == "silu":  # z * sigmoid(z), written with tanh because that cannot overflow
        half = z * z.dtype.type(0.5)
        np.tanh(half, out=half)
        half += 1
        half *= z.dtype.type(0.5)
        return np.multiply(z, half, out=z)
    negative = np.expm1(np.minimum(z, 0)) * z.dtype.type(_SELU_SCALE * _SELU_ALPHA)
    return np.where(z > 0, z * z.dtype.type(_SELU_SCALE), negative)


def activate_with_slope(name: Activation, z: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the activation of `z` and its first derivative, in its dtype."""
    one = z.dtype.type(1)
    if name == "tanh":
        value = np.tanh(z)
        return value, one - value * value
    if name == "silu":
        sigmoid = (one + np.tanh(z / 2)) / 2
        return z * sigmoid, sigmoid * (one + z * (one - sigmoid))
    value = activate(name, z.copy())
    scale, shift = z.dtype.type(_SELU_SCALE), z.dtype.type(_SELU_SCALE * _SELU_ALPHA)
    return value, np.where(z > 0, scale, value + shift)


def casadi_activation(name: Activation, z: Any) -> Derivatives:
    """Return the activation of the CasADi expression `z` and its derivatives as CasADi expressions."""
    if name == "tanh":
        t = ca.tanh(z)
        first = 1 - t * t
        return Derivatives(t, first, -2 * t * first)
    if name == "silu":
        s = 1 / (1 + ca.exp(-z))
        value = z * s
        sigmoid_first = s * (1 - s)
        first = s + z * sigmoid_first
        return Derivatives(value, first, sigmoid_first * (2 + z * (1 - 2 * s)))
    scaled = _SELU_SCALE * _SELU_ALPHA * ca.exp(ca.fmin(z, 0))
    positive = z > 0
    return Derivatives(
        ca.if_else(positive, _SELU_SCALE * z, scaled - _SELU_SCALE * _SELU_ALPHA),
        ca.if_else(positive, _SELU_SCALE, scaled),
        ca.if_else(positive, 0, scaled),
    )


class TorchNetwork:
    """A network's backend on torch tensors (..., H); torch is imported with the first instance."""

    def __init__(self) -> None:
        import torch

        functional = torch.nn.functional
        self._activations: dict[Activation, Callable[[Any], Any]] = {
            "silu": functional.silu,
            "selu": functional.selu,
            "tanh": torch.tanh,
        }
        self.affine: Callable[[Any, Any, Any], Any] = functional.linear
        self.softplus: Callable[[Any], Any] = functional.softplus

    def activate(self, name: Activation, z: Any) -> Any:
        """Return the activation of `z`."""
        return self._activations[name](z)


class Backend(Protocol):
    """The operations of a network on one library's arrays."""

    def activate(self, name: Activation, z: Any) -> Any:
        """Return the activation of `z`, elementwise."""

    def affine(self, a: Any, W: Any, b: Any) -> Any:
        """Return `W` applied to the units of `a`, plus `b`."""

    def softplus(self, f: Any) -> Any:
        """Return ``log(1 + exp(f))``, elementwise."""


def evaluate(backend: Backend, layers: Iterable[tuple[Any, Any]], activation: Activation, bounded: bool, z: Any) -> Any:
    """Return the energy where the first layer's pre-activation is `z`.

    `layers` (W, b) are those after the first, weights (out, in) and biases (out,). A `bounded` energy is
    ``softplus(f)`` of the network's output ``f``, another one ``f`` itself.
    """
    for W, b in layers:
        z = backend.affine(backend.activate(activation, z), W, b)
    return backend.softplus(z) if bounded else z
