"""Energies on disk: weights in safetensors, everything else as JSON in the file's own metadata."""

from __future__ import annotations

import json
import os
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from regrasp_opt.energy.features import FEATURE_SETS, feature_count
from regrasp_opt.energy.model import EnergyModel
from regrasp_opt.energy.network import ACTIVATIONS
from regrasp_opt.errors import ModelError
from regrasp_opt.files import atomic_path

FORMAT = 1
AGAIN = "make it again with 'regrasp-opt prepare'"


def save_energy(model: EnergyModel, path: str | os.PathLike[str]) -> None:
    """Write `model` to `path` (.safetensors), atomically."""
    tensors = {f"weight.{i}": np.ascontiguousarray(W) for i, W in enumerate(model.weights)}
    tensors |= {f"bias.{i}": np.ascontiguousarray(b) for i, b in enumerate(model.biases)}
    fields = ("activation", "features", "use_width", "bounded", "threshold", "metadata")
    header = {"format": FORMAT, "layers": len(model.weights), **{name: getattr(model, name) for name in fields}}
    with atomic_path(path) as temporary:
        save_file(tensors, temporary, {"regrasp_opt": json.dumps(header, sort_keys=True)})


def load_energy(path: str | os.PathLike[str]) -> EnergyModel:
    """Read an energy that `save_energy` wrote.

    Raises a `ModelError` if the file is missing, empty, corrupt or of another format.
    """
    path = Path(path)
    if not os.path.isfile(path):
        raise ModelError(f"there is no model file '{path}'; make one with 'regrasp-opt prepare'")
    try:
        with safe_open(path, "numpy") as file:
            header = json.loads((file.metadata() or {}).get("regrasp_opt", "null"))
            arrays = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    except (SafetensorError, OSError, ValueError, RecursionError) as error:
        raise ModelError(f"the model file '{path}' is empty or corrupt; {AGAIN}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise ModelError(f"'{path}' is not a model of format {FORMAT}; {AGAIN}")
    try:
        layers = range(int(header["layers"]))
        model = EnergyModel(
            weights=tuple(arrays[f"weight.{i}"] for i in layers),
            biases=tuple(arrays[f"bias.{i}"] for i in layers),
            activation=header["activation"],
            features=header["features"],
            use_width=bool(header["use_width"]),
            bounded=bool(header["bounded"]),
            threshold=float(header["threshold"]),
            metadata=dict(header["metadata"]),
        )
        good = model.activation in ACTIVATIONS and model.features in FEATURE_SETS and _consistent(model)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"the model file '{path}' lacks a field; {AGAIN}") from error
    if not good:
        raise ModelError(f"the layers in '{path}' do not fit together; {AGAIN}")
    return model


def _consistent(model: EnergyModel) -> bool:
    inputs = feature_count(model.features, model.use_width)
    for W, b in zip(model.weights, model.biases, strict=True):
        if W.ndim != 2 or W.shape != (len(b), inputs) or not (np.isfinite(W).all() and np.isfinite(b).all()):
            return False
        inputs = len(b)
    return inputs == 1 and len(model.weights) >= 2
