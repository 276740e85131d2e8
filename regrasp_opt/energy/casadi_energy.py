"""The energy of all grasps of one set as CasADi expressions, with the derivative passes that a solver needs.

The first layer at a placement is affine in (x, y, cos theta, sin theta), so it enters as numbers (`PlanarLayer`) and
everything behind it is one small network for all grasps at once. A pose has k = 3 planar parameters, or the k = 12
numbers of a full pose: derivatives are pushed forward beside the value, one matrix product a layer, and only the
weighted second derivative is pulled back. The plainly built expression, differentiated by CasADi, is the reference that
tests hold these passes to.

Shapes: ``xi`` (3, 1), energies (G, 1), tangents (G, k), hidden layers (H, G).
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.conventions import IntArray
from regrasp_opt.energy.activations import Activation, casadi_activation
from regrasp_opt.energy.model import EnergyModel, GraspEnergy, PlanarLayer
from regrasp_opt.energy.network import evaluate

Blas = Literal["classic", "reference"]
"""CasADi's matrix products: through BLAS, or CasADi's own loops, whose generated C needs no library."""


class _Layer(NamedTuple):
    first: Any  # derivative of the activation (H, G)
    second: Any  # second derivative of the activation (H, G)
    tangents: list[Any]  # of the pre-activation in the pose's parameters, k of (H, G), or none


class Bottom(NamedTuple):
    """The first layer at a pose: pre-activation (H, G), its k tangents (H, G), and its second derivative.

    ``second`` (H, G) is the second derivative in the last parameter, or None; in all others the layer is affine.
    """

    value: Any
    tangents: list[Any]
    second: Any


class Pass(NamedTuple):
    """What one evaluation at a pose leaves behind.

    ``energy`` (G, 1); ``tangent`` (G, k) is its derivative, or None where it was not asked for; the rest is the way
    back.
    """

    energy: Any
    tangent: Any
    first: Any
    second: Any
    output_tangent: Any
    bottom: Bottom
    layers: list[_Layer]


class CasadiEnergy:
    """CasADi expressions of one energy for `count` grasps; its weights are constants of the graph."""

    def __init__(self, model: EnergyModel, count: int, blas: Blas = "classic") -> None:
        self.model = model
        self.count = count
        self.blas = blas
        self._weights = [ca.MX(ca.DM(W.astype(np.float64))) for W, _ in model.layers]
        self._biases = [ca.MX(ca.DM(b.astype(np.float64))) for _, b in model.layers]

    def product(self, a: Any, b: Any) -> Any:
        """Return the matrix product, by the chosen implementation."""
        return ca.mtimes(a, b, self.blas)

    def layer(self, numbers: PlanarLayer) -> PlanarLayer:
        """Return `numbers` as constants of the graph."""
        return PlanarLayer(*(ca.MX(ca.DM(part)) for part in numbers))

    def layer_parameter(self, numbers: Any) -> PlanarLayer:
        """Return the layer whose parts are the columns of the expression `numbers` (H, 3 G + 2)."""
        edges = [k * self.count for k in range(4)]
        return PlanarLayer(*ca.horzsplit(numbers, [*edges, edges[3] + 1, edges[3] + 2]))

    def planar_expression(self, layer: PlanarLayer, xi: Any) -> Any:
        """Return the energies (G, 1) at ``dT(xi) @ T_p`` (Eq. 6), plainly built; the reference for `forward`."""
        return self._plain(self.planar_bottom(layer, xi).value)

    def pose_expression(self, energy: GraspEnergy, T: Any) -> Any:
        """Return the energies (G, 1) at a full object pose `T` (4, 4), plainly built; CasADi can differentiate it."""
        first = energy.first_layer
        z = ca.MX(ca.DM(first.constant))
        for i in range(3):
            z = z + ca.repmat(self.product(ca.DM(first.pose[i]), T[i, :].T), 1, self.count)
            if first.tcp.any():
                rows = [T[i, j] * ca.DM(energy.grasps.T_object_tcp[:, j, :].T) for j in range(4)]
                z = z + self.product(ca.DM(first.tcp[i]), sum(rows[1:], rows[0]))
        return self._plain(z)

    def grasp_expression(self, T: Any, g: Any, width: Any) -> Any:
        """Return the energy (1, 1) at `T` (4, 4) of one grasp `g` (4, 4) T_object_tcp whose numbers are variables too.

        The jaw's `width` [m] is the third variable; `count` is 1.
        """
        weights = self.model.input_weights
        z = ca.DM(self.model.biases[0].astype(np.float64)) + ca.DM(weights.width) * width
        z = z + self.product(ca.DM(weights.grasp), ca.vec(g[:3, :].T))
        tcp = T @ g
        for i in range(3):
            z = z + self.product(ca.DM(weights.pose[i]), T[i, :].T) + self.product(ca.DM(weights.tcp[i]), tcp[i, :].T)
        return self._plain(z)

    def planar_bottom(self, layer: PlanarLayer, xi: Any) -> Bottom:
        """Return the first layer at ``dT(xi) @ T_p`` with its tangents in (x, y, theta)."""
        c, s = ca.cos(xi[2]), ca.sin(xi[2])
        dx, dy = ca.repmat(layer.dx, 1, self.count), ca.repmat(layer.dy, 1, self.count)
        shift = ca.repmat(layer.dx * xi[0] + layer.dy * xi[1], 1, self.count)
        value = layer.constant + c * layer.cosine + s * layer.sine + shift
        return Bottom(value, [dx, dy, c * layer.sine - s * layer.cosine], -(c * layer.cosine + s * layer.sine))

    def pose_bottom(self, energy: GraspEnergy, T: Any, grasp_ids: IntArray) -> Bottom:
        """Return the first layer at a full pose `T` (4, 4), with its tangents in the upper rows of T, column by column.

        `grasp_ids` (G,) chooses the grasps of `energy`.
        """
        first, grasps = energy.first_layer, energy.grasps.T_object_tcp[grasp_ids]
        value, tangents = ca.MX(ca.DM(first.constant[:, grasp_ids])), []
        for j in range(4):
            for i in range(3):
                moved = first.pose[i, :, j, None] + first.tcp[i] @ grasps[:, j].T
                tangents.append(ca.MX(ca.DM(moved)))
                value = value + T[i, j] * tangents[-1]
        return Bottom(value, tangents, None)

    def _plain(self, z: Any) -> Any:
        layers = zip(self._weights, self._biases, strict=True)
        return evaluate(self, layers, self.model.activation, self.model.bounded, z).T

    def activate(self, name: Activation, z: Any) -> Any:
        """Return the activation of `z` (H, G)."""
        return casadi_activation(name, z).value

    def affine(self, a: Any, W: Any, b: Any) -> Any:
        """Return ``W a + b`` (out, G)."""
        return self.product(W, a) + ca.repmat(b, 1, self.count)

    def softplus(self, f: Any) -> Any:
        """Return ``log(1 + exp(f))``, elementwise."""
        return ca.fmax(f, 0) + ca.log1p(ca.exp(-ca.fabs(f)))

    def _output(self, f: Any) -> tuple[Any, Any, Any]:
        """Return the energy and its first and second derivative in the network's output `f` (G, 1)."""
        if not self.model.bounded:
            return f, ca.MX.ones(self.count, 1), ca.MX.zeros(self.count, 1)
        s = 1 / (1 + ca.exp(-f))
        return self.softplus(f), s, s * (1 - s)

    def forward(self, bottom: Bottom, *, tangents: bool) -> Pass:
        """Evaluate the energies at the pose of `bottom`, with their gradients if `tangents`."""
        z, moving = bottom.value, bottom.tangents if tangents else []
        layers = []
        for W, b in zip(self._weights, self._biases, strict=True):
            a = casadi_activation(self.model.activation, z)
            layers.append(_Layer(a.first, a.second, moving))
            stacked = self.product(W, ca.horzcat(a.value, *[a.first * t for t in moving]))
            z, *moving = ca.horzsplit(stacked, self.count)
            z = z + ca.repmat(b, 1, self.count)
        energy, first, second = self._output(z.T)
        df = ca.horzcat(*[t.T for t in moving]) if tangents else None
        tangent = ca.repmat(first, 1, len(moving)) * df if tangents else None
        return Pass(energy, tangent, first, second, df, bottom, layers)

    def gradient(self, passed: Pass, weights: Any) -> Any:
        """Return ``sum_g weights_g dE_g`` (k, 1) by one sweep back; needs no tangents."""
        adjoint = (weights * passed.first).T
        for W, layer in zip(reversed(self._weights), reversed(passed.layers), strict=True):
            adjoint = self.product(W.T, adjoint) * layer.first
        return ca.vertcat(*[ca.dot(adjoint, t) for t in passed.bottom.tangents])

    def curvature(self, passed: Pass, weights: Any) -> Any:
        """Return ``sum_g weights_g d2E_g`` (k, k) at fixed `weights` (G, 1), by one sweep back."""
        df = passed.output_tangent
        count = df.shape[1]
        total = self.product(df.T, ca.repmat(weights * passed.second, 1, count) * df)
        adjoint = (weights * passed.first).T
        for W, layer in zip(reversed(self._weights), reversed(passed.layers), strict=True):
            adjoint = self.product(W.T, adjoint)
            second = adjoint * layer.second
            columns = [ca.vec(t) for t in layer.tangents]
            pushed = ca.horzcat(*[ca.vec(second * t) for t in layer.tangents])
            total = total + self.product(ca.horzcat(*columns).T, pushed)
            adjoint = adjoint * layer.first
        own = passed.bottom.second
        return total if own is None else total + ca.diagcat(ca.MX(count - 1, count - 1), ca.dot(adjoint, own))
