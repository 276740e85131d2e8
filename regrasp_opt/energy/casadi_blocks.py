"""Energies of one pose of a chain, with the two derivative passes, for any number of grasps.

A pose of a chain moves with its planar parameters or with the numbers of a full pose, or its energies themselves are
given.

Up to `BLOCK` grasps one expression serves value and derivatives. Beyond, its intermediate matrices would no longer fit
the processor's caches, so grasps are evaluated block by block through functions that reuse their work memory; the
energies are then computed once more in the derivative passes, which is far cheaper than the cache misses.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import Any, Protocol

import casadi as ca

from regrasp_opt.conventions import IntArray
from regrasp_opt.energy.casadi_energy import CasadiEnergy, PassedEnergy
from regrasp_opt.energy.model import PlanarLayer

BLOCK = 256
"""Most grasps that are evaluated in one piece."""


class PoseEnergy(Protocol):
    """Energies (G, 1) at one pose and their derivatives in its k parameters."""

    energy: Any

    def gradient(self, weights: Any) -> Any:
        """Return ``sum_g weights_g dE_g`` (k, 1)."""

    def second(self, weights: Any) -> tuple[Any, Any]:
        """Return dE (G, k) and ``sum_g weights_g d2E_g`` (k, k)."""
        ...


def planar_energy(energy: CasadiEnergy, layer: PlanarLayer, xi: Any, *, tangents: bool) -> PoseEnergy:
    """Return the energies at ``dT(xi) @ T_p``; `tangents` says that `second` will be asked for, not `gradient`."""
    if energy.count <= BLOCK:
        return PassedEnergy(energy, energy.planar_bottom(layer, xi), tangents)
    return _Blocked(energy, layer, xi)


class PartlyKnownEnergy:
    """The energies of `pose`, but `value` where `known` (G, 1) is 1, not 0; that value does not move with the pose."""

    def __init__(self, pose: PoseEnergy, known: Any, value: float) -> None:
        self._pose, self._learned = pose, 1 - known
        self.energy = self._learned * pose.energy + value * (1 - self._learned)

    def gradient(self, weights: Any) -> Any:
        """Return the gradient of `pose` by the grasps that are not known."""
        return self._pose.gradient(self._learned * weights)

    def second(self, weights: Any) -> tuple[Any, Any]:
        """Return the derivatives of `pose` by the grasps that are not known."""
        tangent, curvature = self._pose.second(self._learned * weights)
        return ca.repmat(self._learned, 1, tangent.shape[1]) * tangent, curvature


class FixedEnergy:
    """Given energies (G, 1) that nothing is differentiated in."""

    def __init__(self, energy: Any) -> None:
        self.energy = energy

    def gradient(self, weights: Any) -> Any:
        """Return nothing, (0, 1)."""
        return ca.MX(0, 1)

    def second(self, weights: Any) -> tuple[Any, Any]:
        """Return nothing, (G, 0) and (0, 0)."""
        return ca.MX(self.energy.shape[0], 0), ca.MX(0, 0)


class FreeEnergy:
    """Chosen ones, `ids` (G,), of given energies (F, 1) that are parameters themselves."""

    def __init__(self, energies: Any, ids: IntArray) -> None:
        rows, count = ids.tolist(), len(ids)
        self.energy = energies[rows]
        self._spread = ca.MX(ca.DM(ca.Sparsity.triplet(energies.shape[0], count, rows, list(range(count))), 1))

    def gradient(self, weights: Any) -> Any:
        """Return `weights` where they belong, (F, 1)."""
        return self._spread @ weights

    def second(self, weights: Any) -> tuple[Any, Any]:
        """Return the choice (G, F) and structural zeros (F, F)."""
        size = self._spread.shape[0]
        return self._spread.T, ca.MX(size, size)


class FullPoseEnergy(PassedEnergy):
    """The energies at a full pose (4, 4), whose parameters are its 16 numbers, column by column.

    The last row of a pose carries no energy: derivatives in it are structural zeros.
    """

    _spread = ca.DM(ca.Sparsity.triplet(16, 12, [4 * j + i for j in range(4) for i in range(3)], list(range(12))), 1)

    def gradient(self, weights: Any) -> Any:
        """Return ``sum_g weights_g dE_g`` (16, 1)."""
        return self._spread @ super().gradient(weights)

    def second(self, weights: Any) -> tuple[Any, Any]:
        """Return dE (G, 16) and ``sum_g weights_g d2E_g`` (16, 16)."""
        tangent, curvature = super().second(weights)
        return tangent @ self._spread.T, self._spread @ curvature @ self._spread.T


class _Blocked:
    def __init__(self, energy: CasadiEnergy, layer: PlanarLayer, xi: Any) -> None:
        count = -(-energy.count // BLOCK)
        self._xi, self._blocks = xi, []
        for first, last in pairwise(energy.count * k // count for k in range(count + 1)):
            numbers = ca.horzcat(*(part[:, first:last] for part in layer[:3]), layer.dx, layer.dy)
            self._blocks.append((_passes(energy, last - first), numbers, slice(first, last)))
        self.energy = ca.vertcat(*[passes[0](numbers, xi) for passes, numbers, _ in self._blocks])

    def gradient(self, weights: Any) -> Any:
        parts = [passes[1](numbers, self._xi, weights[part]) for passes, numbers, part in self._blocks]
        return sum(parts[1:], parts[0])

    def second(self, weights: Any) -> tuple[Any, Any]:
        parts = [passes[2](numbers, self._xi, weights[part]) for passes, numbers, part in self._blocks]
        curvatures = [curvature for _, curvature in parts]
        return ca.vertcat(*[tangent for tangent, _ in parts]), sum(curvatures[1:], curvatures[0])


@lru_cache(maxsize=8)
def _passes(energy: CasadiEnergy, size: int) -> tuple[Any, Any, Any]:
    """Return value, gradient and second derivatives of `size` grasps, built once for the blocks of an energy.

    They are functions of (layer numbers (H, 3 size + 2), xi, weights).
    """
    block = CasadiEnergy(energy.model, size, energy.blas)
    numbers, xi, w = ca.MX.sym("layer", energy.model.hidden, 3 * size + 2), ca.MX.sym("xi", 3), ca.MX.sym("w", size)
    bottom = block.planar_bottom(block.layer_parameter(numbers), xi)
    light, full = (PassedEnergy(block, bottom, tangents) for tangents in (False, True))
    return (
        ca.Function("value", [numbers, xi], [light.energy]),
        ca.Function("gradient", [numbers, xi, w], [light.gradient(w)]),
        ca.Function("second", [numbers, xi, w], list(full.second(w))),
    )
