"""The problem: one object in one workcell with its candidate grasps and, where one was prepared, its energy."""

from __future__ import annotations

import logging
import os
import shlex
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from regrasp_opt.connectivity import CostOptions, SequenceObjective, TableRule
from regrasp_opt.connectivity.embedding import ProblemEnergy
from regrasp_opt.conventions import BoolArray, FloatArray, as_pose, planar_transform, translation
from regrasp_opt.errors import GraspError, ModelError, PoseError, UnknownNameError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.tabletop import points_in_table
from regrasp_opt.files import data_home
from regrasp_opt.grasps import GraspSet, rejected_grasps, sample_grasps
from regrasp_opt.objects import ObjectModel, Placement, load_object
from regrasp_opt.planning.model_store import (
    ENERGY_FILES,
    find_model,
    load_prepared_energy,
    load_prepared_grasps,
    model_key,
)
from regrasp_opt.solvers import PoseLattice, RegraspNLP
from regrasp_opt.workcell import Workcell, load_workcell

DEFAULT_GRASPS = 200
"""Candidate grasps of a problem (the paper's number)."""

NAMED = 3
"""Grasps that are named in the warning about those left out."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class RegraspProblem:
    """What a plan is made for. Use `RegraspProblem.load`; everything heavy is made when first used.

    Attributes
    ----------
    object : ObjectModel
    workcell : Workcell
    grasps : GraspSet
        G candidate grasps; their numbers are the grasp ids of plans.
    placements : tuple of Placement
        Stable placements on this workcell's table: ``.pose`` (4, 4) T_world_object at xi = 0, ``.margin``.
    model_folder : Path or None
        Where the prepared model was found.
    preset : {"default", "paper"}
        Which of the prepared energies is used.
    left_out : dict
        Those of the given grasps that cannot be used: their numbers in the given set, and why. The others are in
        `grasps`, in their order and numbered from 0.
    """

    object: ObjectModel
    workcell: Workcell
    grasps: GraspSet
    placements: tuple[Placement, ...]
    model_folder: Path | None = None
    preset: Literal["default", "paper"] = "default"
    left_out: dict[int, str] = field(default_factory=dict)

    @staticmethod
    def load(
        object: str | os.PathLike[str] | ObjectModel = "bottle",
        workcell: str | os.PathLike[str] | Workcell = "nova2-w",
        *,
        end_effector: str | None = None,
        model: str | os.PathLike[str] | None = None,
        grasps: GraspSet | None = None,
        scale: float = 1.0,
        repair: bool = False,
        preset: Literal["default", "paper"] = "default",
    ) -> RegraspProblem:
        """Load a problem by names or paths.

        Parameters
        ----------
        object : str or path
            A built-in name, or an STL, OBJ, PLY, GLB or DAE file.
        workcell : str or path
            A built-in name, or a TOML file.
        end_effector : str, optional
            Replaces the workcell's end-effector.
        model : path, optional
            Folder that ``regrasp-opt prepare --out`` wrote; by default the bundled models and the user's are searched.
        grasps : GraspSet, optional
            Plan with these instead of the prepared ones; an energy knows grasps by their geometry, not their number.
            Each must hold the object and be free of it otherwise (`regrasp_opt.grasps.Failure`). One warning names
            those that are left out, as does `left_out`; grasp ids of plans number the rest. Grasps of a `model` that
            is named are tested as well.
        scale, repair
            As of `load_object`.
        preset : {"default", "paper"}
            Which of the prepared energies to plan with.

        Returns
        -------
        RegraspProblem

        Raises
        ------
        RegraspError
            For an unknown name, a broken mesh, workcell or model, or an object that no grasp fits or holds.
        """
        if preset not in ENERGY_FILES:
            raise UnknownNameError("preset", preset, ENERGY_FILES)
        body = object if isinstance(object, ObjectModel) else load_object(object, scale=scale, repair=repair)
        if not isinstance(workcell, Workcell):
            workcell = load_workcell(workcell, end_effector=end_effector)
        if not body.placements:
            raise GraspError(
                f"'{body.name}' has no stable placement on a table, so it cannot be planned; check its shape and scale"
            )
        folder = find_model(body, workcell, None if model is None else Path(model))
        tested = grasps is not None or model is not None
        if grasps is None and folder is not None:
            grasps = load_prepared_grasps(folder)
        if grasps is None:
            grasps = sample_grasps(body, workcell.end_effector, DEFAULT_GRASPS)
        left_out: dict[int, str] = {}
        if tested:
            grasps, left_out = _usable(grasps, body, workcell)
        return assemble(body, workcell, grasps, folder, preset, left_out)

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
        model = load_prepared_energy(self.model_folder, self.preset, model_key(self.object, self.workcell))
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

    def nlp(
        self,
        start: Any,
        goal: Any,
        *,
        placements: Sequence[int] | None = None,
        num_regrasps: int = 1,
        guess: Any = None,
        mask: Any = None,
        options: CostOptions | None = None,
    ) -> RegraspNLP:
        """Return the search for intermediate poses as a nonlinear program, to extend and to solve.

        Parameters
        ----------
        start, goal : (4, 4) pose T_world_object, (G,) energies, or "input"
            A pose gets its exact energies, as in `solve_sequence`. "input" makes the energies a parameter of the
            program, to be set by `RegraspNLP.set_parameter`.
        placements : sequence of int, optional
            Number of the stable placement of each intermediate pose; by default those of the most promising chain of
            lattice poses with `num_regrasps` of them.
        num_regrasps : int
            N, where `placements` are not given.
        guess : (N, 3), optional
            Planar parameters to start from; by default those of the most promising chain.
        mask : (G,) bool, "input", or None
            Which grasps may be used; see `ProblemEnergy.casadi_functions`.
        options : CostOptions, optional
            The paper's by default.

        Raises
        ------
        PoseError
            If `start` or `goal` cannot be a pose of the object in this workcell, or has no feasible grasp.
        OptionError
            If a placement does not exist, or shapes do not fit.
        ModelError
            If no energy was prepared for the problem.
        """
        from regrasp_opt.planning.sequence_nlp import sequence_nlp

        return sequence_nlp(self, start, goal, placements, num_regrasps, guess, mask, options or CostOptions())

    def feasible_grasps(self, T: Any) -> BoolArray:
        """Return which grasps (G,) are feasible at object pose `T` (4, 4) T_world_object, exactly.

        Raises
        ------
        PoseError
            If `T` is no rigid transform.
        """
        return self.checker.feasible(as_pose(T))


def assemble(
    body: ObjectModel,
    workcell: Workcell,
    grasps: GraspSet,
    folder: Path | None,
    preset: Literal["default", "paper"] = "default",
    left_out: dict[int, str] | None = None,
) -> RegraspProblem:
    """Return the problem of these parts; nothing is tested, and no grasp is left out."""
    lift = translation(0.0, 0.0, workcell.table.height)
    placements = tuple(Placement(lift @ p.pose, p.margin) for p in body.placements)
    return RegraspProblem(body, workcell, grasps, placements, folder, preset, left_out or {})


def _usable(grasps: GraspSet, body: ObjectModel, workcell: Workcell) -> tuple[GraspSet, dict[int, str]]:
    """Return those of `grasps`, which somebody gave, that hold the object, and why the others are left out."""
    effector = workcell.end_effector
    if not isinstance(grasps, GraspSet):
        raise GraspError(f"grasps is a {type(grasps).__name__}; give a GraspSet of poses, widths and kind")
    if len(grasps) == 0:
        raise GraspError("the grasp set is empty; sample or load at least one grasp")
    if grasps.kind != effector.kind:
        raise GraspError(f"the grasps are for a {grasps.kind} end-effector, which '{effector.name}' is not")
    left_out = {index: failure.value for index, failure in rejected_grasps(grasps, body, effector).items()}
    if not left_out:
        return grasps, {}
    if len(left_out) == len(grasps):
        counts = ", ".join(f"{count} because {why}" for why, count in Counter(left_out.values()).most_common())
        raise GraspError(
            f"none of the {len(grasps)} grasps can be used on '{body.name}' with '{effector.name}': {counts}; sample "
            "grasps for both together, or check units and frames (T_object_tcp: z approach, y closing direction)"
        )
    named = [f"grasp {index} because {why}" for index, why in list(left_out.items())[:NAMED]]
    rest = f", and {len(left_out) - NAMED} more" if len(left_out) > NAMED else ""
    text = "%d of %d grasps are left out, and the others numbered anew from 0: %s%s (problem.left_out has all)"
    logger.warning(text, len(left_out), len(grasps), "; ".join(named), rest)
    return grasps.subset([index for index in range(len(grasps)) if index not in left_out]), left_out


def command_arguments(body: ObjectModel, workcell: Workcell) -> str:
    """Return how `prepare` is told of an object and a workcell on the command line."""
    parts = [body.name if body.source == "built-in" else body.source]
    parts += ["--workcell", workcell.name if workcell.source == "built-in" else workcell.source]
    if workcell.end_effector_override is not None:
        parts += ["--end-effector", workcell.end_effector_override]
    if body.scale != 1.0:
        parts += ["--scale", f"{body.scale:g}"]
    if body.repair:
        parts.append("--repair")
    return shlex.join(parts)
