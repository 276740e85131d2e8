"""Energies trained for a comparison: any training options, any number of samples, kept under a hash."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import joblib

from regrasp_opt.benchmarks.harness.parallel import resumed
from regrasp_opt.benchmarks.harness.subjects import problem_key
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.energy.storage import load_energy, save_energy
from regrasp_opt.energy.training import TrainingOptions
from regrasp_opt.feasibility.dataset import LabellingTask, label_pairs, label_poses
from regrasp_opt.files import content_hash, data_home
from regrasp_opt.planning import RegraspProblem
from regrasp_opt.planning.prepare import HELD_OUT_POSES, train_and_calibrate


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
