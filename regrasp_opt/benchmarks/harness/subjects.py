"""What is evaluated: the built-in objects and the meshes of a folder, each with a prepared model.

For a comparison, energies are trained with any options on any number of samples, and kept under a hash.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import joblib

from regrasp_opt.benchmarks.harness.runner import resumed
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.energy.storage import load_energy, save_energy
from regrasp_opt.energy.training import TrainingOptions
from regrasp_opt.errors import ModelError, OptionError
from regrasp_opt.feasibility.dataset import LabellingTask, label_pairs, label_poses
from regrasp_opt.files import content_hash, data_home
from regrasp_opt.geometry.mesh_files import MESH_SUFFIXES
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.model_store import find_model
from regrasp_opt.planning.prepare import HELD_OUT_POSES, Progress, prepare, train_and_calibrate
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


@dataclass(frozen=True, eq=False)
class TrainingRequest:
    """An energy to train: `samples` feasible pairs of `problem`, and how."""

    problem: RegraspProblem
    options: TrainingOptions
    samples: int

    @property
    def path(self) -> Path:
        """Where the trained energy is kept."""
        settings = sorted(asdict(self.options).items())
        key = content_hash("trained-1", problem_key(self.problem), settings, self.samples, self.options.seed)
        return data_home() / "benchmarks" / f"{key[:32]}.safetensors"

    @property
    def labelling(self) -> LabellingTask:
        """The labels that it is trained on."""
        problem = self.problem
        body, cell, seed = problem.object, problem.workcell, self.options.seed
        return LabellingTask(body, cell, problem.grasps, problem.placement_poses, seed)


def trained_energies(
    requests: Sequence[TrainingRequest], *, jobs: int = -1, progress: Callable[[int, int], None] | None = None
) -> list[EnergyModel]:
    """Return the energies of `requests`; those not trained before are labelled in turn, then trained in parallel.

    Raises a `RegraspError` if no grasp of a problem is feasible, or its labels cannot train an energy.
    """
    unique = {request.path: request for request in requests}

    def work(path: Path) -> Any:
        request = unique[path]
        label_pairs(request.labelling, request.samples, folder=data_home() / "labels", jobs=jobs)
        return joblib.delayed(_train)(replace(request, problem=replace(request.problem)))

    energies = resumed(unique, load_energy, work, save_energy, jobs, progress)
    return [energies[request.path] for request in requests]


def _train(request: TrainingRequest) -> tuple[Path, EnergyModel]:
    """Train and calibrate in a worker; the labels are read from disk, where `trained_energies` has put them."""
    pairs = label_pairs(request.labelling, request.samples, folder=data_home() / "labels", jobs=1)
    held_out = label_poses(request.labelling, HELD_OUT_POSES, jobs=1)
    return request.path, train_and_calibrate(pairs, held_out, request.problem.grasps, request.options)
