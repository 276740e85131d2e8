"""`prepare`: from an object and a workcell to a stored model of the object's own - grasps, labels, training.

The paper's preset is trained on the same data and kept beside ours, so that both are on record.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import joblib
import numpy as np

from regrasp_opt.conventions import as_seed
from regrasp_opt.energy.calibration import HeldOut, calibrate
from regrasp_opt.energy.features import pair_features
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.energy.storage import save_energy
from regrasp_opt.energy.training import PRESETS, TrainingOptions, train
from regrasp_opt.errors import GraspError, OptionError
from regrasp_opt.feasibility.dataset import (
    LabelledPairs,
    LabelledPoses,
    LabellingTask,
    label_pairs,
    label_poses,
)
from regrasp_opt.files import data_home, replaced_folder
from regrasp_opt.grasps import GraspSet, sample_grasps
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning.given_grasps import NEAR, Near, usable_grasps
from regrasp_opt.planning.model_key import ModelKey
from regrasp_opt.planning.model_store import (
    ENERGY_FILES,
    GRASPS_FILE,
    command_arguments,
    default_folder,
    write_report,
)
from regrasp_opt.scene import Workcell
from regrasp_opt.workers import workers

DEFAULT_SAMPLES = 20_000
HELD_OUT_POSES = 300
Progress = Callable[[str, int, int], None]


def prepare(
    model: ObjectModel,
    workcell: Workcell,
    *,
    samples: int = DEFAULT_SAMPLES,
    num_grasps: int = 200,
    grasps: GraspSet | None = None,
    near: Near = NEAR,
    out: str | os.PathLike[str] | None = None,
    seed: int = 0,
    jobs: int = -1,
    progress: Progress | None = None,
) -> tuple[Path, dict[str, Any]]:
    """Make and store grasps of `model` in `workcell` and energies of its own; planning can do without.

    Parameters
    ----------
    samples : int
        Feasible (pose, grasp) pairs to train on; the infeasible ones met on the way are kept too.
    num_grasps : int
        Candidate grasps of the model, where none are given.
    grasps, near
        Same as in `RegraspProblem.load`.
    out : path, optional
        Folder of the model; by default one in the user's data folder, where `RegraspProblem.load` finds it.
    seed : int
        The same seed gives the same model on the same machine.
    jobs : int
        Worker processes for labelling, as joblib counts them.
    progress : callable, optional
        Called with (what is being done, done, to do).

    Returns
    -------
    folder : Path
    report : dict
        Counts, times [s], and average precision, AUROC, F1 and reliability of both energies on held-out poses.

    Raises
    ------
    GraspError
        If no grasp fits the object, none of the given ones holds it, or none is feasible in the workspace.
    ModelError
        If the labels cannot train an energy.
    OptionError
        For fewer than 100 samples, no grasps, no workers, or obstacles that were put into the workcell afterwards.
    """
    _check(model, workcell, samples, num_grasps, jobs)
    seed = as_seed(seed)
    tell = progress or (lambda *_: None)
    began = [time.perf_counter()]
    tell("sampling grasps", 0, 1)
    arguments, grasps = _candidates(model, workcell, num_grasps if grasps is None else grasps, near, seed)
    began.append(time.perf_counter())
    placements = np.array([workcell.table.T_world_support @ p.pose for p in model.placements])
    pairs, held_out = _labelled(LabellingTask(model, workcell, grasps, placements, seed), samples, jobs, tell)
    began.append(time.perf_counter())
    energies = _train_presets(pairs, held_out, grasps, seed, jobs, tell)
    began.append(time.perf_counter())

    key = ModelKey.of(model, workcell)
    report = {
        "key": key.id,
        "made_for": key.parts(),
        "grasps_fingerprint": grasps.fingerprint(),
        "command": f"regrasp-opt prepare {command_arguments(model, workcell)} --samples {samples} "
        f"{arguments} --seed {seed}",
        "object": model.name,
        "workcell": workcell.name,
        "seed": seed,
        "grasps": len(grasps),
        "placements": len(placements),
        "pairs": len(pairs),
        "feasible_pairs": int(pairs.feasible.sum()),
        "held_out": {name: energy.metadata["held_out"] for name, energy in energies.items()},
        "threshold": {name: energy.threshold for name, energy in energies.items()},
        "times": dict(zip(("grasps", "labelling", "training"), np.diff(began).tolist(), strict=True)),
    }
    folder = default_folder(model, workcell) if out is None else Path(out)
    return _store(folder, grasps, energies, report), report


def _candidates(
    model: ObjectModel, workcell: Workcell, grasps: int | GraspSet, near: Near, seed: int
) -> tuple[str, GraspSet]:
    """Return as many grasps as asked for, or those given that can be used, and the arguments that ask for them."""
    if not isinstance(grasps, GraspSet):
        sampled = sample_grasps(model, workcell.end_effector, grasps, seed=seed, clearance=workcell.clearance.gripper)
        return f"--grasps {grasps}", sampled
    used, _ = usable_grasps(grasps, model, workcell.arm.end_effector, near)
    degrees = np.degrees(near.angle)
    given = "--grasps GRASPS" if grasps.source is None else grasps.source.arguments
    return f"{given} --grasp-near {near.distance:g},{degrees:g}", used


def _labelled(task: LabellingTask, samples: int, jobs: int, tell: Progress) -> tuple[LabelledPairs, LabelledPoses]:
    """Return pairs to train on and poses held out."""
    labels = data_home() / "labels"
    pairs = label_pairs(task, samples, folder=labels, jobs=jobs, progress=lambda n, of: tell("labelling", n, of))
    return pairs, label_poses(task, HELD_OUT_POSES, jobs=jobs)


def _check(model: ObjectModel, workcell: Workcell, samples: int, num_grasps: int, jobs: int) -> None:
    if workcell.added:
        raise OptionError(
            f"obstacle '{workcell.added[0]}' was put in later and needs no training; prepare the workcell as loaded"
        )
    if samples < 100 or num_grasps < 1:
        raise OptionError(f"samples is {samples} and num_grasps {num_grasps}; give at least 100 and 1")
    if jobs == 0:
        raise OptionError("jobs is 0; give a number of worker processes, or -1 for all cores")
    if not model.placements:
        raise GraspError(f"'{model.name}' has no stable placement on a table; check the mesh's shape and scale")


def _store(folder: Path, grasps: GraspSet, energies: dict[str, EnergyModel], report: dict[str, Any]) -> Path:
    trained_for = {"key": report["key"], "grasps": report["grasps_fingerprint"]}
    with replaced_folder(folder) as fresh:
        grasps.save(fresh / GRASPS_FILE)
        for name, energy in energies.items():
            stamped = replace(energy, metadata={**energy.metadata, **trained_for})
            save_energy(stamped, fresh / ENERGY_FILES[name])
        write_report(fresh, report)
    return folder


def _train_presets(
    pairs: LabelledPairs, held_out: LabelledPoses, grasps: GraspSet, seed: int, jobs: int, tell: Progress
) -> dict[str, EnergyModel]:
    tell("training", 0, len(PRESETS))
    presets = [replace(options, seed=seed) for options in PRESETS.values()]
    energies: dict[str, EnergyModel] = {}
    with workers(min(len(PRESETS), joblib.effective_n_jobs(jobs)), "generator") as parallel:
        work = (joblib.delayed(train_and_calibrate)(pairs, held_out, grasps, options) for options in presets)
        for name, energy in zip(PRESETS, parallel(work), strict=True):
            energies[name] = energy
            tell("training", len(energies), len(PRESETS))
    return energies


def train_and_calibrate(
    pairs: LabelledPairs, held_out: LabelledPoses, grasps: GraspSet, options: TrainingOptions
) -> EnergyModel:
    """Return an energy trained on `pairs` of the `grasps`, with its threshold and metrics on `held_out` poses."""
    chosen = grasps.subset(pairs.grasp_ids)
    trained = train(pair_features(pairs.T, chosen, options.features, options.use_width), pairs.feasible, options)
    return calibrate(trained, [HeldOut(GraspEnergy(trained, grasps)(held_out.T), held_out.feasible)], options.seed)
