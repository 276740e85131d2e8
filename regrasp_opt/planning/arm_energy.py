"""The energy of an arm: trained once, without any object, and used for every object in every scene.

``E(T, g) = E_arm(T_base_world T g, w_g)`` depends on the pose of the tool and on the jaw's width alone. It is labelled
by the exact check of tool poses in the workcell as loaded. What it cannot know, the object and what was put in
afterwards, comes in by exact rules (`RegraspProblem.ruled_out`) and by the check of every plan.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shlex
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from regrasp_opt.connectivity import block
from regrasp_opt.conventions import as_seed
from regrasp_opt.energy.calibration import HeldOut, average_precision, calibrate
from regrasp_opt.energy.features import pair_features
from regrasp_opt.energy.model import EnergyModel, GraspEnergy
from regrasp_opt.energy.storage import load_energy, save_energy
from regrasp_opt.energy.training import TrainingOptions, train
from regrasp_opt.errors import GraspError, ModelError, OptionError
from regrasp_opt.feasibility import FeasibilityChecker
from regrasp_opt.feasibility.tool_poses import LabelledToolPoses, label_tool_poses
from regrasp_opt.files import data_home
from regrasp_opt.grasps import GraspSet, sample_grasps
from regrasp_opt.objects import OBJECT_NAMES, load_object
from regrasp_opt.planning.model_key import ArmKey, surroundings
from regrasp_opt.planning.model_store import workcell_arguments
from regrasp_opt.planning.rests import Rests
from regrasp_opt.planning.rules import GraspRules
from regrasp_opt.robots.numerical import NumericalIk
from regrasp_opt.scene import Workcell

TRAINING = TrainingOptions(features="arm", epochs=12, batch_size=2048)
POSES = 300_000
"""Tool poses to train on."""
POSES_NUMERICAL = 60_000
"""The same where inverse kinematics is numerical, and slow."""
LEAST_JOINTS = 6
"""Joints that an arm needs for its tool to be anywhere in a volume, in any direction."""
UNSEEN_GRASPS, UNSEEN_POSES = 50, 40
"""Grasps of each built-in object, and poses, that say how good an energy is on objects that it never saw."""

Progress = Callable[[str, int, int], None]
logger = logging.getLogger(__name__)


def find_arm_energy(workcell: Workcell) -> Path | None:
    """Return the file of the energy of the arm in `workcell`, bundled or in the user's data folder, or None."""
    key, arm = ArmKey.of(workcell), workcell.arm
    bundled = Path(str(resources.files("regrasp_opt"))) / "data" / "arms"
    bundled /= f"{arm.robot.name}-{arm.end_effector.name}.safetensors"
    for path in (bundled, _kept(key)):
        if os.path.isfile(path):
            try:
                card = load_energy(path).metadata
            except ModelError as error:
                logger.warning("%s; it is left out", error)
                continue
            if not key.differing(card):
                return path
    return None


def load_arm_energy(path: str | os.PathLike[str], workcell: Workcell) -> EnergyModel:
    """Return the energy in `path` for the arm in `workcell`; one line says where its surroundings were others.

    Raises
    ------
    ModelError
        If the file is missing or corrupt, or belongs to another robot, mounting or end-effector.
    """
    model = load_energy(path)
    card, arm = model.metadata, workcell.arm
    if model.features != TRAINING.features or "arm" not in card:
        raise ModelError(f"'{path}' is not the energy of an arm; make one with 'regrasp-opt prepare WORKCELL'")
    other = ArmKey.of(workcell).differing(card)
    if other:
        arguments = shlex.join(workcell_arguments(workcell))
        raise ModelError(
            f"'{path}' is the energy of another {' and '.join(other)} than '{arm.robot.name}' with "
            f"'{arm.end_effector.name}' in '{workcell.name}'; run 'regrasp-opt prepare {arguments}'"
        )
    if card.get("surroundings") != surroundings(workcell):
        logger.info("the energy of the arm was trained in '%s', with other supports or obstacles", card.get("workcell"))
    return model.seen_from(arm.T_base_world)


