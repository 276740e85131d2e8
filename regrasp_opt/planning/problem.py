"""The problem: one object in one workcell with its candidate grasps, and the energy that ranks them."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from numpy.typing import ArrayLike

from regrasp_opt.connectivity import CostOptions
from regrasp_opt.conventions import as_pose
from regrasp_opt.errors import GraspError, OptionError, UnknownNameError, WorkcellError
from regrasp_opt.geometry.shapes import Shape
from regrasp_opt.grasps import GraspSet, sample_grasps
from regrasp_opt.objects import ObjectModel, Placement, load_object
from regrasp_opt.planning.arm_energy import LEAST_JOINTS, load_arm_energy, short_arm
from regrasp_opt.planning.explaining import explain
from regrasp_opt.planning.explanation import Explanation
from regrasp_opt.planning.given_grasps import NEAR, Near, usable_grasps
from regrasp_opt.planning.model_store import ENERGY_FILES, find_model, load_prepared_grasps
from regrasp_opt.planning.problem_data import ProblemData
from regrasp_opt.planning.rests import check_rests
from regrasp_opt.planning.sequence_nlp import sequence_nlp
from regrasp_opt.scene import Workcell, as_obstacles, load_workcell
from regrasp_opt.scene.collision_world import collision_at_home
from regrasp_opt.solvers import RegraspNLP

DEFAULT_GRASPS = 200
"""Candidate grasps of a problem (the paper's number)."""


@dataclass(frozen=True, eq=False)
class RegraspProblem(ProblemData):
    """What a plan is made for. Use `RegraspProblem.load`; everything heavy is made when first used.

    Attributes
    ----------
    object : ObjectModel
    workcell : Workcell
    grasps : GraspSet
        G candidate grasps; their numbers are the grasp ids of plans.
    placements : tuple of Placement
        Stable placements on the first support: ``.pose`` (4, 4) T_world_object at xi = 0, ``.margin``.
    model_folder : Path or None
        Where the object's own model was found, if one was prepared; else the energy is the arm's.
    preset : {"default", "paper"}
        Which of the energies in the object's own model is used.
    arm_energy : Path or None
        File of the arm's energy, where one was named.
    base : RegraspProblem or None
        The problem without the obstacles that were put in afterwards.
    left_out : dict
        Those of the given grasps that cannot be used: their numbers in the given set, and why. The others are in
        `grasps`, in their order and numbered from 0.
    """

    @staticmethod
    def load(
        object: str | os.PathLike[str] | ObjectModel = "bottle",
        workcell: str | os.PathLike[str] | Workcell = "nova2-w",
        *,
        end_effector: str | None = None,
        model: str | os.PathLike[str] | None = None,
        grasps: GraspSet | str | os.PathLike[str] | None = None,
        near: Near = NEAR,
        scale: float = 1.0,
        repair: bool = False,
        thickness: float | None = None,
        mass: float | None = None,
        density: float | None = None,
        center_of_mass: ArrayLike | None = None,
        inertia: ArrayLike | None = None,
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
            What ``regrasp-opt prepare --out`` wrote: the file of an arm's energy, or the folder of an object's model.
            By default the object's model is searched, then the arm's energy, among the bundled ones and the user's.
        grasps : GraspSet or path, optional
            Plan with these instead of the prepared ones; an energy knows grasps by their geometry, not their number.
            A path is read by `GraspSet.load`. Each must hold the object and be free of it otherwise
            (`regrasp_opt.grasps.Failure`). One warning counts and names those that are left out, as does `left_out`;
            grasp ids of plans number the rest. Grasps of a `model` that is named are tested as well.
        near : Near
            How far grasps without widths may be moved and turned to hold the object, which finds their widths.
        scale, repair, thickness, mass, density, center_of_mass, inertia
            Same as in `load_object`; not for an object that is loaded already.
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
        how: dict[str, Any] = {"scale": scale, "repair": repair, "thickness": thickness, "mass": mass}
        how |= {"density": density, "center_of_mass": center_of_mass, "inertia": inertia}
        body = _loaded(object, how)
        if not isinstance(workcell, Workcell):
            workcell = load_workcell(workcell, end_effector=end_effector)
        if grasps is None and workcell.robot.dof < LEAST_JOINTS:
            raise GraspError(short_arm(workcell))
        check_rests(body, workcell)
        file = Path(model) if model is not None and os.path.isfile(model) else None
        if file is not None:
            load_arm_energy(file, workcell)
        folder = find_model(body, workcell, None if model is None else Path(model)) if file is None else None
        if isinstance(grasps, (str, os.PathLike)):
            grasps = GraspSet.load(grasps)
        tested = grasps is not None or (folder is not None and model is not None)
        if grasps is None and folder is not None:
            grasps = load_prepared_grasps(folder)
        if grasps is None:
            grasps = sample_grasps(body, workcell.end_effector, DEFAULT_GRASPS, clearance=workcell.clearance.gripper)
        left_out: dict[int, str] = {}
        if tested:
            grasps, left_out = usable_grasps(grasps, body, workcell.arm.end_effector, near)
        return assemble(body, workcell, grasps, folder, preset, left_out, file)

    def with_obstacles(self, obstacles: Iterable[Shape | Mapping[str, Any]]) -> RegraspProblem:
        """Return this problem with more obstacles in the workcell: nothing is sampled, trained or refused for them.

        Grasps, placements and the energy stay those of this problem; plans, checks and motions know the obstacles, and
        plan files keep them.

        Parameters
        ----------
        obstacles : iterable of Shape or dict
            Shapes of `regrasp_opt.geometry.shapes` in the world frame [m], or dicts with the keys of ``[[obstacles]]``
            in a workcell file; files of meshes are relative to the current folder.

        Returns
        -------
        RegraspProblem

        Raises
        ------
        WorkcellError
            If a dict has a wrong key or value, a name is taken, or the arm collides with an obstacle at its home.
        """
        shapes = as_obstacles(obstacles)
        workcell = self.workcell.with_obstacles(shapes)
        hit = collision_at_home(workcell, {shape.name for shape in shapes})
        if hit is not None:
            raise WorkcellError(
                f"'{hit[0]}' collides with '{hit[1]}', or is nearer than its clearance, while the robot is at home; "
                "move the obstacle"
            )
        return replace(self, workcell=workcell, base=self.base or self)

    def explain(self, T: Any, *, remedies: bool = True, time_limit: float = 30.0) -> Explanation:
        """Return why grasps fail at one pose, also at one where the object cannot rest, and what would help.

        Parameters
        ----------
        T : (4, 4)
            T_world_object.
        remedies, time_limit
            Same as in `RegraspPlan.explain`.

        Raises
        ------
        PoseError
            If `T` is not a rigid transform.
        """
        return explain(self, [as_pose(T)], "", remedies=remedies, time_limit=time_limit)

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
            Number of the rest (`rests`) of each intermediate pose, on the first support that of the placement; by
            default those of the most promising chain of lattice poses with `num_regrasps` of them.
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
            If a file of the energy is broken, or none can be trained.
        """
        return sequence_nlp(self, start, goal, placements, num_regrasps, guess, mask, options or CostOptions())


def _loaded(what: str | os.PathLike[str] | ObjectModel, how: dict[str, Any]) -> ObjectModel:
    """Return the object, loaded with the options `how` unless it is loaded already, which takes none."""
    if not isinstance(what, ObjectModel):
        return load_object(what, **how)
    told = [key for key, v in how.items() if v is not None and v is not False and (key, v) != ("scale", 1.0)]
    if told:
        raise OptionError(f"'{what.name}' is loaded already; give {told[0]} to load_object instead")
    return what


def assemble(
    body: ObjectModel,
    workcell: Workcell,
    grasps: GraspSet,
    folder: Path | None,
    preset: Literal["default", "paper"] = "default",
    left_out: dict[int, str] | None = None,
    arm_energy: Path | None = None,
) -> RegraspProblem:
    """Return the problem of these parts; nothing is tested, and no grasp is left out."""
    placements = tuple(Placement(workcell.table.T_world_support @ p.pose, p.margin) for p in body.placements)
    return RegraspProblem(body, workcell, grasps, placements, folder, preset, left_out or {}, arm_energy)
