"""`Q_pair` (Eq. 4) and `J_seq` (Eq. 5) of a chain of poses as CasADi expressions, with the chain rule through them.

Writing ``w_i`` for the softmin weights of pair i and ``c_i = dJ/dQ_i``, the chain rule gives

    dJ/dE_i       = omega_i = c_{i-1} w_{i-1} + c_i w_i
    Hessian       = sum_i sum_g omega_ig d2E_ig                        (block diagonal, one sweep a pose)
                  - sum_i c_i / alpha * Cov_{w_i}[dE_i + dE_{i+1}]       (tridiagonal blocks)
                  + 2 lambda_reg sum_i (dQ_i - dQ_{i+1}) (dQ_i - dQ_{i+1})^T
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import casadi as ca

from regrasp_opt.connectivity.costs import CostOptions
from regrasp_opt.energy.casadi_blocks import PoseEnergy


def pair_score(energy_a: Any, energy_b: Any, options: CostOptions) -> Any:
    """Return the pair score of energies (G, 1): ``Q_pair`` (Eq. 4), or ``Q^h_pair`` (Eq. 10) for variant ``Jh``."""
    total = energy_a + energy_b
    if options.variant != "Jh":
        return -options.alpha * ca.logsumexp(-total / options.alpha)
    kept = total < options.h
    least = ca.mmin(total)
    mass = ca.sum1(ca.if_else(kept, ca.exp((least - total) / options.alpha), 0))
    some = ca.mmax(kept)
    return ca.if_else(some, least - options.alpha * ca.log(ca.if_else(some, mass, 1)), 0)


def softmin_weights(energy_a: Any, energy_b: Any, alpha: float) -> Any:
    """Return ``w = dQ_pair/dE_a = dQ_pair/dE_b`` (G, 1), which sum to one."""
    total = -(energy_a + energy_b) / alpha
    terms = ca.exp(total - ca.mmax(total))
    return terms / ca.sum1(terms)


def cost_of_scores(scores: Sequence[Any], lambda_reg: float) -> Any:
    """Return ``J_seq`` of the pair scores (Eq. 5); 0 where there is no pair."""
    cost = sum(scores, start=ca.MX(0))
    for a, b in itertools.pairwise(scores):
        cost = cost + lambda_reg * (a - b) ** 2
    return cost


class Chain:
    """A chain of M poses with its M-1 pair scores and ``J_seq``, and their derivatives.

    The k_0, ..., k_{M-1} parameters of the `poses`, one pose after the other, are the n variables. The `penalty` (G, 1)
    is added to the energy of every pair.
    """

    def __init__(self, poses: Sequence[PoseEnergy], options: CostOptions, penalty: Any = 0) -> None:
        energies = [pose.energy for pose in poses]
        pairs = [(a + penalty, b) for a, b in itertools.pairwise(energies)]
        self.poses = poses
        self.alpha, self.lambda_reg = options.alpha, options.regularisation
        self.scores = [pair_score(a, b, options) for a, b in pairs]
        self.cost = cost_of_scores(self.scores, self.lambda_reg)
        self.weights = [softmin_weights(a, b, options.alpha) for a, b in pairs]  # w_i
        self.sensitivities = []  # c_i = dJ/dQ_i
        for i, score in enumerate(self.scores):
            near = [self.scores[j] for j in (i - 1, i + 1) if 0 <= j < len(self.scores)]
            self.sensitivities.append(sum((2 * self.lambda_reg * (score - other) for other in near), start=ca.MX(1)))

    def gradient(self) -> Any:
        """Return the gradient (n, 1) of ``J_seq`` by one sweep back a pose; needs no tangents."""
        return ca.vertcat(*[pose.gradient(self._omega(i)) for i, pose in enumerate(self.poses)])

    def hessian(self) -> Any:
        """Return the Hessian (n, n) of ``J_seq``."""
        second = [pose.second(self._omega(i)) for i, pose in enumerate(self.poses)]
        tangents = [tangent for tangent, _ in second]
        total = ca.diagcat(*[curvature for _, curvature in second])
        for i, c in enumerate(self.sensitivities):
            total = total - c * self._spread(tangents, i)
        for a, b in itertools.pairwise(self._score_gradients(tangents)):
            total = total + 2 * self.lambda_reg * (a - b) @ (a - b).T
        return total

    def score_jacobian(self) -> Any:
        """Return dQ (M-1, n)."""
        gradients = self._score_gradients(self._tangents())
        return ca.horzcat(*gradients).T if gradients else ca.MX(0, self._edges(self._tangents())[-1])

    def score_hessians(self) -> list[Any]:
        """Return the Hessian (n, n) of each pair score."""
        tangents = self._tangents()
        edges = self._edges(tangents)
        hessians = []
        for i, w in enumerate(self.weights):
            curvatures = [self.poses[j].second(w)[1] for j in (i, i + 1)]
            own = slice(edges[i], edges[i + 2])
            block = ca.MX(edges[-1], edges[-1])
            block[own, own] = ca.diagcat(*curvatures)
            hessians.append(block - self._spread(tangents, i))
        return hessians

    def _omega(self, i: int) -> Any:
        """Return dJ/dE (G, 1) at pose i."""
        near = [self.sensitivities[j] * self.weights[j] for j in (i - 1, i) if 0 <= j < len(self.weights)]
        return sum(near, start=ca.MX(self.poses[i].energy.shape[0], 1))

    def _tangents(self) -> list[Any]:
        unweighted = ca.MX.ones(self.poses[0].energy.shape[0])
        return [pose.second(unweighted)[0] for pose in self.poses]

    def _edges(self, tangents: Sequence[Any]) -> list[int]:
        """Return where each pose's variables begin, and their number."""
        return list(itertools.accumulate([tangent.shape[1] for tangent in tangents], initial=0))

    def _score_gradients(self, tangents: Sequence[Any]) -> list[Any]:
        """Return each dQ_i over all variables (n, 1), structurally zero where it does not depend on them."""
        edges = self._edges(tangents)
        gradients = []
        for i, w in enumerate(self.weights):
            gradient = ca.MX(edges[-1], 1)
            gradient[edges[i] : edges[i + 2]] = ca.mtimes(ca.horzcat(*tangents[i : i + 2]).T, w)
            gradients.append(gradient)
        return gradients

    def _spread(self, tangents: Sequence[Any], i: int) -> Any:
        """Return ``Cov_{w_i}[dE_i + dE_{i+1}] / alpha`` (n, n)."""
        edges, w = self._edges(tangents), self.weights[i]
        move = ca.horzcat(*tangents[i : i + 2])
        mean = ca.mtimes(move.T, w)
        own = slice(edges[i], edges[i + 2])
        spread = ca.MX(edges[-1], edges[-1])
        spread[own, own] = (ca.mtimes(move.T, ca.repmat(w, 1, move.shape[1]) * move) - mean @ mean.T) / self.alpha
        return spread
