"""What is evaluated: the built-in objects and the meshes of a folder, each with a prepared model.

A mesh that cannot be used becomes a subject with an error instead of a problem; the others go on without it.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

from regrasp_opt.errors import ModelError, OptionError, RegraspError
from regrasp_opt.files import content_hash
from regrasp_opt.geometry.mesh_files import MESH_SUFFIXES
from regrasp_opt.objects import ObjectModel, load_object
from regrasp_opt.objects.builtin import OBJECT_NAMES
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.model_store import find_model
from regrasp_opt.planning.prepare import Progress, prepare
from regrasp_opt.scene import Workcell

DEFAULT_WORKCELL = "nova2-w"
_RESIDENTS = 4
"""Problems that a worker keeps, with their collision scenes and solvers."""

logger = logging.getLogger(__name__)

_residents: dict[str, RegraspProblem] = {}


@dataclass(frozen=True, eq=False)
class Subject:
    """An object to be evaluated.

    Attributes
    ----------
    name : str
        Built-in name, or name of the mesh file with its suffix.
    problem : RegraspProblem or None
    error : str
        Why there is no problem.
    """

    name: str
    problem: RegraspProblem | None
    error: str = ""


def load_bodies(folder: Path | None, names: tuple[str, ...] = OBJECT_NAMES) -> dict[str, ObjectModel | RegraspError]:
    """Return the built-in objects `names`, then every mesh of `folder` by its file's name, or why it is no object.

    Raises
    ------
    OptionError
        If `folder` is given and is not a folder or holds no mesh.
    """
    sources: dict[str, str | Path] = {name: name for name in names}
    sources |= {path.name: path for path in mesh_files(folder)} if folder is not None else {}
    return {name: _body(source) for name, source in sources.items()}


def _body(source: str | Path) -> ObjectModel | RegraspError:
    try:
        return load_object(source)
    except RegraspError as error:
        return error


def load_subjects(
    bodies: dict[str, ObjectModel | RegraspError],
    cell: Workcell,
    *,
    jobs: int = -1,
    progress: Progress | None = None,
) -> list[Subject]:
    """Return `bodies` as subjects, each with a model that was prepared for `cell`."""
    return [_subject(name, body, cell, jobs, progress) for name, body in bodies.items()]


def mesh_files(folder: Path) -> list[Path]:
    """Return the mesh files in `folder`, by name.

    Raises
    ------
    OptionError
        If there is none.
    """
    if not folder.is_dir():
        raise OptionError(f"'{folder}' is not a folder; give one with {', '.join(MESH_SUFFIXES)} files")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in MESH_SUFFIXES)
    if not found:
        raise OptionError(f"'{folder}' holds no mesh; give a folder with {', '.join(MESH_SUFFIXES)} files")
    return found


def _subject(
    name: str, body: ObjectModel | RegraspError, cell: Workcell, jobs: int, progress: Progress | None
) -> Subject:
    if isinstance(body, RegraspError):
        return Subject(name, None, str(body))
    try:
        return Subject(name, prepared_problem(body, cell, jobs=jobs, progress=progress))
    except RegraspError as error:
        return Subject(name, None, str(error))


def prepared_problem(
    model: ObjectModel, cell: Workcell, *, jobs: int = -1, progress: Progress | None = None
) -> RegraspProblem:
    """Return the problem of `model` in `cell`; its model is prepared where there is none, or a broken one.

    Raises
    ------
    RegraspError
        If it cannot be prepared.
    """
    problem = _stored_problem(model, cell)
    if problem is None:
        prepare(model, cell, jobs=jobs, progress=progress)
        problem = RegraspProblem.load(model, cell)
    return problem


def _stored_problem(model: ObjectModel, cell: Workcell) -> RegraspProblem | None:
    try:
        if find_model(model, cell) is None:
            return None
        problem = RegraspProblem.load(model, cell)
        _ = problem.energy
    except ModelError as error:
        logger.warning("%s; it is made again", error)
        return None
    return replace(problem)


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
