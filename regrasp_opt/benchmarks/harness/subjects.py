"""What is evaluated: the built-in objects and the meshes of a folder, each with a prepared model."""

from __future__ import annotations

import logging
import os
from dataclasses import replace
from pathlib import Path

from regrasp_opt.errors import ModelError, OptionError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.mesh_files import MESH_SUFFIXES
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.model_store import find_model
from regrasp_opt.planning.prepare import Progress, prepare
from regrasp_opt.scene import Workcell

DEFAULT_WORKCELL = "nova2-w"
_RESIDENTS = 4
"""Problems that a worker keeps, with their collision scenes and solvers."""

logger = logging.getLogger(__name__)

_residents: dict[str, RegraspProblem] = {}


def mesh_files(folder: Path, pattern: str = "*") -> list[Path]:
    """Return the mesh files in `folder`, by name; with the pattern ``**/*`` those in folders below it too.

    Raises an `OptionError` if there is none.
    """
    if not os.path.isdir(folder):
        raise OptionError(f"'{folder}' is not a folder; give one with {', '.join(MESH_SUFFIXES)} files")
    found = sorted(path for path in folder.glob(pattern) if path.suffix.lower() in MESH_SUFFIXES)
    if not found:
        raise OptionError(f"'{folder}' holds no mesh; give a folder with {', '.join(MESH_SUFFIXES)} files")
    return found


def prepared_problem(
    model: ObjectModel, cell: Workcell, *, jobs: int = -1, progress: Progress | None = None
) -> RegraspProblem:
    """Return the problem of `model` in `cell`; its model is prepared where there is none, or a broken one.

    Raises a `RegraspError` if it cannot be prepared.
    """
    try:
        if find_model(model, cell) is not None:
            problem = RegraspProblem.load(model, cell)
            _ = problem.energy
            return replace(problem)
    except ModelError as error:
        logger.warning("%s; it is made again", error)
    prepare(model, cell, jobs=jobs, progress=progress)
    return RegraspProblem.load(model, cell)


def problem_key(problem: RegraspProblem) -> str:
    """Return a hash of what exact feasibility depends on: object, workcell, grasps and placements."""
    parts = [problem.object.fingerprint(), problem.workcell.fingerprint(), problem.grasps.fingerprint()]
    return content_hash(*parts, problem.placement_poses)


def planning_key(problem: RegraspProblem) -> str:
    """Return a hash of what plans depend on, besides the code: `problem_key` and the energy."""
    return content_hash(problem_key(problem), problem.energy.fingerprint())


def resident(problem: RegraspProblem) -> RegraspProblem:
    """Return this process's own copy of `problem`, whose collision scene, lattice and solvers are made once."""
    key = content_hash(problem_key(problem), str(problem.model_folder), problem.preset)
    if key not in _residents:
        while len(_residents) >= _RESIDENTS:
            _residents.pop(next(iter(_residents)))
        _residents[key] = replace(problem)
    return _residents[key]
