"""The network behind the energy, written once for NumPy, torch, CasADi and ONNX.

Layers are affine maps with one activation between them; a bounded energy passes the output through softplus. A backend
knows how to do each of these on its own arrays. The derivative passes for solvers walk the same layers
(`regrasp_opt.energy.casadi_energy`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Protocol

from regrasp_opt.energy.activations import Activation


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
