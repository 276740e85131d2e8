"""Where objects' own models live and how one is found for an object and a workcell.

A model is a folder: the grasps, our energy, the paper's preset trained on the same data, and a model card. Bundled
models come with the package; others are kept in the user's data folder under a hash of object and workcell.
"""

from __future__ import annotations

import json
import os
import shlex
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.energy.storage import load_energy
from regrasp_opt.errors import ModelError
from regrasp_opt.files import atomic_path, data_home
from regrasp_opt.grasps import GraspSet
from regrasp_opt.objects import ObjectModel
from regrasp_opt.planning.model_key import FORMAT, ModelKey
from regrasp_opt.scene import Workcell

GRASPS_FILE = "grasps.npz"
ENERGY_FILES = {"default": "energy.safetensors", "paper": "energy-paper.safetensors"}
REPORT_FILE = "report.json"


def bundled_models() -> Path:
    """Return the folder of the models that come with the package."""
    return Path(str(resources.files("regrasp_opt"))) / "data" / "models"


def default_folder(model: ObjectModel, workcell: Workcell) -> Path:
    """Return where `prepare` puts a model unless told otherwise."""
    return data_home() / "models" / ModelKey.of(model, workcell).id


def find_model(model: ObjectModel, workcell: Workcell, folder: Path | None = None) -> Path | None:
    """Return the folder of the model prepared for `model` in `workcell`, or None.

    Parameters
    ----------
    folder : Path, optional
        Take this one, and no other.

    Raises
    ------
    ModelError
        If `folder`, or a folder that should hold the model, is broken or was made for something else.
    """
    key = ModelKey.of(model, workcell)
    if folder is not None:
        report = read_report(folder)
        if report["key"] != key.id:
            other = " and ".join(key.differing(report)) or "object or workcell"
            raise ModelError(
                f"the model in '{folder}' was prepared for another {other} than '{model.name}' in "
                f"'{workcell.name}'; prepare one for these"
            )
        return folder
    for candidate in (bundled_models() / f"{model.name}-{workcell.name}", default_folder(model, workcell)):
        if os.path.isfile(candidate / REPORT_FILE) and read_report(candidate)["key"] == key.id:
            return candidate
    return None


def read_report(folder: Path) -> dict[str, Any]:
    """Return the report of the model in `folder`.

    Raises
    ------
    ModelError
        If it is missing, corrupt or of another format.
    """
    path = folder / REPORT_FILE
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ModelError(f"'{folder}' holds no prepared model; make one with 'regrasp-opt prepare'") from error
    except (ValueError, RecursionError) as error:
        raise ModelError(f"'{path}' is corrupt; delete the folder and run 'regrasp-opt prepare' again") from error
    if not isinstance(report, dict) or report.get("format") != FORMAT or "key" not in report:
        raise ModelError(f"'{path}' is not a model report of format {FORMAT}; run 'regrasp-opt prepare' again")
    return report


def load_prepared_grasps(folder: Path) -> GraspSet:
    """Return the grasps of the model in `folder`.

    Raises
    ------
    ModelError
        If they are not those that the model was prepared with.
    """
    grasps = GraspSet.load(folder / GRASPS_FILE)
    if grasps.fingerprint() != read_report(folder).get("grasps_fingerprint"):
        raise ModelError(f"the grasps in '{folder}' are not those of its model; run 'regrasp-opt prepare' again")
    return grasps


def load_prepared_energy(folder: Path, preset: str, key: str) -> EnergyModel:
    """Return the energy of `preset` in `folder`, which must have been trained for the `ModelKey` of id `key`.

    Raises
    ------
    ModelError
        If the file is missing or corrupt, or was trained for another object or workcell.
    """
    path = folder / ENERGY_FILES[preset]
    model = load_energy(path)
    if model.metadata.get("key") != key:
        raise ModelError(f"'{path}' was trained for another object or workcell; run 'regrasp-opt prepare' again")
    if model.metadata.get("grasps") != read_report(folder).get("grasps_fingerprint"):
        raise ModelError(f"'{path}' was trained with another grasp set; run 'regrasp-opt prepare' again")
    return model


def write_report(folder: Path, report: dict[str, Any]) -> None:
    """Write `report`; it is the last file of a model, so a folder with a report is complete."""
    with atomic_path(folder / REPORT_FILE) as temporary:
        temporary.write_text(json.dumps({"format": FORMAT, **report}, indent=1) + "\n", encoding="utf-8")


def workcell_arguments(workcell: Workcell) -> list[str]:
    """Return the arguments that name a workcell on the command line of `prepare`."""
    parts = [workcell.name if workcell.source == "built-in" else workcell.source]
    override = workcell.end_effector_override
    return parts if override is None else [*parts, "--end-effector", override]


def command_arguments(body: ObjectModel, workcell: Workcell) -> str:
    """Return the arguments that name a workcell and an object on the command line of `prepare`."""
    parts = workcell_arguments(workcell)
    parts += ["--object", body.name if body.source == "built-in" else body.source]
    if body.scale != 1.0:
        parts += ["--scale", f"{body.scale:g}"]
    if body.repair:
        parts.append("--repair")
    if body.thickness is not None:
        parts += ["--thickness", f"{body.thickness:g}"]
    for key, value in body.given.given().items():
        numbers = np.ravel(value)[[0, 1, 2, 4, 5, 8]] if key == "inertia" else np.ravel(value)
        parts += [f"--{key.replace('_', '-')}", ",".join(str(number) for number in numbers.tolist())]
    return shlex.join(parts)
