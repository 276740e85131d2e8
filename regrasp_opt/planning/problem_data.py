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
from regrasp_opt.conventions import BoolArray, FloatArray, IntArray, as_pose, planar_transform
from regrasp_opt.errors import ModelError, PoseError, UnknownNameError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.standing import support_of
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel, Placement
from regrasp_opt.objects.symmetry import Symmetry, symmetries
from regrasp_opt.planning.arm_energy import find_arm_energy, load_arm_energy, train_arm_energy
from regrasp_opt.planning.at_rest import (
    TOLERANCE,
    RestingPose,
    as_tolerance,
    nearest_rests,
    rest_within,
)
from regrasp_opt.planning.model_key import ModelKey
from regrasp_opt.planning.model_store import command_arguments, load_prepared_energy
from regrasp_opt.planning.rests import Rests, Station
from regrasp_opt.planning.rules import GraspRules
from regrasp_opt.scene import Fixture, Workcell
from regrasp_opt.solvers import PoseLattice

logger = logging.getLogger(__name__)

REST_TOLERANCE = 1e-4
"""How far a rotation matrix's entries and the height [m] may together be off for a pose to be called a placement."""

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
        """The placements' poses (M, 4, 4) on the first support."""
        return np.array([p.pose for p in self.placements])

    @cached_property
    def rests(self) -> Rests:
        """The ways to stand: placements on supports. Those on the first support have the numbers of `placements`."""
        return Rests.of(self.object, self.workcell)

    @cached_property
    def symmetries(self) -> list[Symmetry]:
        """The object's axes of rotational symmetry, those of the highest order."""
        return symmetries(self.object)

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
        return ProblemEnergy(model, self.grasps, self.rests.planar)

    @cached_property
    def rules(self) -> GraspRules:
        """The exact rules: what table, object and obstacles make impossible."""
        same = None if self.base is None else self.base.rules
        return GraspRules(self.checker, self.object, self.rests, same)

    @property
    def table_rule(self) -> TableRule:
        """Which grasps its support makes infeasible at a placement, whatever the planar parameters."""
        return self.rules.table

    @cached_property
    def free_lattice(self) -> PoseLattice:
        """The lattice of poses with their energies, but for obstacles; grasps that are ruled out are `BLOCKED`."""
        if self.base is not None:
            return self.base.free_lattice
        return PoseLattice.build(self.energy, self.rests.planar, self.rules.free_space)

    @property
    def original(self) -> Any:
        """The problem that plans are of; another one where a search may not use all of it."""
        return self

    @property
    def choices(self) -> IntArray:
        """Numbers of the rests that intermediate poses may have."""
        return np.arange(len(self.rests))

    @property
    def lattice(self) -> PoseLattice:
        """A lattice for one search: `free_lattice`, or a copy that asks the obstacles as well."""
        return self.free_lattice.under(self.rules.behind_obstacles) if self.rules.obstacles else self.free_lattice

    def ruled_out(self, placements: Any, xi: Any, useful: BoolArray | None = None) -> BoolArray:
        """Return which grasps (..., G) are known to be infeasible at numbers (...) of rests and `xi` (..., 3).

        What obstacles rule out is asked about the `useful` grasps (G,) only, by default about all.
        """
        return self.rules(np.asarray(placements), np.asarray(xi, dtype=np.float64), useful)

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
        options = options or CostOptions()
        return SequenceObjective(self.energy, self.rests.planar, start_energy, goal_energy, options, self.ruled_out)

    def pose(
        self, placement: int, x: float = 0.0, y: float = 0.0, yaw: float = 0.0, *, support: str | None = None
    ) -> FloatArray:
        """Return the pose (4, 4) T_world_object of a stable placement moved in the plane of a support (Eq. 6).

        Parameters
        ----------
        placement : int
            Its number in `placements`; in a fixture, that of the pose, which has no x, y and yaw.
        x, y : float
            Where the centre of mass stands [m], in the plane of the support; where that is level and square to the
            world, in the world.
        yaw : float
            Turn about the normal of the support [rad].
        support : str, optional
            Name of the support; the first one by default.

        Raises
        ------
        PoseError
            If there is no placement of that number there.
        UnknownNameError
            If there is no support of that name.
        """
        board = self.workcell.support(support)
        if isinstance(board, Fixture):
            return self.rests.planar.at(self.rests.number(board.name, placement), np.zeros(3))
        known = self.object.placements
        if not 0 <= placement < len(known):
            last = len(known) - 1
            raise PoseError(f"there is no placement {placement}; '{self.object.name}' has placements 0 to {last}")
        T: FloatArray = board.T_world_support @ planar_transform([x, y, yaw]) @ known[placement].pose
        return T

    def station(self, T: FloatArray) -> Station:
        """Return where an object at `T` (4, 4) T_world_object is."""
        found = self.rests.find(T, REST_TOLERANCE)
        if found is not None:
            rest = self.rests[found[0]]
            return Station(rest.support.name, rest.placement, found[1])
        on = support_of(T, self.object, self.workcell)
        return Station(None if on is None else self.workcell.supports[on].name, None, None)

    def nearest_rests(self, T: Any) -> list[RestingPose]:
        """Return the resting pose nearest to `T` (4, 4) in each placement on each support, the nearest first.

        Raises
        ------
        PoseError
            If `T` is not a rigid transform.
        """
        return nearest_rests(as_pose(T), self.object, self.rests)

    def at_rest(self, T: Any, tolerance: tuple[float, float] = TOLERANCE) -> RestingPose:
        """Return the resting pose that the measured pose `T` means: the one that moves the object's points least.

        Parameters
        ----------
        T : (4, 4) array_like or dict
            T_world_object, as `regrasp_opt.conventions.as_pose` takes it.
        tolerance : (float, float)
            How far it may be from rest: distance [m] and angle [rad].

        Returns
        -------
        RestingPose
            With its support, placement, planar parameters, distance, angle, and the runner-up.

        Raises
        ------
        PoseError
            If the nearest resting pose is beyond the tolerance, or another is within it too; the message has both.
        OptionError
            If `tolerance` is not two numbers that are at least 0.
        """
        return rest_within(self.nearest_rests(T), as_tolerance(tolerance), "pose")

    def feasible_grasps(self, T: Any, arm: str | None = None) -> BoolArray:
        """Return which grasps (G,) are feasible at object pose `T` (4, 4) T_world_object, exactly.

        Parameters
        ----------
        T : (4, 4)
        arm : str, optional
            Name of the arm; there is one.

        Raises
        ------
        PoseError
            If `T` is not a rigid transform.
        UnknownNameError
            If there is no arm of that name.
        """
        if arm not in (None, self.workcell.arm.name):
            raise UnknownNameError("arm", str(arm), [self.workcell.arm.name])
        return self.checker.feasible(as_pose(T))
