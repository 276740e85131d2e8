"""The energy of one planning problem, ready to be put into a user's own CasADi problem."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from regrasp_opt.connectivity.casadi_costs import (
    INPUT,
    ChainEnds,
    ConnectivityFunctions,
    planar_functions,
    pose_functions,
)
from regrasp_opt.connectivity.costs import CostOptions
from regrasp_opt.conventions import IntArray, as_pose
from regrasp_opt.energy.casadi_energy import Blas
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.errors import OptionError
from regrasp_opt.geometry.planar_poses import PlanarPoses
from regrasp_opt.grasps import GraspSet


class ProblemEnergy(GraspEnergy):
    """A `GraspEnergy` that knows the problem's stable placements.

    Parameters
    ----------
    model : EnergyModel
    grasps : GraspSet
        G grasps.
    placements : PlanarPoses
        S stable placements on the supports.
    """

    def __init__(self, model: EnergyModel, grasps: GraspSet, placements: PlanarPoses) -> None:
        super().__init__(model, grasps)
        self.placements = placements

    def casadi_functions(
        self,
        *,
        placements: Sequence[int],
        start: Any = None,
        goal: Any = None,
        mask: Any = None,
        blocked: Any = None,
        options: CostOptions | None = None,
        blas: Blas = "classic",
    ) -> ConnectivityFunctions:
        """Return ``E``, ``Q_pair`` and ``J_seq`` of the chain start, intermediate poses, goal as `casadi.Function`.

        They bring their own first and second derivatives into every expression that they are put in.

        Parameters
        ----------
        placements : sequence of int
            Number of the stable placement of each of the N intermediate poses.
        start, goal : (4, 4) pose T_world_object, (G,) energies, "input", or None
            The fixed ends. A pose gets the learned energies; pass energies to use exact knowledge. "input" makes the
            energies (G, 1) an input ``start`` or ``goal``. None: the chain begins, or ends, with an intermediate pose.
        mask : (G,) bool, "input", or None
            Which grasps may be used. "input" makes it an input ``mask`` (G, 1) of ones and zeros, the last one of
            ``Q_pair`` and ``J_seq``, which are not differentiable in it; a zero adds `BLOCKED` to every pair's energy.
        blocked : (N, G) bool, optional
            Grasps known to be infeasible at each intermediate pose, as `RegraspProblem.ruled_out` says; they have
            the energy `BLOCKED` there.
        options : CostOptions, optional
            The paper's by default.
        blas : {"classic", "reference"}
            Multiply matrices through BLAS, or in loops whose generated C needs no library.

        Returns
        -------
        ConnectivityFunctions
            Functions of ``xi`` (N, 3), the planar parameters [m, m, rad]: ``E`` (N, G), ``Q_pair`` of neighbouring
            poses (Eq. 4), (N+1, 1) with both ends, and ``J_seq`` (1, 1) (Eq. 5).

        Raises
        ------
        PoseError, OptionError
            If an end is neither a rigid pose nor G energies, a placement does not exist, or the mask leaves no grasp.
        """
        chosen = self.placements[self.placement_numbers(placements)]
        ends = self._ends(start, goal, mask, blocked, len(chosen))
        return planar_functions(self, options or CostOptions(), ends, chosen, _checked(blas))

    def casadi_pose_functions(
        self,
        *,
        num_poses: int,
        start: Any = None,
        goal: Any = None,
        mask: Any = None,
        blocked: Any = None,
        options: CostOptions | None = None,
        blas: Blas = "classic",
    ) -> ConnectivityFunctions:
        """Return what `casadi_functions` does, for poses that come out of a user's kinematics.

        Parameters
        ----------
        num_poses : int
            M, the number of poses that move.
        start, goal, mask, blocked, options, blas
            Same as in `casadi_functions`.

        Returns
        -------
        ConnectivityFunctions
            Functions of ``T`` (4 M, 4), poses T_world_object one below the other: ``E`` (M, G), ``Q_pair``, ``J_seq``.
            All 12 numbers of the upper rows of a pose are free as far as derivatives go; keeping them rigid is up
            to the caller.

        Raises
        ------
        OptionError
            If `num_poses` is below 1, or for the same reasons as `casadi_functions`.
        """
        if isinstance(num_poses, bool) or not isinstance(num_poses, (int, np.integer)) or num_poses < 1:
            raise OptionError(f"num_poses is {num_poses}; give a whole number of at least 1")
        ends = self._ends(start, goal, mask, blocked, int(num_poses))
        return pose_functions(self, options or CostOptions(), ends, int(num_poses), _checked(blas))

    def placement_numbers(self, placements: Any) -> IntArray:
        """Return `placements` as an array (N,) of numbers of stable placements.

        An `OptionError` says if one of them does not exist.
        """
        numbers = np.asarray(placements).reshape(-1)
        if numbers.size == 0:
            numbers = numbers.astype(np.int64)
        if numbers.dtype.kind not in "iu" or ((numbers < 0) | (numbers >= len(self.placements))).any():
            raise OptionError(f"placements are {numbers.tolist()}; give numbers from 0 to {len(self.placements) - 1}")
        return numbers.astype(np.int64)

    def _ends(self, start: Any, goal: Any, mask: Any, blocked: Any, poses: int) -> ChainEnds:
        ends = self._end_energies(start, "start"), self._end_energies(goal, "goal")
        known = None if blocked is None else np.asarray(blocked)
        if known is not None and (known.shape != (poses, len(self)) or known.dtype != bool):
            raise OptionError(f"blocked must be a boolean array ({poses}, {len(self)}), poses by grasps")
        if mask is None or (isinstance(mask, str) and mask == INPUT):
            return ChainEnds(*ends, mask, None, known)
        chosen = np.asarray(mask)
        if chosen.shape != (len(self),) or chosen.dtype != bool:
            raise OptionError(f'the mask is neither {len(self)} booleans nor "input"')
        if not chosen.any():
            raise OptionError("the mask leaves no grasp; allow at least one")
        return ChainEnds(*ends, None, np.flatnonzero(chosen), known)

    def _end_energies(self, end: Any, name: str) -> Any:
        if end is None or (isinstance(end, str) and end == INPUT):
            return end
        try:
            array = np.asarray(end, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise OptionError(f'the {name} is neither a 4x4 pose, {len(self)} energies, "input" nor None') from error
        if array.shape == (len(self),):
            if not np.isfinite(array).all():
                raise OptionError(f"the {name} energies hold NaN or infinity; give finite numbers")
            return array
        return self(as_pose(end, f"{name} pose"))


def _checked(blas: Blas) -> Blas:
    if blas not in get_args(Blas):
        raise OptionError(f"blas is '{blas}'; use one of {', '.join(get_args(Blas))}")
    return blas
