"""`bench speed` at a size of seconds: what was measured stands in its file and, rounded, on its page."""

import json
import re

import numpy as np
import pytest

from regrasp_opt.benchmarks.comparisons import kernels, speed
from regrasp_opt.benchmarks.comparisons.speed import SpeedSizes
from regrasp_opt.benchmarks.comparisons.speed_page import performance_page
from regrasp_opt.benchmarks.harness.environment import environment
from regrasp_opt.cli.app import run
from regrasp_opt.connectivity import CostOptions
from regrasp_opt.connectivity.casadi_costs import plain_sequence_cost
from regrasp_opt.energy.casadi_energy import CasadiEnergy

TINY_SIZES = {"N": (1, 2), "G": (10, 20), "H": (8, 16)}


@pytest.fixture
def tiny(monkeypatch):
    monkeypatch.setattr(speed, "QUICK", SpeedSizes(1, 1, 1, 2, 300, 1, 500))
    monkeypatch.setattr(speed, "OBJECT_NAMES", ("bottle",))
    monkeypatch.setattr(kernels, "SIZES", TINY_SIZES)
    monkeypatch.setattr(kernels, "STANDARD", {"N": 1, "G": 10, "H": 8})
    monkeypatch.setattr(kernels, "DERIVATIVE_SIZES", {"N": 2, "G": 12, "H": 8})
    monkeypatch.setattr(kernels, "PROCESSES", 1)
    monkeypatch.setattr(speed, "process_row", made_up_process)


def made_up_process(label, arguments, environment=None):
    """Return the row of a process that needs a second for each word, and fails where it has to do with a mesh."""
    broken = any(word.endswith(".stl") for word in arguments)
    return {"what": label, "seconds": float(len(arguments)), "peak_mb": 300.0, "exit": 2 if broken else 0}


