"""Energies on disk and outside Python say what they said before."""

from __future__ import annotations

import json
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from safetensors.numpy import load_file, save_file
from transforms import random_transforms

from regrasp_opt.energy.export import EXPORTERS, SUFFIXES
from regrasp_opt.energy.network import ACTIVATIONS
from regrasp_opt.energy.storage import load_energy, save_energy
from regrasp_opt.errors import ModelError

KINDS = [(a, f, b) for a in ACTIVATIONS for f, b in (("tcp", True), ("paper", False))]


@pytest.mark.parametrize(("activation", "features", "bounded"), KINDS)
def test_saved_and_loaded_is_the_same(make_energy, tmp_path, activation, features, bounded):
    before = make_energy(activation=activation, features=features, bounded=bounded, use_width=bounded).model
    before = replace(before, threshold=0.75, metadata={"key": "abc", "held_out": {"f1": 0.5}})
    save_energy(before, tmp_path / "energy.safetensors")
    after = load_energy(str(tmp_path / "energy.safetensors"))
    assert after.fingerprint() == before.fingerprint()
    assert (after.threshold, after.metadata, after.hidden) == (0.75, before.metadata, before.hidden)
    assert [path.name for path in tmp_path.iterdir()] == ["energy.safetensors"]


def damaged(tmp_path, model, change):
    """Return the path of a file of `model` after `change` of its header and arrays."""
    path = tmp_path / "energy.safetensors"
    save_energy(model, path)
    header = {
        "format": 1,
        "layers": 3,
        "activation": model.activation,
        "features": model.features,
        "use_width": model.use_width,
        "bounded": model.bounded,
        "threshold": 1.0,
        "metadata": {},
    }
    arrays = load_file(path)
    change(header, arrays)
    save_file(arrays, path, {"regrasp_opt": json.dumps(header)})
    return path


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda header, arrays: header.update(format=2), "not a model of format 1"),
        (lambda header, arrays: header.pop("threshold"), "lacks a field"),
        (lambda header, arrays: arrays.pop("bias.1"), "lacks a field"),
        (lambda header, arrays: header.update(metadata=3), "lacks a field"),
        (lambda header, arrays: header.update(activation="relu"), "do not fit together"),
        (lambda header, arrays: header.update(features="pixels"), "do not fit together"),
        (lambda header, arrays: header.update(use_width=False), "do not fit together"),
        (lambda header, arrays: header.update(layers=2), "do not fit together"),
        (lambda header, arrays: header.update(layers=0), "do not fit together"),
        (lambda header, arrays: arrays.update({"bias.0": arrays["bias.0"][1:]}), "do not fit together"),
        (lambda header, arrays: arrays.update({"weight.1": arrays["weight.1"][:, 1:].copy()}), "do not fit together"),
        (lambda header, arrays: arrays.update({"weight.1": arrays["weight.1"].ravel()}), "do not fit together"),
        (lambda header, arrays: arrays["weight.0"].__setitem__((0, 0), np.nan), "do not fit together"),
        (lambda header, arrays: arrays["bias.2"].__setitem__(0, np.inf), "do not fit together"),
        (lambda header, arrays: None, None),
    ],
)
def test_files_that_cannot_be_an_energy_are_refused(make_energy, tmp_path, change, said):
    path = damaged(tmp_path, make_energy().model, change)
    if said is None:
        assert load_energy(path).fingerprint() == make_energy().model.fingerprint()
        return
    with pytest.raises(ModelError, match=said) as caught:
        load_energy(path)
    assert str(path) in str(caught.value) and "regrasp-opt prepare" in str(caught.value)


def test_a_missing_and_an_empty_file_are_named(tmp_path):
    with pytest.raises(ModelError, match="there is no model file"):
        load_energy(tmp_path / "none.safetensors")
    with pytest.raises(ModelError, match="there is no model file"):
        load_energy(tmp_path)
    (tmp_path / "empty.safetensors").write_bytes(b"")
    with pytest.raises(ModelError, match="is empty or corrupt"):
        load_energy(tmp_path / "empty.safetensors")
    save_file({"weight.0": np.zeros((1, 1), np.float32)}, tmp_path / "other.safetensors")
    with pytest.raises(ModelError, match="not a model of format 1"):
        load_energy(tmp_path / "other.safetensors")


@pytest.mark.parametrize(("activation", "features", "bounded"), KINDS)
@pytest.mark.parametrize("to", ["casadi", "onnx"])
def test_exported_energies_are_the_same(make_energy, tmp_path, to, activation, features, bounded):
    energy = make_energy(activation=activation, features=features, bounded=bounded, use_width=bounded)
    poses = random_transforms(np.random.default_rng(7), 4)
    path = tmp_path / f"energy{SUFFIXES[to]}"
    EXPORTERS[to](energy, path)
    if to == "casadi":
        function = ca.Function.load(str(path))
        assert (function.name(), function.name_in(), function.name_out()) == ("energy", ["T"], ["E"])
        found, tolerance = np.array([np.array(function(T))[:, 0] for T in poses]), 1e-10
    else:
        session = pytest.importorskip("onnxruntime").InferenceSession(str(path))
        assert [one.name for one in (*session.get_inputs(), *session.get_outputs())] == ["T", "E"]
        (found,), tolerance = session.run(None, {"T": poses[:, :3].astype(np.float32)}), 1e-4
    np.testing.assert_allclose(found, energy(poses), atol=tolerance)


def test_exported_c_is_a_function_of_that_name(make_energy, tmp_path):
    EXPORTERS["c"](make_energy(), tmp_path / "energy.c")
    source = (tmp_path / "energy.c").read_text("utf-8")
    assert "int energy(const casadi_real** arg" in source and "dgemm" not in source
    assert EXPORTERS.keys() == SUFFIXES.keys()
