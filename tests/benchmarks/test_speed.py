"""`bench speed` at a size of seconds: what was measured stands in its rows and, rounded, in its tables."""

import re
from dataclasses import replace

import numpy as np
import pytest

from regrasp_opt.benchmarks.comparisons import kernels, speed
from regrasp_opt.benchmarks.comparisons.speed import SpeedSizes
from regrasp_opt.benchmarks.harness.report import write_report
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.casadi_costs import plain_sequence_cost
from regrasp_opt.energy.casadi_energy import CasadiEnergy
from regrasp_opt.objects.builtin import build

TINY_SIZES = {"N": (1, 2), "G": (10, 20), "H": (8, 16)}


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(speed, "QUICK", SpeedSizes(1, 1, 1, 2, 300, 1, 500))
    monkeypatch.setattr(kernels, "SIZES", TINY_SIZES)
    monkeypatch.setattr(kernels, "STANDARD", {"N": 1, "G": 10, "H": 8})
    monkeypatch.setattr(kernels, "DERIVATIVE_SIZES", {"N": 2, "G": 12, "H": 8})
    monkeypatch.setattr(kernels, "PROCESSES", 1)
    monkeypatch.setattr(speed, "process_row", made_up_process)


def made_up_process(label, arguments, environment=None):
    """Return the row of a process that needs a second for each word, and fails where it has to do with a mesh."""
    broken = any(word.endswith(".stl") for word in arguments)
    return {"process": label, "seconds": float(len(arguments)), "peak_mb": 300.0, "exit": 2 if broken else 0}


def lines_of(report):
    """Return the lines of the tables of a report, by title and first cell."""
    return {table.title: {line[0]: line[1:] for line in table.rows} for table in report.tables}


def test_every_part_is_measured_and_the_tables_repeat_it(tiny, tmp_path):
    (tmp_path / "broken.stl").touch()
    report = speed.run_speed(Session(tmp_path / "out", quick=True, objects=tmp_path, names=("bottle",), quiet=True))
    one, langevin, *deep = (row for row in report.rows if "refiner" in row)
    assert all(row["solved"] and row["object"] == "bottle" for row in (one, langevin, *deep))
    assert (one["refiner"], one["N"], langevin["refiner"]) == ("ipopt", 1, "langevin")
    assert deep and all(row["N"] >= 2 and row["thin"] and row["grasps"] == speed.THIN_GRASPS for row in deep)
    assert all(sum(row[k] for k in row if k.startswith("t_")) <= row["seconds"] for row in (one, langevin, *deep))

    [gradient, hessian] = (row for row in report.rows if "derivative" in row)
    assert gradient["difference"] < 1e-9 and hessian["difference"] < 1e-9
    [checks] = (row for row in report.rows if "per_second" in row)
    assert checks["different_labels"] == 0 and 0 < checks["feasible_share"] < 1 and checks["pairs"] == 400
    for axis, sizes in TINY_SIZES.items():
        assert tuple(row[axis] for row in report.rows if row.get("along") == axis) == sizes

    lines = lines_of(report)
    assert lines["Derivatives"]["hessian"][0] == round(1e3 * hessian["ours"], 2)
    assert lines["Exact checks"][400][0] == 1
    told = {what: (seconds, code) for what, (_, seconds, _, code) in lines["Whole processes"].items()}
    assert told == {
        "regrasp-opt --help": (1, 0),
        "regrasp-opt plan": (1, 0),
        "prepare broken.stl": (6, 2),
        "plan broken.stl": (3, 2),
        "prepare + plan broken.stl": (9, 2),
        "this measurement": (None, None),
    }
    summary = write_report(report, tmp_path / "out" / "speed")
    assert summary["command"] == "regrasp-opt bench speed" and summary["rows"] == len(report.rows)


def test_a_model_is_prepared_for_a_mesh_and_planned_with(tmp_path):
    build("pentagon").export(tmp_path / "part.stl")
    rows = speed.process_rows([tmp_path / "part.stl"], replace(speed.QUICK, runs=0, samples=300))
    assert [row.get("exit") for row in rows] == [0, 0, 0, None]


def test_a_process_is_timed_and_its_exit_code_told(tmp_path):
    helped = speed.process_row("help", ["--help"])
    refused = speed.process_row("refused", ["plan", "--object", str(tmp_path / "none.stl")])
    assert (helped["process"], helped["exit"], refused["exit"]) == ("help", 0, 2)
    assert helped["seconds"] > 0 and 5 < helped["peak_mb"] < refused["peak_mb"] < 5000