def train_arm_energy(
    workcell: Workcell,
    *,
    poses: int | None = None,
    out: str | os.PathLike[str] | None = None,
    seed: int = 0,
    jobs: int = -1,
    progress: Progress | None = None,
) -> tuple[Path, dict[str, Any]]:
    """Train and store the energy of the arm in `workcell`.

    Parameters
    ----------
    poses : int, optional
        Tool poses to label and train on; by default `POSES`, or `POSES_NUMERICAL` without analytic kinematics.
    out : path, optional
        File of the energy (.safetensors); by default one in the user's data folder, where it is found again.
    seed : int
        The same seed gives the same energy on the same machine.
    jobs : int
        Worker processes for labelling, as joblib counts them.
    progress : callable, optional
        Called with (what is being done, done, to do).

    Returns
    -------
    path : Path
    card : dict
        The model card: what it was trained for, counts, times [s], and how it ranks the grasps of the built-in objects,
        with the exact rules; average precision by object in ``unseen``, other metrics of all in ``held_out``.

    Raises
    ------
    ModelError
        If no tool pose is feasible; says why, with counts.
    OptionError
        For fewer than 1,000 poses, no workers, or a place that cannot be written.
    """
    arm = workcell.arm
    if arm.robot.dof < LEAST_JOINTS:
        raise ModelError(short_arm(workcell))
    if poses is None:
        poses = POSES_NUMERICAL if isinstance(workcell.arm.robot.ik, NumericalIk) else POSES
    if poses < 1000:
        raise OptionError(f"poses is {poses}; give at least 1000")
    if jobs == 0:
        raise OptionError("jobs is 0; give a number of worker processes, or -1 for all cores")
    path = _writable(_kept(ArmKey.of(workcell)) if out is None else Path(out))
    seed, workcell, tell = as_seed(seed), workcell.as_loaded, progress or (lambda *_: None)
    began = [time.perf_counter()]
    labels = label_tool_poses(workcell, poses, seed=seed, jobs=jobs, progress=lambda n, of: tell("labelling", n, of))
    began.append(time.perf_counter())
    trained = _train(workcell, labels, seed, lambda n, of: tell("training", n, of))
    began.append(time.perf_counter())
    unseen = _unseen(workcell, trained.seen_from(workcell.arm.T_base_world), seed)
    if unseen:
        trained = calibrate(trained, list(unseen.values()), seed)
    began.append(time.perf_counter())
    arm, key = workcell.arm, ArmKey.of(workcell)
    card = {
        **trained.metadata,
        "arm": asdict(key),
        "surroundings": surroundings(workcell),
        "robot": arm.robot.name,
        "end_effector": arm.end_effector.name,
        "workcell": workcell.name,
        "command": f"regrasp-opt prepare {shlex.join(workcell_arguments(workcell))} --poses {poses} --seed {seed}",
        "seed": seed,
        "poses": len(labels),
        "feasible_poses": int(labels.feasible.sum()),
        "unseen": {name: average_precision(E.ravel(), feasible.ravel()) for name, (E, feasible) in unseen.items()},
        "times": dict(zip(("labelling", "training", "evaluation"), np.diff(began).tolist(), strict=True)),
    }
    save_energy(replace(trained, metadata=card), path)
    return path, card


def short_arm(workcell: Workcell) -> str:
    """Return why nothing is sampled or trained for an arm of fewer than `LEAST_JOINTS`, and what can be done."""
    return (
        f"'{workcell.robot.name}' has {workcell.robot.dof} joints and reaches almost no grasp or tool pose drawn at "
        f"random, which takes {LEAST_JOINTS}; give grasps that it reaches (--grasps, grasps=) and plan with refiner "
        "'exact', or use another arm"
    )


def _writable(path: Path) -> Path:
    """Return `path`, which can be written once its folder is made; it is looked at before work is spent."""
    if os.path.isdir(path):
        raise OptionError(f"'{path}' is a folder; give the name of a file, for example '{path / 'arm.safetensors'}'")
    with contextlib.suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
    if not os.path.isdir(path.parent) or not os.access(path.parent, os.W_OK):
        raise OptionError(
            f"the energy cannot be written to '{path}'; give another place, or set REGRASP_OPT_HOME to a "
            "folder that can be written"
        )
    return path


def _kept(key: ArmKey) -> Path:
    return data_home() / "arms" / f"{key.id}.safetensors"


def _train(workcell: Workcell, labels: LabelledToolPoses, seed: int, tell: Callable[[int, int], None]) -> EnergyModel:
    jaw = GraspSet(np.tile(np.eye(4), (len(labels), 1, 1)), labels.width, workcell.arm.end_effector.kind)
    T_base_tcp = workcell.arm.T_base_world @ labels.T
    options = replace(TRAINING, seed=seed)
    return train(pair_features(T_base_tcp, jaw, options.features, options.use_width), labels.feasible, options, tell)


def _unseen(workcell: Workcell, model: EnergyModel, seed: int) -> dict[str, HeldOut]:
    """Return energies, with exact rules, and feasibility of grasps on the built-in objects that the tool can hold."""
    rng = np.random.default_rng([seed, 1])
    found = {}
    for name in OBJECT_NAMES:
        body = load_object(name)
        try:
            grasps = sample_grasps(body, workcell.arm.end_effector, UNSEEN_GRASPS, seed=seed)
        except GraspError:
            continue
        rests = Rests.of(body, workcell)
        numbers, xi = rests.planar.draw(UNSEEN_POSES, rng)
        T = rests.planar.at(numbers, xi)
        checker = FeasibilityChecker(body, workcell, grasps)
        ids = np.tile(np.arange(len(grasps)), len(T))
        feasible = checker.feasible_pairs(np.repeat(T, len(grasps), axis=0), ids).reshape(len(T), -1)
        ruled_out = GraspRules(checker, body, rests)(numbers, xi)
        if feasible.any():
            found[name] = HeldOut(block(GraspEnergy(model, grasps)(T), ruled_out), feasible)
    return found
