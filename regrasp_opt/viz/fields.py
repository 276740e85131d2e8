"""The energy of a plan: of its shared grasps, and over the table for a pose that is moved while the others stay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.connectivity.objective import BLOCKED, exact_energy
from regrasp_opt.conventions import FloatArray
from regrasp_opt.planning import RegraspPlan

STEP = 0.02
"""Distance between the points of a field [m]."""


class CostField(NamedTuple):
    """`J_seq` where intermediate pose `number` (1 to N) is moved over the table at one angle.

    Attributes
    ----------
    x : (X,)
    y : (Y,)
        Planar parameters [m].
    cost : (Y, X)
    here : (2,)
        Where the plan has the pose [m].
    T_world_support : (4, 4)
        The plane of x and y.
    """

    number: int
    x: FloatArray
    y: FloatArray
    cost: FloatArray
    here: FloatArray
    T_world_support: FloatArray


def has_energy(plan: RegraspPlan) -> bool:
    """Return whether there is an energy for the plan's problem, without training one."""
    return plan.problem.energy_file is not None


def grasp_energies(plan: RegraspPlan) -> list[FloatArray]:
    """Return the summed energies ``E(T_i, g) + E(T_{i+1}, g)`` (K,) of the shared grasps of each transition."""
    energies = plan.problem.energy(plan.poses)
    return [energies[i : i + 2, t.grasp_ids].sum(axis=0) for i, t in enumerate(plan.transitions)]


def cost_field(plan: RegraspPlan, number: int, turn: float = 0.0) -> CostField:
    """Return the cost of moving intermediate pose `number` (1 to N), with exact feasibility at start and goal (Eq. 5).

    The workspace is covered at steps of `STEP`; the pose keeps its angle, or is turned by `turn` [rad].
    """
    problem, planar = plan.problem, plan.problem.rests.planar[plan.placements[number - 1]]
    low, high = planar.low[:2], planar.high[:2]
    x, y = (np.linspace(a, b, round((b - a) / STEP) + 1) for a, b in zip(low, high, strict=True))
    xi = np.tile(plan.xi, (len(y), len(x), 1, 1))
    xi[..., number - 1, :2] = np.stack(np.meshgrid(x, y), axis=-1)
    xi[..., number - 1, 2] += turn
    start, goal = (exact_energy(problem.feasible_grasps(plan.poses[i])) for i in (0, -1))
    placements = np.tile(plan.placements, (x.size * y.size, 1))
    cost = problem.objective(start, goal).cost(placements, xi.reshape(-1, *plan.xi.shape), np.float32)
    cost = np.minimum(cost.reshape(len(y), len(x)), BLOCKED)
    return CostField(number, x, y, cost, plan.xi[number - 1, :2], planar.surfaces)
