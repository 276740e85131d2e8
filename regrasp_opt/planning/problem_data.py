"""What a problem is made of, and what is computed from it when it is first used."""

from __future__ import annotations

import logging
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
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel, Placement
from regrasp_opt.planning.arm_energy import find_arm_energy, load_arm_energy, train_arm_energy
from regrasp_opt.planning.model_key import ModelKey
from regrasp_opt.planning.model_store import command_arguments, load_prepared_energy
from regrasp_opt.planning.rules import GraspRules
from regrasp_opt.scene import Workcell
from regrasp_opt.solvers import PoseLattice

logger = logging.getLogger(__name__)

TRAINING_SAID = "training an energy for '%s' with '%s', once: a minute, or a few where inverse kinematics is slow"


@dataclass(frozen=True, eq=False)
class ProblemData:
    """The fields of a `RegraspProblem`, and what follows from them.

    `base` is the problem without the obstacles that were put in afterwards; all that these do not touch is its own.
    """

    object: ObjectModel
    workcell: Workcell
    grasps: GraspSet
    placements: tuple[Placement, ...]
    model_folder: Path | None = None
    preset: Literal["default", "paper"] = "default"
    left_out: dict[int, str] = field(default_factory=dict)
    arm_energy: Path | None = None
    base: ProblemData | None = None

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

    @property
    def energy_file(self) -> Path | None:
        """The file or folder of the energy to plan with; None where one has to be trained first."""
        return self.model_folder or self.arm_energy or find_arm_energy(self.workcell)

    @cached_property
    def energy(self) -> ProblemEnergy:
        """The energy on this problem's grasps: the object's own where one was prepared, else the arm's.

        The arm's is trained where there is none yet, once, and kept.

        Raises
        ------
        ModelError
            If a file is broken or belongs to something else, no energy can be trained for the arm, or the paper's
            preset, which belongs to an object, was not prepared.
        """
        if self.base is not None:
            return self.base.energy
        if self.model_folder is not None:
            model = load_prepared_energy(self.model_folder, self.preset, ModelKey.of(self.object, self.workcell).id)
        elif self.preset == "paper":
            raise ModelError(
                f"no model was prepared for '{self.object.name}' in workcell '{self.workcell.name}'; run "
                f"'regrasp-opt prepare {command_arguments(self.object, self.workcell)}'"
            )
        else:
            file = self.energy_file
            if file is None:
                arm = self.workcell.arm
                logger.warning(TRAINING_SAID, arm.robot.name, arm.end_effector.name)
                file, _ = train_arm_energy(self.workcell)
            model = load_arm_energy(file, self.workcell)
        return ProblemEnergy(model, self.grasps, self.placement_poses)

    @cached_property
    def rules(self) -> GraspRules:
        """The exact rules: what table, object and obstacles make impossible."""
        same = None if self.base is None else self.base.rules
        return GraspRules(self.checker, self.object, self.placement_poses, same)

    @property
    def table_rule(self) -> TableRule:
        """Which grasps the table makes infeasible at a placement, whatever the planar parameters."""
        return self.rules.table

    @cached_property
    def free_lattice(self) -> PoseLattice:
        """The lattice of poses with their energies, but for obstacles; grasps that are ruled out are `BLOCKED`."""
        if self.base is not None:
            return self.base.free_lattice
        bounds, rules = self.workcell.bounds.array, self.rules
        return PoseLattice.build(self.energy, self.placement_poses, bounds, rules.free_space)

    @property
    def lattice(self) -> PoseLattice:
        """A lattice for one search: `free_lattice`, or a copy that asks the obstacles as well."""
        return self.free_lattice.under(self.rules.behind_obstacles) if self.rules.obstacles else self.free_lattice

    def ruled_out(self, placements: Any, xi: Any) -> BoolArray:
        """Return which grasps (..., G) are known to be infeasible at placement numbers (...) and `xi` (..., 3)."""
        return self.rules(np.asarray(placements), np.asarray(xi, dtype=np.float64))

    def objective(
        self, start_energy: FloatArray, goal_energy: FloatArray, options: CostOptions | None = None
    ) -> SequenceObjective:
        """Return ``J_seq`` between two ends, with what the exact rules say.

        Parameters
        ----------
        start_energy, goal_energy : (G,)
            Known energies of all grasps at both ends.
        options : CostOptions, optional
            The paper's by default.
        """
        bounds, options = self.workcell.bounds.array, options or CostOptions()
        return SequenceObjective(
            self.energy, self.placement_poses, start_energy, goal_energy, bounds, options, self.ruled_out
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
