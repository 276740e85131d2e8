"""The energy of all grasps of one set as CasADi expressions, with the derivative passes that a solver needs.

A pose has three planar parameters, so derivatives are pushed forward for all grasps at once (three tangents beside
the value, one matrix product a layer) and only the weighted second derivative is pulled back. The plainly built
expression, differentiated by CasADi, is the reference that tests hold these passes to.

Shapes: ``xi`` (3, 1), a placement pose ``T_p`` (4, 4), energies (G, 1), tangents (G, 3).
"""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.energy.activations import casadi_activation
from regrasp_opt.energy.model import GraspEnergy

Blas = Literal["classic", "reference"]
"""CasADi's matrix products: through BLAS, or CasADi's own loops, whose generated C needs no library."""


class PlanarLayer(NamedTuple):
    """The first layer at one placement, (H, G) each: ``z = constant + cosine cos + sine sin + x dx + y dy``."""

    constant: Any
    cosine: Any
    sine: Any
    dx: Any
    dy: Any


class _Layer(NamedTuple):
    slope: Any  # first derivative of the activation (H, G)
    curve: Any  # second derivative of the activation (H, G)
    tangents: list[Any]  # of the pre-activation in xi, three of (H, G), or none


class Pass(NamedTuple):
    """What one evaluation at a pose leaves behind.

    ``energy`` (G, 1); ``tangent`` (G, 3) is dE/dxi, or None where it was not asked for; the rest is the way back.
    """

    energy: Any
    tangent: Any
    slope: Any
    curve: Any
    output_tangent: Any
    turns: tuple[Any, Any]
    shift: tuple[Any, Any]
    tape: list[_Layer]


