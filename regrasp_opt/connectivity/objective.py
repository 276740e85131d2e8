"""What a refiner minimises: `J_seq` over the intermediate poses of one problem, with everything that stays fixed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from regrasp_opt.connectivity.costs import CostOptions, sequence_cost
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray
from regrasp_opt.energy.model import GraspEnergy
from regrasp_opt.geometry.planar_poses import PlanarPoses

Rule = Callable[[IntArray, FloatArray, BoolArray], BoolArray]
"""Returns which grasps (..., G) are known to be infeasible at `placements` (...) and `xi` (..., 3).

An expensive rule may leave out grasps that are not `useful` (G,).
"""


_AT_ONCE = 100
"""Poses for which a rule is asked together: what is computed of so few stays in the processor's cache."""


@dataclass(frozen=True, eq=False)
class TableRule:
    """Grasps that put part of the gripper or of the wrist into the table, wherever the object lies on a placement.

    `point` (S, G, 2) is a point of such a part at xi = 0, seen from above [m], NaN where there is none; `table` (2, 2)
    or (S, 2, 2) is ``[[x_low, y_low], [x_high, y_high]]`` of the top of what each placement is on, in its plane [m].
    """

    point: FloatArray
    table: FloatArray

    def __call__(self, placements: IntArray, xi: FloatArray, useful: BoolArray | None = None) -> BoolArray:
        """Return which grasps (..., G) are ruled out at `placements` (...) and planar parameters `xi` (..., 3).

        These are the ones whose point in the table is within the table's edges there, `useful` or not.
        """
        numbers, flat = placements.reshape(-1), xi.reshape(-1, 3)
        portions = [slice(first, first + _AT_ONCE) for first in range(0, len(numbers), _AT_ONCE)]
        found = [np.zeros((0, self.point.shape[1]), dtype=bool)]
        found += [self._ruled_out(numbers[portion], flat[portion]) for portion in portions]
        return np.concatenate(found).reshape(*placements.shape, self.point.shape[1])

    def _ruled_out(self, placements: IntArray, xi: FloatArray) -> BoolArray:
        x, y, c, s = (part[..., None] for part in (xi[..., 0], xi[..., 1], np.cos(xi[..., 2]), np.sin(xi[..., 2])))
        point = self.point[placements]
        moved = x + c * point[..., 0] - s * point[..., 1], y + s * point[..., 0] + c * point[..., 1]
        ruled_out = np.ones(point.shape[:-1], dtype=bool)
        edges = self.table if self.table.ndim == 2 else self.table[placements]
        for axis, at in enumerate(moved):
            ruled_out &= (at > edges[..., 0, axis, None]) & (at < edges[..., 1, axis, None])
        return ruled_out


@dataclass(frozen=True)
class SequenceObjective:
    """``J_seq`` of Eq. 5, and the weights of placements, as a function of placements and planar parameters.

    Attributes
    ----------
    energy : GraspEnergy
        Of G grasps.
    placements : PlanarPoses
        S stable placements on the supports, and the limits of `xi` there.
    start_energy, goal_energy : (G,)
        Energies at the fixed ends. Planning passes exact ones there: 0 for a feasible grasp, `BLOCKED` otherwise.
    options : CostOptions
    rule : callable, optional
        A `Rule`; grasps that it rules out count as `BLOCKED`.
    choices : (C,) int, optional
        Numbers of the placements that intermediate poses may have; by default all.
    """

    energy: GraspEnergy
    placements: PlanarPoses
    start_energy: FloatArray
    goal_energy: FloatArray
    options: CostOptions
    rule: Rule | None = None
    choices: IntArray | None = None

    def poses(self, placements: IntArray, xi: FloatArray) -> FloatArray:
        """Return object poses (..., 4, 4) of numbers `placements` (...) and planar parameters `xi` (..., 3) (Eq. 6)."""
        return self.placements.at(placements, xi)

    @property
    def bounds(self) -> FloatArray:
        """``[[x_low, y_low], [x_high, y_high]]`` (2, 2) of intermediate poses [m], on all supports together."""
        return self.placements.rectangle

    def cost(self, placements: IntArray, xi: FloatArray, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return the cost (B,) of B sequences, `placements` (B, N) and `xi` (B, N, 3), in the precision `dtype`."""
        return self.sequence_cost(placements, self.energies(placements, xi, dtype))

    def sequence_cost(self, placements: IntArray, middle: NDArray[Any]) -> NDArray[Any]:
        """Return the cost (B,) of sequences at `placements` (B, N) with energies `middle` (B, N, G)."""
        cost: NDArray[Any] = sequence_cost(self.chain(middle), self.options)
        return cost + self.placements.weights[placements].sum(axis=1).astype(cost.dtype)

    def energies(self, placements: IntArray, xi: FloatArray, dtype: DTypeLike = np.float64) -> NDArray[Any]:
        """Return energies (..., N, G), of type `dtype`, of N poses: `placements` (..., N) and `xi` (..., N, 3)."""
        return block(self.energy(self.poses(placements, xi), dtype), self.ruled_out(placements, xi))

    def ruled_out(self, placements: IntArray, xi: FloatArray) -> BoolArray:
        """Return which grasps (..., N, G) are ruled out at intermediate poses: `placements` (..., N), `xi` (..., N, 3).

        Grasps that cannot matter (`useful_grasps`) may be missing.
        """
        if self.rule is None:
            return np.zeros((*np.shape(placements), len(self.energy)), dtype=bool)
        useful = np.zeros(len(self.energy), dtype=bool)
        useful[self.useful_grasps(np.shape(placements)[-1])] = True
        return self.rule(placements, xi, useful)

    def useful_grasps(self, num_regrasps: int) -> IntArray:
        """Return the grasps (A,) that matter for sequences of `num_regrasps` intermediate poses.

        With one, every pair has a fixed end, and a grasp that is blocked at both ends adds at most
        ``exp(-BLOCKED / alpha)`` to a sum of Eq. 4; such grasps are left out. With more, every grasp may matter.
        """
        if num_regrasps > 1:
            return np.arange(len(self.start_energy))
        return np.flatnonzero((self.start_energy < BLOCKED) | (self.goal_energy < BLOCKED))

    def chain(self, middle: NDArray[Any]) -> NDArray[Any]:
        """Return energies (B, N+2, G) of whole sequences from `middle` (B, N, G), those of the intermediate poses."""
        shape = (len(middle), 1, middle.shape[-1])
        ends = [np.broadcast_to(e.astype(middle.dtype), shape) for e in (self.start_energy, self.goal_energy)]
        return np.concatenate([ends[0], middle, ends[1]], axis=1)


BLOCKED = 30.0
"""Energy of a grasp known to be infeasible: large against any ``-log p`` that matters, finite for the solvers."""


def block(energies: NDArray[Any], ruled_out: BoolArray) -> NDArray[Any]:
    """Return `energies` (..., G) with `BLOCKED` where grasps are `ruled_out` (..., G)."""
    return np.where(ruled_out, energies.dtype.type(BLOCKED), energies)


def exact_energy(feasible: Any) -> FloatArray:
    """Return ``-log p`` (G,) where feasibility is known: 0 for feasible grasps, `BLOCKED` for the others."""
    return np.where(np.asarray(feasible, dtype=bool), 0.0, BLOCKED)
