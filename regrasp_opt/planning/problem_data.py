"""What a problem is made of, and what is computed from it when it is first used."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from regrasp_opt.connectivity import CostOptions, SequenceObjective, TableRule
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.conventions import BoolArray, FloatArray, as_pose, planar_transform
from regrasp_opt.errors import ModelError, PoseError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.tabletop import points_in_table
from regrasp_opt.files import data_home
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel, Placement
from regrasp_opt.planning.model_key import ModelKey
from regrasp_opt.planning.model_store import command_arguments, load_prepared_energy
from regrasp_opt.scene import Workcell
from regrasp_opt.solvers import PoseLattice


@dataclass(frozen=True, eq=False)
class ProblemData:
    """The fields of a `RegraspProblem`, and what follows from them."""

    object: ObjectModel
    workcell: Workcell
    grasps: GraspSet
    placements: tuple[Placement, ...]
    model_folder: Path | None = None
    preset: Literal["default", "paper"] = "default"
    left_out: dict[int, str] = field(default_factory=dict)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the fields alone: what was computed from them is large, and some of it cannot travel."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    @cached_property
    def checker(self) -> FeasibilityChecker:
        """The exact checker of this problem's grasps."""
        return FeasibilityChecker(self.object, self.workcell, self.grasps)

    @cached_property
    def placement_poses(self) -> FloatArray:
        """The placements' poses (S, 4, 4)."""
        return np.array([p.pose for p in self.placements])

    @cached_property
    def energy(self) -> ProblemEnergy:
        """The prepared energy on this problem's grasps.

        Raises
        ------
        ModelError
            If none was prepared for this object and workcell.
        """
        if self.model_folder is None:
            raise ModelError(
                f"no model was prepared for '{self.object.name}' in workcell '{self.workcell.name}'; run "
                f"'regrasp-opt prepare {command_arguments(self.object, self.workcell)}'"
            )
        model = load_prepared_energy(self.model_folder, self.preset, ModelKey.of(self.object, self.workcell).id)
        return ProblemEnergy(model, self.grasps, self.placement_poses)

    @cached_property
    def lattice(self) -> PoseLattice:
        """The lattice of poses with their energies; kept on disk under a hash, and in memory."""
        cache = data_home() / "lattices"
        bounds = self.workcell.bounds.array
        return PoseLattice.build(self.energy, self.placement_poses, bounds, cache, self.table_rule)

    @cached_property
    def table_rule(self) -> TableRule:
        """Which grasps the table makes infeasible at a placement, whatever the planar parameters."""
        table = self.workcell.table
        corners = table.center + np.array([[-0.5], [0.5]]) * table.size
        return TableRule(points_in_table(self.workcell, self.grasps, self.placement_poses), corners)

    def objective(
        self, start_energy: FloatArray, goal_energy: FloatArray, options: CostOptions | None = None
    ) -> SequenceObjective:
        """Return ``J_seq`` between two ends, with what the table rules out.

        Parameters
        ----------
        start_energy, goal_energy : (G,)
            Known energies of all grasps at both ends.
        options : CostOptions, optional
            The paper's by default.
        """
        bounds, options = self.workcell.bounds.array, options or CostOptions()
        return SequenceObjective(
            self.energy, self.placement_poses, start_energy, goal_energy, bounds, options, self.table_rule
        )

    def pose(self, placement: int, x: float, y: float, yaw: float = 0.0) -> FloatArray:
        """Return the pose (4, 4) T_world_object of a stable placement moved in the plane (Eq. 6).

        Parameters
        ----------
        placement : int
            Its number in `placements`.
        x, y : float
            Where the centre of mass stands [m].
        yaw : float
            Turn about the vertical [rad].

        Raises
        ------
        PoseError
            If there is no placement of that number.
        """
        if not 0 <= placement < len(self.placements):
            last = len(self.placements) - 1
            raise PoseError(f"there is no placement {placement}; '{self.object.name}' has placements 0 to {last}")
        return planar_transform(np.array([x, y, yaw])) @ self.placement_poses[placement]

    def feasible_grasps(self, T: Any) -> BoolArray:
        """Return which grasps (G,) are feasible at object pose `T` (4, 4) T_world_object, exactly.

        Raises
        ------
        PoseError
            If `T` is not a rigid transform.
        """
        return self.checker.feasible(as_pose(T))
