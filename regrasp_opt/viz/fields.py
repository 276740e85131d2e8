"""The energy of a plan: of its shared grasps, and over the table for a pose that is moved while the others stay."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from regrasp_opt.connectivity.costs import CostOptions, sequence_cost
from regrasp_opt.connectivity.objective import BLOCKED, block, exact_energy
from regrasp_opt.conventions import FloatArray, planar_transform
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
    """

    number: int
    x: FloatArray
    y: FloatArray
    cost: FloatArray
    here: FloatArray


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
    problem = plan.problem
    low, high = problem.workcell.bounds.array
    x, y = (np.linspace(a, b, round((b - a) / STEP) + 1) for a, b in zip(low, high, strict=True))
    placement, theta = int(plan.placements[number - 1]), float(plan.xi[number - 1, 2]) + turn
    xi = np.stack([*np.meshgrid(x, y), np.full((len(y), len(x)), theta)], axis=-1).reshape(-1, 3)
    learned = problem.energy(planar_transform(xi) @ problem.placement_poses[placement], np.float32)
    moved = block(learned, problem.ruled_out(np.full(len(xi), placement), xi))
    ends = {i: exact_energy(problem.feasible_grasps(plan.poses[i])) for i in (0, plan.num_regrasps + 1)}
    others = problem.energy(plan.poses, np.float32)
    known = {i: np.broadcast_to(ends.get(i, others[i]), moved.shape) for i in range(len(plan.poses))}
    chain = np.stack([moved if i == number else energies for i, energies in known.items()], axis=1)
    cost = sequence_cost(chain, CostOptions()).reshape(len(y), len(x))
    return CostField(number, x, y, np.minimum(cost, BLOCKED), plan.xi[number - 1, :2])