def cells(page, first):
    """Return the cells of the line of a table of `page` that begins with the cell `first`."""
    [line] = [line for line in page.splitlines() if line.startswith(f"| {first} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_command_measures_every_part_and_the_page_repeats_it(tiny, tmp_path, capsys):
    (tmp_path / "broken.stl").touch()
    out = tmp_path / "out"
    assert run(["bench", "speed", "--quick", "--objects", str(tmp_path), "--out", str(out), "--json"]) == 0
    stored = json.loads((out / "speed" / "speed.json").read_text("utf-8"))
    page = (out / "speed" / "performance.md").read_text("utf-8")
    assert stored == {"environment": environment(), **json.loads(capsys.readouterr().out)}

    one, langevin, *deep = stored["plans"]
    assert all(row["solved"] and row["object"] == "bottle" for row in stored["plans"])
    assert (one["refiner"], one["N"], langevin["refiner"]) == ("ipopt", 1, "langevin")
    assert deep and all(row["N"] >= 2 and row["thin"] and row["grasps"] == speed.THIN_GRASPS for row in deep)
    assert all(sum(row[name] for name in row if name.startswith("t_")) <= row["seconds"] for row in stored["plans"])

    assert stored["derivatives"]["difference"] < 1e-9 and stored["checks"]["different_labels"] == 0
    assert 0 < stored["checks"]["feasible_share"] < 1 and stored["checks"]["pairs"] == 400
    for axis, rows in stored["curves"].items():
        assert tuple(row[axis] for row in rows) == TINY_SIZES[axis]
        assert stored["exponents"][axis] == pytest.approx(kernels.exponent(rows, axis))
    told = {row["what"]: (row["seconds"], row["exit"]) for row in stored["processes"]}
    assert told == {
        "regrasp-opt --help": (1, 0),
        "regrasp-opt plan": (1, 0),
        "prepare broken.stl": (4, 2),
        "plan broken.stl": (3, 2),
        "prepare + plan broken.stl": (7, 2),
    }

    assert "regrasp-opt bench speed --quick" in page
    assert cells(page, "hessian")[1] == f"{1e3 * stored['derivatives']['hessian']:.2f}"
    assert cells(page, "prepare broken.stl")[-1] == "2"
    two = sum(row["N"] == 2 for row in deep)
    assert two == 0 or f"| bottle | few grasps, N = 2 | {two} | {two} |" in page
    assert "All grasps: 1 random pairs" in page and "Few grasps (12)" in page


def test_a_process_is_timed_and_its_exit_code_told(tmp_path):
    helped = speed.process_row("help", ["--help"])
    refused = speed.process_row("refused", ["plan", "--object", str(tmp_path / "none.stl")])
    assert (helped["what"], helped["exit"], refused["exit"]) == ("help", 0, 2)
    assert helped["seconds"] > 0 and 5 < helped["peak_mb"] < refused["peak_mb"] < 5000


def plan(seconds, refiner="ipopt", N=1, solved=True, thin=False, grasps=200, **parts):
    row = {"object": "mug", "grasps": grasps, "thin": thin, "refiner": refiner, "solved": solved, "N": N}
    return {**row, "seconds": seconds, **{f"t_{name}": value for name, value in parts.items()}}


def made_up():
    plans = [plan(0.1, refine=0.04, verify=0.01), plan(0.2, refine=0.04, verify=0.01), plan(0.3, refine=0.1)]
    plans += [plan(0.5, N=2), plan(0.9, N=3), plan(0.7, N=None, solved=False), plan(0.8, N=2, thin=True, grasps=12)]
    plans += [plan(1.5, "langevin"), plan(3.0, "langevin", None, False)]
    times = {"hessian": 0.002, "plain_hessian": 0.01, "gradient": 0.001, "plain_gradient": 0.0015}
    times |= {"blas_hessian": 0.006, "blas_gradient": 0.0011}
    curve = [{"N": n, "G": 200, "H": 64, "seconds": 0.001 * n**2} for n in (1, 2, 4)]
    checks = {"processes": 2, "pairs": 1000, "per_second": 5000.0, "plain_per_second": 400.0, "different_labels": 0}
    processes = [{"what": "plan", "seconds": s, "peak_mb": 100 * s, "exit": int(s > 2)} for s in (1.0, 2.0, 3.0)]
    return {
        "plans": plans,
        "derivatives": {"N": 3, "G": 200, "H": 128, **times, "difference": 1e-14},
        "curves": {"N": curve},
        "exponents": {"N": kernels.exponent(curve, "N")},
        "checks": {**checks, "feasible_share": 0.1},
        "processes": processes,
        "peak_mb": 512.4,
    }


def test_figures_of_the_page_are_medians_and_ratios_of_the_rows():
    page = performance_page(made_up(), environment(), "the command")
    table = [line.split(" | ") for line in page.splitlines() if line.startswith("| mug |")]
    lines = {line[1]: [cell.strip(" |") for cell in line[2:]] for line in table}
    assert lines["all grasps, N = 1"] == ["3", "3", "0.200", "0.290", ""]
    assert lines["all grasps, N = 2"][:3] == ["1", "1", "0.500"]
    assert lines["all grasps, N >= 3"][:3] == ["1", "1", "0.900"]
    assert lines["few grasps, N = 2"][:3] == ["1", "1", "0.800"] and "Few grasps (12)" in page
    assert lines["all grasps, no plan"][:3] == ["1", "0", "0.700"] and "All grasps: 6 random pairs" in page
    # Langevin's median against that of the same two tasks
    assert lines["all grasps, N = 1, Langevin"] == ["2", "1", "2.250", "2.925", "15x"]
    assert cells(page, "Ipopt, energies included")[1:3] == ["40.0", "20%"]
    assert cells(page, "the rest")[1:3] == ["150.0", "75%"]
    assert cells(page, "hessian")[1:] == ["2.00", "10.00", "6.00", "5.0x", "3.0x"] and "N = 3, G = 200, H = 128" in page
    assert re.search(r"G = 200, H = 64; exponent 2\.00", page) and "512 MB" in page
    assert cells(page, "plan")[1:] == ["3", "2.00", "300", "1"]
    assert "5,000 (pose, grasp) pairs a second with 2 processes" in page and "0 labels differ" in page


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
    rows = [{"G": n, "seconds": 3e-6 * n**1.5} for n in (50, 100, 400)]
    assert kernels.exponent(rows, "G") == pytest.approx(1.5)


def test_random_energies_are_the_same_for_the_same_seed():
    a, b, c = (kernels.random_energy(6, 8, seed) for seed in (0, 0, 1))
    T = np.eye(4)[None]
    np.testing.assert_array_equal(a(T), b(T))
    assert not np.array_equal(a(T), c(T))