class CasadiEnergy:
    """CasADi expressions of a `GraspEnergy`; its weights and grasps are constants of the graph."""

    def __init__(self, energy: GraspEnergy, blas: Blas = "classic") -> None:
        self.blas = blas
        self.model = energy.model
        self.count = len(energy)
        first = energy.first_layer
        self._pose = [ca.MX(ca.DM(W)) for W in first.pose]
        self._tcp = [ca.MX(ca.DM(W)) for W in first.tcp]
        self._constant = ca.MX(ca.DM(first.constant))
        # Column g of `_grasps[j]` is row j of grasp g, so that row @ g for all grasps is sum_j row[j] * _grasps[j].
        self._grasps = [ca.MX(ca.DM(np.ascontiguousarray(energy.grasps.T_object_tcp[:, j, :].T))) for j in range(4)]
        self._weights = [ca.MX(ca.DM(W.astype(np.float64))) for W in self.model.weights[1:]]
        self._biases = [ca.MX(ca.DM(b.astype(np.float64))) for b in self.model.biases[1:]]

    def product(self, a: Any, b: Any) -> Any:
        """Return the matrix product, by the chosen implementation."""
        return ca.mtimes(a, b, self.blas)

    def _row_response(self, weights_index: int, row: Any) -> Any:
        """First-layer response (H, G) to one row (1, 4) of an object pose, through that row's weights."""
        direct = self.product(self._pose[weights_index], row.T)
        tcp_row = sum(row[j] * self._grasps[j] for j in range(4))  # (4, G)
        through_tcp = self.product(self._tcp[weights_index], tcp_row) if self.model.features == "tcp" else 0
        return ca.repmat(direct, 1, self.count) + through_tcp

    def planar_layer(self, T_p: Any) -> PlanarLayer:
        """Return the first layer at placement `T_p` (4, 4), affine in (x, y, cos theta, sin theta)."""
        r0, r1, r2 = T_p[0, :], T_p[1, :], T_p[2, :]
        shift = self._pose[0][:, 3], self._pose[1][:, 3]
        if self.model.features == "tcp":
            shift = shift[0] + self._tcp[0][:, 3], shift[1] + self._tcp[1][:, 3]
        return PlanarLayer(
            self._constant + self._row_response(2, r2),
            self._row_response(0, r0) + self._row_response(1, r1),
            self._row_response(1, r0) - self._row_response(0, r1),
            ca.repmat(shift[0], 1, self.count),
            ca.repmat(shift[1], 1, self.count),
        )

    def pose_expression(self, T: Any) -> Any:
        """Return the energies (G, 1) at a full object pose `T` (4, 4), plainly built; CasADi can differentiate it."""
        z = self._constant
        for i in range(3):
            z = z + self._row_response(i, T[i, :])
        return self._plain(z)

    def planar_expression(self, xi: Any, T_p: Any) -> Any:
        """Return the energies (G, 1) at ``dT(xi) @ T_p`` (Eq. 6), plainly built; the reference for `forward`."""
        layer, c, s = self.planar_layer(T_p), ca.cos(xi[2]), ca.sin(xi[2])
        return self._plain(layer.constant + c * layer.cosine + s * layer.sine + xi[0] * layer.dx + xi[1] * layer.dy)

    def _plain(self, z: Any) -> Any:
        for W, b in zip(self._weights, self._biases, strict=True):
            z = self.product(W, casadi_activation(self.model.activation, z).value) + ca.repmat(b, 1, self.count)
        return self._output(z.T)[0]

    def _output(self, f: Any) -> tuple[Any, Any, Any]:
        """Return energy, slope and curvature of the energy in the network's output `f` (G, 1)."""
        if not self.model.bounded:
            return f, ca.MX.ones(self.count, 1), ca.MX.zeros(self.count, 1)
        s = 1 / (1 + ca.exp(-f))
        return ca.fmax(f, 0) + ca.log1p(ca.exp(-ca.fabs(f))), s, s * (1 - s)

    def forward(self, layer: PlanarLayer, xi: Any, *, tangents: bool) -> Pass:
        """Evaluate the energies at planar parameters `xi`, with their gradients if `tangents`."""
        c, s = ca.cos(xi[2]), ca.sin(xi[2])
        z = layer.constant + c * layer.cosine + s * layer.sine + xi[0] * layer.dx + xi[1] * layer.dy
        turns = (
            c * layer.sine - s * layer.cosine,
            -(c * layer.cosine + s * layer.sine),
        )  # first, second in theta
        moving = [layer.dx, layer.dy, turns[0]] if tangents else []
        tape = []
        for W, b in zip(self._weights, self._biases, strict=True):
            a = casadi_activation(self.model.activation, z)
            tape.append(_Layer(a.first, a.second, moving))
            stacked = self.product(W, ca.horzcat(a.value, *[a.first * t for t in moving]))
            z, *moving = ca.horzsplit(stacked, self.count)
            z = z + ca.repmat(b, 1, self.count)
        energy, slope, curve = self._output(z.T)
        df = ca.horzcat(*[t.T for t in moving]) if tangents else None
        tangent = ca.repmat(slope, 1, 3) * df if tangents else None
        return Pass(energy, tangent, slope, curve, df, turns, (layer.dx, layer.dy), tape)

    def gradient(self, passed: Pass, weights: Any) -> Any:
        """Return ``sum_g weights_g dE_g/dxi`` (3, 1) by one sweep back; needs no tangents."""
        adjoint = (weights * passed.slope).T
        for W, layer in zip(reversed(self._weights), reversed(passed.tape), strict=True):
            adjoint = self.product(W.T, adjoint) * layer.slope
        return ca.vertcat(*[ca.dot(adjoint, t) for t in (*passed.shift, passed.turns[0])])

    def curvature(self, passed: Pass, weights: Any) -> Any:
        """Return ``sum_g weights_g d2E_g/dxi2`` (3, 3) at fixed `weights` (G, 1), by one sweep back."""
        df = passed.output_tangent
        total = self.product(df.T, ca.repmat(weights * passed.curve, 1, 3) * df)
        adjoint = (weights * passed.slope).T
        for W, layer in zip(reversed(self._weights), reversed(passed.tape), strict=True):
            adjoint = self.product(W.T, adjoint)
            bent = adjoint * layer.curve
            columns = [ca.vec(t) for t in layer.tangents]
            pushed = ca.horzcat(*[ca.vec(bent * t) for t in layer.tangents])
            total = total + self.product(ca.horzcat(*columns).T, pushed)
            adjoint = adjoint * layer.slope
        return total + ca.diagcat(ca.MX(2, 2), ca.dot(adjoint, passed.turns[1]))
