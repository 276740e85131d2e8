"""Pose connectivity `Q_pair` (Eq. 4), the cost `J_seq` (Eq. 5) and the paper's variants, on arrays of energies.

The same lines serve NumPy arrays and torch tensors; `connectivity.casadi_costs` states them for CasADi, and a test
holds the three equal. Leading axes are batch axes; the last axis runs over grasps.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from regrasp_opt.conventions import FloatArray
from regrasp_opt.errors import OptionError

CostVariant = Literal["J", "J+", "Jh"]
COST_VARIANTS: tuple[CostVariant, ...] = ("J", "J+", "Jh")


@dataclass(frozen=True)
class CostOptions:
    """Parameters of the sequence cost.

    Attributes
    ----------
    alpha : float
        Smoothness of the marginalisation over grasps, Eq. 4 (paper: 1.0).
    lambda_reg : float
        Weight of the bottleneck regulariser, Eq. 5 (paper: 0.5).
    variant : {"J", "J+", "Jh"}
        ``J`` is Eq. 5; ``J+`` leaves the regulariser out (Eq. 9); ``Jh`` counts only grasps whose summed energy is
        below `h` (Eqs. 8 and 10).
    h : float
        Threshold of ``Jh``; the other variants ignore it.
    """

    alpha: float = 1.0
    lambda_reg: float = 0.5
    variant: CostVariant = "J"
    h: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.alpha) and self.alpha > 0):
            raise OptionError(f"alpha is {self.alpha}; give a positive number (the paper uses 1.0)")
        if not (math.isfinite(self.lambda_reg) and self.lambda_reg >= 0):
            raise OptionError(f"lambda_reg is {self.lambda_reg}; give 0 or a positive number (the paper uses 0.5)")
        if self.variant not in COST_VARIANTS:
            raise OptionError(f"cost variant '{self.variant}' is unknown; use one of {', '.join(COST_VARIANTS)}")

    @property
    def regularisation(self) -> float:
        """The weight of the regulariser that the variant leaves in force."""
        return 0.0 if self.variant == "J+" else self.lambda_reg


def _namespace(array: Any) -> Any:
    if isinstance(array, np.ndarray):
        return np
    import torch

    return torch


def pair_score(energy_a: Any, energy_b: Any, alpha: float = 1.0) -> Any:
    """Return ``Q_pair = -alpha log sum_g exp(-(E_a + E_b) / alpha)`` (...,) of energies (..., G) (Eq. 4)."""
    xp = _namespace(energy_a)
    total = energy_a + energy_b
    least = xp.amin(total, -1)
    return least - alpha * xp.log(xp.sum(xp.exp((least[..., None] - total) / alpha), -1))


def truncated_pair_score(energy_a: Any, energy_b: Any, h: float, alpha: float = 1.0) -> Any:
    """Return ``Q^h_pair``: Eq. 10, the sum over grasps with ``E_a + E_b < h`` only, and 0 where there is none."""
    xp = _namespace(energy_a)
    total = energy_a + energy_b
    kept = total < h
    least = xp.amin(total, -1)
    terms = xp.where(kept, xp.exp((least[..., None] - total) / alpha), xp.zeros_like(total))
    some = xp.any(kept, -1)
    mass = xp.where(some, xp.sum(terms, -1), xp.ones_like(least))
    return xp.where(some, least - alpha * xp.log(mass), xp.zeros_like(least))


def pair_weights(energies: FloatArray, options: CostOptions) -> FloatArray:
    """Return the derivative (..., M, G) of `sequence_cost` by `energies` (..., M, G), for the variants J and J+.

    With the softmin weights ``w_i`` of pair i, which sum to one, ``dJ/dE_i = c_{i-1} w_{i-1} + c_i w_i`` where
    ``c_i = dJ/dQ_i = 1 + 2 lambda_reg sum_j (Q_i - Q_j)`` over the neighbouring pairs j.
    """
    total = energies[..., :-1, :] + energies[..., 1:, :]
    least = total.min(axis=-1, keepdims=True)
    terms = np.exp((least - total) / options.alpha)
    mass = terms.sum(axis=-1, keepdims=True)
    scores = (least - options.alpha * np.log(mass))[..., 0]
    steps = 2 * options.regularisation * np.diff(scores, axis=-1)
    sensitivity = np.ones_like(scores)
    sensitivity[..., 1:] += steps
    sensitivity[..., :-1] -= steps
    weighted = sensitivity[..., None] * terms / mass
    derivative = np.zeros_like(energies)
    derivative[..., :-1, :] += weighted
    derivative[..., 1:, :] += weighted
    return derivative


def sequence_cost(energies: Any, options: CostOptions) -> Any:
    """Return the cost (...,) of pose sequences from their energies (..., N+2, G), start and goal included (Eq. 5)."""
    a, b = energies[..., :-1, :], energies[..., 1:, :]
    if options.variant == "Jh":
        scores = truncated_pair_score(a, b, options.h, options.alpha)
    else:
        scores = pair_score(a, b, options.alpha)
    return sequence_cost_of_scores(scores, options)


def sequence_cost_of_scores(scores: Any, options: CostOptions) -> Any:
    """Return the cost (...,) of sequences from their pair scores (..., N+1) (Eq. 5)."""
    steps = scores[..., :-1] - scores[..., 1:]
    return scores.sum(-1) + options.regularisation * (steps * steps).sum(-1)