def plan(seconds, refiner="ipopt", N=1, seed=0, thin=False, **parts):
    row = {"object": "mug", "thin": thin, "refiner": refiner, "seed": seed, "solved": N is not None, "N": N}
    return {**row, "seconds": seconds, **{f"t_{name}": value for name, value in parts.items()}}


def test_figures_of_plans_are_medians_and_ratios_of_the_rows():
    rows = [plan(0.1, refine=0.04, verify=0.01), plan(0.2, seed=1, refine=0.04, verify=0.01)]
    rows += [plan(0.3, seed=2, refine=0.1), plan(0.5, N=2, seed=3), plan(0.9, N=3, seed=4), plan(0.7, N=None, seed=5)]
    rows += [plan(0.8, N=2, thin=True), plan(1.5, "langevin"), plan(3.0, "langevin", None, seed=1)]
    lines = {line[1]: line[2:] for line in speed._plans(rows).rows}
    assert lines == {
        "all grasps, N = 1": (3, 3, 0.2, 0.29, None),
        "all grasps, N = 1, Langevin": (2, 1, 2.25, 2.925, 15.0),  # against the same two tasks
        "all grasps, N = 2": (1, 1, 0.5, 0.5, None),
        "all grasps, N >= 3": (1, 1, 0.9, 0.9, None),
        "all grasps, no plan": (1, 0, 0.7, 0.7, None),
        "few grasps, N = 2": (1, 1, 0.8, 0.8, None),
    }
    assert [line[1:3] for line in speed._parts(rows).rows if line[0] in ("Ipopt, energies included", "the rest")] == [
        (40.0, 20),
        (150.0, 75),
    ]


def test_figures_of_kernels_and_processes_are_those_of_the_rows():
    sizes = {"N": 3, "G": 200, "H": 128}
    rows = [{"derivative": "hessian", **sizes, "ours": 0.002, "plain": 0.01, "blas": 0.006, "difference": 1e-14}]
    table = speed._derivatives(rows)
    assert table.rows == (("hessian", 2.0, 10.0, 6.0, 5.0, 3.0),) and table.note.startswith("N = 3, G = 200, H = 128.")
    curve = [{"along": "N", "N": n, "G": 200, "H": 64, "iteration": 0.001 * n**2} for n in (1, 2, 4)]
    table = speed._iterations(curve)
    assert table.rows == ((1, 200, 64, 1.0), (2, 200, 64, 4.0), (4, 200, 64, 16.0)) and "N 2.00." in table.note
    rows = [{"process": "plan", "seconds": s, "peak_mb": 100 * s, "exit": int(s > 2)} for s in (1.0, 2.0, 3.0)]
    assert speed._processes(rows).rows == (("plan", 3, 2.0, 300, 1),)


def test_casadi_is_given_the_same_blas_for_all_products_with_weights(monkeypatch, tmp_path):
    """In generated code the products by CasADi's own loops show: fewer than those that it falls back to by itself."""
    monkeypatch.chdir(tmp_path)
    loops = {}
    energy = kernels.random_energy(12, 8)
    for name, built in (
        ("plain", CasadiEnergy(energy.model, 12)),
        ("all by BLAS", kernels._ProductsByBlas(energy.model, 12, 6)),
    ):
        for derivative in kernels._derivatives(plain_sequence_cost(built, CostOptions(), 2)):
            derivative.generate("code.c")
            products = re.findall(
                r"casadi_mtimes_dense\(.*?, (\d+), (\d+), \w+, (\d+),", (tmp_path / "code.c").read_text()
            )
            loops[name, derivative.name()] = sum("8" in sizes for sizes in products)
    assert loops["plain", "gradient"] and loops["plain", "hessian"]
    assert loops["all by BLAS", "gradient"] == loops["all by BLAS", "hessian"] == 0


def test_the_exponent_of_a_power_law_is_found():
    rows = [{"G": n, "iteration": 3e-6 * n**1.5} for n in (50, 100, 400)]
    assert kernels.exponent(rows, "G") == pytest.approx(1.5)


def test_random_energies_are_the_same_for_the_same_seed():
    a, b, c = (kernels.random_energy(6, 8, seed) for seed in (0, 0, 1))
    T = np.eye(4)[None]
    np.testing.assert_array_equal(a(T), b(T))
    assert not np.array_equal(a(T), c(T))
