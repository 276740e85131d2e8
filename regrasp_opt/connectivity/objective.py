"""What a refiner minimises: `J_seq` over the intermediate poses of one problem, with everything that stays fixed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from regrasp_opt.connectivity.costs import CostOptions, sequence_cost
from regrasp_opt.conventions import FloatArray, IntArray, planar_transform
from regrasp_opt.energy.model import GraspEnergy


@dataclass(frozen=True)
class SequenceObjective:
    """``J_seq`` of Eq. 5 as a function of placements and planar parameters.

    Attributes
    ----------
    energy : GraspEnergy
        Of G grasps.
    placements : (S, 4, 4)
        Stable placements, T_world_object at xi = 0.
    start_energy, goal_energy : (G,)
        Energies at the fixed ends. Planning passes exact ones there: 0 for a feasible grasp, `BLOCKED` otherwise.
    bounds : (2, 2)
        ``[[x_low, y_low], [x_high, y_high]]`` of intermediate poses [m].
    options : CostOptions
    """

    energy: GraspEnergy
    placements: FloatArray
    start_energy: FloatArray
    goal_energy: FloatArray
    bounds: FloatArray
    options: CostOptions

    def poses(self, placements: IntArray, xi: FloatArray) -> FloatArray:
        """Return object poses (..., 4, 4) of placement numbers (...) and planar parameters (..., 3) (Eq. 6)."""
        return planar_transform(xi) @ self.placements[placements]

    def cost(self, placements: IntArray, xi: FloatArray, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return the cost (B,) of B sequences: `placements` (B, N) and `xi` (B, N, 3)."""
        middle = self.energy(self.poses(placements, xi), dtype)
        return sequence_cost(self.chain(middle), self.options)

    def chain(self, middle: NDArray[Any]) -> NDArray[Any]:
        """Return energies (B, N+2, G) of whole sequences from those of the intermediate poses (B, N, G)."""
        shape = (len(middle), 1, middle.shape[-1])
        ends = [np.broadcast_to(e.astype(middle.dtype), shape) for e in (self.start_energy, self.goal_energy)]
        return np.concatenate([ends[0], middle, ends[1]], axis=1)


BLOCKED = 30.0
"""Energy of a grasp known to be infeasible: large against any ``-log p`` that matters, finite for the solvers."""


def exact_energy(feasible: Any) -> FloatArray:
    """Return ``-log p`` (G,) where feasibility is known: 0 for feasible grasps, `BLOCKED` for the others."""
    return np.where(np.asarray(feasible, dtype=bool), 0.0, BLOCKED)
