"""The energy of one planning problem, ready to be put into somebody's own CasADi problem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from regrasp_opt.connectivity.casadi_costs import ConnectivityFunctions, connectivity_functions
from regrasp_opt.connectivity.costs import CostOptions
from regrasp_opt.conventions import FloatArray, as_pose
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.grasps import GraspSet


class ProblemEnergy(GraspEnergy):
    """A `GraspEnergy` that knows the problem's stable placements.

    Parameters
    ----------
    model : EnergyModel
    grasps : GraspSet
        G grasps.
    placements : (S, 4, 4)
        Stable placements, T_world_object at xi = 0.
    """

    def __init__(self, model: EnergyModel, grasps: GraspSet, placements: FloatArray) -> None:
        super().__init__(model, grasps)
        self.placements = placements

    def casadi_functions(
        self,
        *,
        start: Any,
        goal: Any,
        placements: Sequence[int],
        options: CostOptions | None = None,
    ) -> ConnectivityFunctions:
        """Return ``E``, ``Q_pair`` and ``J_seq`` of the chain start, intermediate poses, goal as `casadi.Function`.

        Parameters
        ----------
        start, goal : (4, 4) pose T_world_object, or (G,) energies
            The fixed ends. A pose gets the learned energies; pass energies to use exact knowledge.
        placements : sequence of int
            Number of the stable placement of each of the N intermediate poses.
        options : CostOptions, optional
            The paper's by default.

        Returns
        -------
        ConnectivityFunctions
            Functions of ``xi`` (3, N), the planar parameters [m, m, rad]: ``E`` (G, N), ``Q_pair`` (N+1, 1) of
            neighbouring poses (Eq. 4), ``J_seq`` (1, 1) (Eq. 5).

        Raises
        ------
        PoseError, OptionError
            If an end is neither a rigid pose nor G energies, or a placement does not exist.
        """
        numbers = np.asarray(placements).reshape(-1)
        if numbers.size == 0:
            numbers = numbers.astype(np.int64)
        if numbers.dtype.kind not in "iu" or ((numbers < 0) | (numbers >= len(self.placements))).any():
            raise OptionError(f"placements are {numbers.tolist()}; give numbers from 0 to {len(self.placements) - 1}")
        ends = self._end_energies(start, "start"), self._end_energies(goal, "goal")
        return connectivity_functions(self, options or CostOptions(), *ends, self.placements[numbers])

    def _end_energies(self, end: Any, name: str) -> FloatArray:
        try:
            array = np.asarray(end, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise OptionError(f"the {name} is neither a 4x4 pose nor {len(self)} energies") from error
        if array.shape == (len(self),):
            if not np.isfinite(array).all():
                raise OptionError(f"the {name} energies hold NaN or infinity; give finite numbers")
            return array
        return self(as_pose(end, f"{name} pose"))
