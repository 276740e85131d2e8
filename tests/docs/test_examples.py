"""Every program in `examples/` runs in an empty folder and shows what it promises."""

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture
def output(tmp_path, monkeypatch, capsys):
    """Return a function that runs an example and returns what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(name, *arguments):
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out

    return run


def rows(text, pattern):
    return re.findall(pattern, text, re.M)


def test_a_plan_is_printed_and_verified(output):
    text = output("01_plan.py")
    assert text.startswith("SOLVED: 1 regrasp(s)")
    assert len(rows(text, r"^move \d")) == 2
    assert text.endswith("verified again: True\n")


def test_an_own_mesh_and_an_own_robot_are_planned_and_shown(output, tmp_path):
    text = output("02_own_mesh_and_robot.py")
    assert "bracket: 5 stable placements" in text
    assert "arm: 6 joints, inverse kinematics by AnalyticIk" in text
    assert "SOLVED: 1 regrasp(s)" in text
    assert "shelf" in (tmp_path / "own_plan.html").read_text(encoding="utf-8")


def test_refiners_are_compared_and_plotted(output, tmp_path):
    text = output("03_langevin_against_ipopt.py", "1")
    table = rows(text, r"^([\w-]+) +1/1 +[\d.]+ +-?[\d.]+ +[\d.]+$")
    assert table[:3] == ["ipopt", "lattice", "langevin"] and table[-1] == "exact"
    best = dict(rows(text, r"^(\w+) +best of 8 random starts: J_seq = (-?[\d.]+)$"))
    assert float(best["ipopt"]) < float(best["langevin"])
    page = (tmp_path / "langevin_against_ipopt.html").read_text(encoding="utf-8")
    assert page.count('"type":"scatter"') >= 16


def test_an_own_term_pulls_the_pose_to_its_place_and_grasps_remain(output):
    text = output("04_jseq_in_opti.py")
    table = rows(text, r"^ +\d+ +-?[\d.]+ +-?[\d.]+ +([\d.]+)   \[ *(\d+) +(\d+)\]$")
    away = [float(row[0]) for row in table]
    assert len(away) == 5
    assert away[-1] < 0.1 * away[0]
    assert all(int(shared) > 0 for row in table for shared in row[1:])


def test_an_own_refiner_improves_on_the_lattice(output):
    table = rows(output("05_new_refiner.py"), r"^([\w-]+) +SOLVED +\d+ +(-?[\d.]+)$")
    costs = dict(table)
    assert list(costs) == ["lattice", "coordinate-descent", "ipopt"]
    assert float(costs["coordinate-descent"]) < float(costs["lattice"])


def test_joint_travel_falls_as_its_weight_grows_and_grasps_remain(output):
    text = output("06_joint_travel_in_opti.py")
    planned = float(rows(text, r"least travel is ([\d.]+) rad")[0])
    table = rows(text, r"^ +[\d.]+ +([\d.]+) +(-?[\d.]+)   \[ *(\d+) +(\d+)\] +(True|False)$")
    travel, cost = ([float(row[k]) for row in table] for k in (0, 1))
    assert len(table) == 5
    assert travel[-1] < min(planned, travel[0])
    assert cost[0] <= min(cost) + 1e-3
    assert all(int(row[2]) > 0 and int(row[3]) > 0 and row[4] == "True" for row in table)


def test_exported_c_finds_what_ipopt_finds(output):
    text = output("07_export_to_c.py")
    first = float(rows(text, r"^iteration   0: J_seq = (-?[\d.]+)$")[0])
    by_c, by_ipopt = (float(rows(text, rf"^{name}.*J_seq = (-?[\d.]+) at")[0]) for name in ("C", "Ipopt"))
    assert by_c < first
    assert by_c == pytest.approx(by_ipopt, abs=2e-3)


def test_an_optimal_control_problem_puts_the_object_where_the_next_grasp_is(output):
    table = rows(output("08_pick_and_place.py"), r"^ +([\d.]+) +([\d.]+) +(-?[\d.]+) .*\[ *(\d+) +(\d+)\]$")
    weights, times, scores = (np.array([float(row[k]) for row in table]) for k in range(3))
    shared = np.array([[int(n) for n in row[3:]] for row in table])
    assert len(table) == 3 and weights[0] == 0
    assert (scores[1:] < scores[0] - 0.5).all() and (times[1:] < 1.1 * times[0]).all()
    assert (shared[1:].min(axis=1) > shared[0].min()).all()


def test_a_motion_is_replayed_in_a_simulator(output):
    offsets = [float(row) for row in rows(output("09_replay_in_mujoco.py"), r"the bottle lies ([\d.]+) mm")]
    assert len(offsets) >= 2 and max(offsets) < 5


def test_every_example_has_a_test_and_says_how_to_run_it():
    tested = Path(__file__).read_text(encoding="utf-8")
    for path in sorted(EXAMPLES.glob("*.py")):
        assert f'output("{path.name}"' in tested
        assert f"`python examples/{path.name}" in path.read_text(encoding="utf-8")
