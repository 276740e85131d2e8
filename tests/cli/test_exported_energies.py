"""Exported energies give the energies they were made from: as a CasADi function, as plain C, as ONNX."""

import subprocess

import casadi as ca
import numpy as np
import pytest
from command import in_process

from regrasp_opt import RegraspProblem
from regrasp_opt.conventions import planar_transform
from regrasp_opt.planning.model_store import bundled_models

MAIN = """
#include <stdio.h>
#include "energy.c"

int main(void) {
  casadi_int sz_arg, sz_res, sz_iw, sz_w;
  energy_work(&sz_arg, &sz_res, &sz_iw, &sz_w);
  static double T[16], E[%(grasps)d], w[%(work)d];
  static casadi_int iw[%(work)d];
  const double *arg[64];
  double *res[64];
  if (sz_arg > 64 || sz_res > 64 || sz_iw > %(work)d || sz_w > %(work)d) return 2;
  while (1) {
    for (int i = 0; i < 16; ++i) if (scanf("%%lf", &T[i]) != 1) return 0;
    arg[0] = T;
    res[0] = E;
    if (energy(arg, res, iw, w, 0)) return 1;
    for (int i = 0; i < %(grasps)d; ++i) printf("%%.17g\\n", E[i]);
  }
}
"""


@pytest.fixture(scope="module")
def expected():
    """Return poses (B, 4, 4) of the bottle and their energies (B, G)."""
    problem, rng = RegraspProblem.load("bottle", "nova2-w"), np.random.default_rng(0)
    xi = rng.uniform([-0.4, 0.1, 0.0], [0.4, 0.6, 6.0], (6, 3))
    T = planar_transform(xi) @ problem.placement_poses[rng.integers(len(problem.placements), size=6)]
    return T, problem.energy(T)


def export(capsys, to, path):
    outcome = in_process(capsys, "export", "bottle-nova2-w", "--to", to, "--out", path)
    assert outcome.code == 0 and outcome.err == ""
    assert [item.name for item in path.parent.iterdir()] == [path.name]
    return path


def test_casadi(capsys, tmp_path, expected):
    function = ca.Function.load(str(export(capsys, "casadi", tmp_path / "energy.casadi")))
    assert (function.name_in(), function.name_out()) == (["T"], ["E"])
    for T, energies in zip(*expected, strict=True):
        np.testing.assert_allclose(np.array(function(T))[:, 0], energies, atol=1e-9)


def test_c(capsys, tmp_path, expected):
    source = export(capsys, "c", tmp_path / "energy.c")
    poses, energies = expected
    main, binary = tmp_path / "main.c", tmp_path / "main"
    main.write_text(MAIN % {"grasps": energies.shape[1], "work": 4_000_000}, encoding="utf-8")
    subprocess.run(["cc", "-std=c99", "-O1", "-o", binary, main, "-lm"], cwd=source.parent, check=True)
    numbers = " ".join(repr(float(v)) for T in poses for v in T.T.ravel())  # CasADi is column-major
    done = subprocess.run([binary], input=numbers, capture_output=True, text=True, check=True)
    found = np.array(done.stdout.split(), dtype=np.float64).reshape(energies.shape)
    np.testing.assert_allclose(found, energies, atol=1e-9)


def test_onnx(capsys, tmp_path, expected):
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(str(export(capsys, "onnx", tmp_path / "energy.onnx")))
    poses, energies = expected
    (found,) = session.run(None, {session.get_inputs()[0].name: poses[:, :3].astype(np.float32)})
    np.testing.assert_allclose(found, energies, atol=1e-3, rtol=1e-3)


def test_json_says_what_was_written(capsys, tmp_path):
    path = tmp_path / "energy.casadi"
    said = in_process(capsys, "export", "bottle-nova2-w", "--to", "casadi", "--out", path, "--json").data
    assert said == {"model": said["model"], "format": "casadi", "grasps": 200, "path": str(path)}
    assert said["model"].endswith("bottle-nova2-w") and path.is_file()


def test_a_folder_is_exported_to_its_name_in_this_folder(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for model in ("mug-nova2-w", bundled_models() / "mug-nova2-w"):
        outcome = in_process(capsys, "export", model, "--to", "c")
        assert outcome.code == 0 and "mug-nova2-w.c" in outcome.out
        assert [path.name for path in tmp_path.iterdir()] == ["mug-nova2-w.c"]
