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
from regrasp_opt.energy.model import EnergyModel, GraspEnergy, PlanarLayer
from regrasp_opt.energy.network import Activation, casadi_activation, evaluate

Blas = Literal["classic", "reference"]
"""CasADi's matrix products: through BLAS, or CasADi's own loops, whose generated C needs no library."""


class Bottom(NamedTuple):
    """The first layer at a pose: pre-activation (H, G), its k tangents (H, G), and its second derivative.

    ``second`` (H, G) is the second derivative in the last parameter, or None; in all others the layer is affine.
    """

    value: Any
    tangents: list[Any]
    second: Any


class CasadiEnergy:
    """CasADi expressions of one energy for `count` grasps; its weights are constants of the graph."""

    def __init__(self, model: EnergyModel, count: int, blas: Blas = "classic") -> None:
        self.model = model
        self.count = count
        self.blas = blas
        self.layers: list[Any] = [[ca.MX(ca.DM(part.astype(np.float64))) for part in layer] for layer in model.layers]

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
        """Return the energies (G, 1) at ``dT(xi) @ T_p`` (Eq. 6), plainly built; the reference for `PassedEnergy`."""
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
        return evaluate(self, self.layers, self.model.activation, self.model.bounded, z).T

    def activate(self, name: Activation, z: Any) -> Any:
        """Return the activation of `z` (H, G)."""
        return casadi_activation(name, z).value

    def affine(self, a: Any, W: Any, b: Any) -> Any:
        """Return ``W a + b`` (out, G)."""
        return self.product(W, a) + ca.repmat(b, 1, self.count)

    def softplus(self, f: Any) -> Any:
        """Return ``log(1 + exp(f))``, elementwise."""
        return ca.fmax(f, 0) + ca.log1p(ca.exp(-ca.fabs(f)))


class PassedEnergy:
    """The energies `energy` (G, 1) at the pose of a `Bottom`, and what one evaluation leaves for their derivatives.

    `tangents` says that `second` will be asked for: the gradients are pushed forward beside the value.
    """

    def __init__(self, expressions: CasadiEnergy, bottom: Bottom, tangents: bool) -> None:
        self._expressions, self._bottom = expressions, bottom
        z, moving, model = bottom.value, bottom.tangents if tangents else [], expressions.model
        self._layers = []  # activation's first and second derivative (H, G), and the pre-activation's tangents
        for W, b in expressions.layers:
            a = casadi_activation(model.activation, z)
            self._layers.append((W, a.first, a.second, moving))
            stacked = expressions.product(W, ca.horzcat(a.value, *[a.first * t for t in moving]))
            z, *moving = ca.horzsplit(stacked, expressions.count)
            z = z + ca.repmat(b, 1, expressions.count)
        f, self._output_tangents = z.T, ca.horzcat(*[t.T for t in moving])
        if model.bounded:  # energy, first and second derivative in the network's output
            s = 1 / (1 + ca.exp(-f))
            self.energy, self._first, self._second = expressions.softplus(f), s, s * (1 - s)
        else:
            self.energy, self._first, self._second = f, ca.MX.ones(*f.shape), ca.MX.zeros(*f.shape)

    def gradient(self, weights: Any) -> Any:
        """Return ``sum_g weights_g dE_g`` (k, 1) by one sweep back; needs no tangents."""
        adjoint = (weights * self._first).T
        for W, first, _, _ in reversed(self._layers):
            adjoint = self._expressions.product(W.T, adjoint) * first
        return ca.vertcat(*[ca.dot(adjoint, t) for t in self._bottom.tangents])

    def second(self, weights: Any) -> tuple[Any, Any]:
        """Return dE (G, k) and ``sum_g weights_g d2E_g`` (k, k) at fixed `weights` (G, 1), by one sweep back."""
        df, product = self._output_tangents, self._expressions.product
        count = df.shape[1]
        total = product(df.T, ca.repmat(weights * self._second, 1, count) * df)
        adjoint = (weights * self._first).T
        for W, first, second, tangents in reversed(self._layers):
            adjoint = product(W.T, adjoint)
            columns = ca.horzcat(*[ca.vec(t) for t in tangents])
            pushed = ca.horzcat(*[ca.vec(adjoint * second * t) for t in tangents])
            total = total + product(columns.T, pushed)
            adjoint = adjoint * first
        if self._bottom.second is not None:
            total = total + ca.diagcat(ca.MX(count - 1, count - 1), ca.dot(adjoint, self._bottom.second))
        return ca.repmat(self._first, 1, count) * df, total
