"""`Q_pair` (Eq. 4) and `J_seq` (Eq. 5) as CasADi functions of planar parameters, with exact derivatives.

`sequence_functions` is what a solver uses: value, gradient and Hessian of ``J_seq`` for N intermediate poses whose
first layers, and the energies at start and goal, are parameters, so that one solver object serves every problem with
the same N and the same number of grasps. Writing ``w_i`` for the softmin weights of pair i and ``c_i = dJ/dQ_i``,
the chain rule gives

    dJ/dE_i       = omega_i = c_{i-1} w_{i-1} + c_i w_i
    Hessian       = sum_i sum_g omega_ig d2E_ig                        (block diagonal, one sweep a pose)
                  - sum_i c_i / alpha * Cov_{w_i}[dE_i + dE_{i+1}]       (tridiagonal blocks)
                  + 2 lambda_reg sum_i (dQ_i - dQ_{i+1}) (dQ_i - dQ_{i+1})^T
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from regrasp_opt.connectivity.costs import CostOptions
from regrasp_opt.conventions import FloatArray
from regrasp_opt.energy.casadi_blocks import pose_energy
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.energy.model import GraspEnergy, PlanarLayer
from regrasp_opt.errors import OptionError


class ConnectivityFunctions(NamedTuple):
    """`E`, `Q_pair` and `J_seq` of one chain of poses as `casadi.Function`; see `connectivity_functions`."""

    E: Any
    Q_pair: Any
    J_seq: Any


class SequenceFunctions(NamedTuple):
    """``J_seq`` and what a solver needs of it, as functions of ``xi`` (3, N), ``layers`` (H, 3 G N), ``ends`` (G, 2).

    ``cost`` gives J; ``gradient`` J and its gradient (3N, 1); ``scores`` the pair scores Q (N+1, 1) and their
    Jacobian (N+1, 3N); ``hessian`` takes two more inputs, ``scale`` and ``multipliers`` (N+1), and gives the Hessian
    (3N, 3N) of ``scale J + multipliers . Q``.
    """

    cost: Any
    gradient: Any
    scores: Any
    hessian: Any


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
    """Return ``J_seq`` of the N+1 pair scores (Eq. 5)."""
    cost = sum(scores[1:], scores[0])
    for i in range(len(scores) - 1):
        cost = cost + lambda_reg * (scores[i] - scores[i + 1]) ** 2
    return cost


def plain_sequence_cost(energy: CasadiEnergy, options: CostOptions, num_regrasps: int) -> Any:
    """Return ``J_seq`` as a function built without any derivative structure: the reference for `sequence_functions`."""
    xi, layers, ends = _symbols(energy, num_regrasps)
    energies = [energy.planar_expression(layer, xi[:, i]) for i, layer in enumerate(_split(energy, layers))]
    chain = [ends[:, 0], *energies, ends[:, 1]]
    scores = [pair_score(a, b, options) for a, b in itertools.pairwise(chain)]
    cost = cost_of_scores(scores, options.regularisation)
    return ca.Function("J_seq_plain", [xi, layers, ends], [cost], ["xi", "layers", "ends"], ["J"])


def sequence_functions(energy: CasadiEnergy, options: CostOptions, num_regrasps: int) -> SequenceFunctions:
    """Return value, gradient and Hessian of ``J_seq`` for `num_regrasps` intermediate poses (see module docstring).

    Raises
    ------
    OptionError
        For the truncated variant, which has no useful derivative where no grasp is shared.
    """
    if options.variant == "Jh":
        raise OptionError("the truncated cost Jh is not differentiable; use variant J or J+ with a gradient solver")
    xi, packed, ends = inputs = _symbols(energy, num_regrasps)
    names = ["xi", "layers", "ends"]
    layers = _split(energy, packed)

    scale, multipliers = ca.MX.sym("scale"), ca.MX.sym("multipliers", num_regrasps + 1)
    light = [pose_energy(energy, layer, xi[:, i], tangents=False) for i, layer in enumerate(layers)]
    chain = _Chain([ends[:, 0], *(p.energy for p in light), ends[:, 1]], options)
    gradient = [p.gradient(chain.omega(i + 1)) for i, p in enumerate(light)]

    full = [pose_energy(energy, layer, xi[:, i], tangents=True) for i, layer in enumerate(layers)]
    bent = _Chain([ends[:, 0], *(p.energy for p in full), ends[:, 1]], options, scale, multipliers)
    tangents, curvatures = zip(*[p.second(bent.omega(i + 1)) for i, p in enumerate(full)], strict=True)
    hessian = ca.diagcat(*curvatures) + bent.coupling(tangents)
    unweighted = ca.MX.ones(energy.count)
    scores = [ca.vertcat(*bent.scores), bent.score_jacobian([p.second(unweighted)[0] for p in full])]
    return SequenceFunctions(
        ca.Function("J_seq", inputs, [chain.cost], names, ["J"]),
        ca.Function("J_seq_gradient", inputs, [chain.cost, ca.vertcat(*gradient)], names, ["J", "gradient"]),
        ca.Function("Q_pair", inputs, scores, names, ["Q", "jacobian"]),
        ca.Function("hessian", [*inputs, scale, multipliers], [hessian], [*names, "scale", "multipliers"], ["hessian"]),
    )


def connectivity_functions(
    energy: GraspEnergy, options: CostOptions, start: FloatArray, goal: FloatArray, placements: FloatArray
) -> ConnectivityFunctions:
    """Return ``E``, ``Q_pair`` and ``J_seq`` of the chain start, N intermediate poses, goal.

    Parameters
    ----------
    start, goal : (G,)
        Energies of the fixed poses.
    placements : (N, 4, 4)
        The stable placement of each intermediate pose.

    Returns
    -------
    ConnectivityFunctions
        Each takes ``xi`` (3, N), the planar parameters in [m, m, rad] of the intermediate poses: ``E`` (G, N),
        ``Q_pair`` (N+1, 1) of the neighbouring pairs, ``J_seq`` (1, 1). They hold no state, can be differentiated,
        mapped, saved and turned into C.
    """
    num_regrasps = len(placements)
    expressions = CasadiEnergy(energy.model, len(energy), "reference")
    xi = ca.MX.sym("xi", 3, num_regrasps)
    layers = [expressions.layer(energy.planar_layer(T)) for T in placements]
    energies = [expressions.planar_expression(layer, xi[:, i]) for i, layer in enumerate(layers)]
    chain = [ca.MX(ca.DM(start)), *energies, ca.MX(ca.DM(goal))]
    scores = [pair_score(a, b, options) for a, b in itertools.pairwise(chain)]
    cost = cost_of_scores(scores, options.regularisation)
    stacked = ca.horzcat(*energies) if energies else ca.MX(len(energy), 0)
    return ConnectivityFunctions(
        ca.Function("E", [xi], [stacked], ["xi"], ["E"]),
        ca.Function("Q_pair", [xi], [ca.vertcat(*scores)], ["xi"], ["Q"]),
        ca.Function("J_seq", [xi], [cost], ["xi"], ["J"]),
    )


def _symbols(energy: CasadiEnergy, num_regrasps: int) -> list[Any]:
    return [
        ca.MX.sym("xi", 3, num_regrasps),
        ca.MX.sym("layers", energy.model.hidden, 3 * energy.count * num_regrasps),
        ca.MX.sym("ends", energy.count, 2),
    ]


class _Chain:
    """Pair scores of a chain of energies and what the chain rule needs of ``scale J + multipliers . Q``."""

    def __init__(self, energies: list[Any], options: CostOptions, scale: Any = 1, multipliers: Any = None) -> None:
        pairs = list(itertools.pairwise(energies))
        self.alpha = options.alpha
        self.lambda_reg = scale * options.regularisation
        self.scores = [pair_score(a, b, options) for a, b in pairs]
        self.cost = cost_of_scores(self.scores, options.regularisation)
        self.weights = [softmin_weights(a, b, options.alpha) for a, b in pairs]
        self.slopes = []  # c_i = d(scale J + multipliers . Q) / dQ_i
        for i, score in enumerate(self.scores):
            slope = scale + (0 if multipliers is None else multipliers[i])
            for j in (i - 1, i + 1):
                if 0 <= j < len(self.scores):
                    slope = slope + 2 * self.lambda_reg * (score - self.scores[j])
            self.slopes.append(slope)

    def omega(self, i: int) -> Any:
        """Return dJ/dE (G, 1) at pose i of the chain, start being pose 0."""
        return self.slopes[i - 1] * self.weights[i - 1] + self.slopes[i] * self.weights[i]

    def score_jacobian(self, tangents: Sequence[Any]) -> Any:
        """Return dQ/dxi (N+1, 3N) from dE/dxi (G, 3) of the N intermediate poses."""
        rows = []
        for (first, move), w in zip(_moves(tangents), self.weights, strict=True):
            row = ca.MX(1, 3 * len(tangents))
            row[0, first : first + move.shape[1]] = ca.mtimes(w.T, move)
            rows.append(row)
        return ca.vertcat(*rows)

    def coupling(self, tangents: Sequence[Any]) -> Any:
        """Return the Hessian's part that couples poses, (3N, 3N), from dE/dxi (G, 3) of the N intermediate poses."""
        size = 3 * len(tangents)
        total = ca.MX(size, size)
        slopes = []  # dQ_i over all variables, (3N, 1), structurally zero where it does not depend on them
        for (first, move), w, c in zip(_moves(tangents), self.weights, self.slopes, strict=True):
            own = slice(first, first + move.shape[1])
            slope = ca.mtimes(move.T, w)
            spread = ca.mtimes(move.T, ca.repmat(w, 1, move.shape[1]) * move) - slope @ slope.T
            block, padded = ca.MX(size, size), ca.MX(size, 1)
            block[own, own], padded[own] = c / self.alpha * spread, slope
            total = total - block
            slopes.append(padded)
        for a, b in itertools.pairwise(slopes):
            total = total + 2 * self.lambda_reg * (a - b) @ (a - b).T
        return total


def _moves(tangents: Sequence[Any]) -> list[tuple[int, Any]]:
    """Return, for each of the N+1 pairs, its first variable and d(E_i + E_{i+1}) over its own variables (G, 3 or 6)."""
    count = len(tangents)
    pairs = [(max(i - 1, 0), min(i + 1, count)) for i in range(count + 1)]
    return [(3 * first, ca.horzcat(*tangents[first:last])) for first, last in pairs]


def layers_parameter(energy: GraspEnergy, placements: FloatArray, grasp_ids: Any = slice(None)) -> FloatArray:
    """Return the ``layers`` input (H, 3 G N) of the chosen grasps at `placements` (N, 4, 4)."""
    layers = [np.concatenate(energy.planar_layer(T, grasp_ids)[:3], axis=1) for T in placements]
    return np.concatenate(layers, axis=1) if layers else np.zeros((energy.model.hidden, 0))


def _split(energy: CasadiEnergy, layers: Any) -> list[PlanarLayer]:
    return [energy.layer_parameter(part) for part in ca.horzsplit(layers, 3 * energy.count)]
