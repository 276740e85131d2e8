"""`show` and `bench --plots`: what is drawn of which plan and experiment, and the live view until Ctrl-C."""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from command import assert_refused, in_process

from regrasp_opt.benchmarks.harness.report import Report
from regrasp_opt.cli.plots import write_bench_plots, write_plan_plots
from regrasp_opt.errors import OptionError
from regrasp_opt.motion import MotionPlan, MotionStatus
from regrasp_opt.planning import RegraspPlan, solve_sequence
from regrasp_opt.planning.tasks import random_task


@pytest.fixture(scope="module")
def path(bottle_problem, tmp_path_factory):
    """The file of a plan with one regrasp."""
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(bottle_problem, task.start, task.goal, "lattice")
    assert plan.num_regrasps == 1
    file = tmp_path_factory.mktemp("show") / "plan.json"
    plan.save(file)
    return file


@pytest.fixture
def viewers(monkeypatch):
    """Put a viewer in the place of the live one, whose user presses Ctrl-C at once; return those that were opened."""
    opened = []

    class Viewer:
        def __init__(self, scene, port):
            self.scene, self.url, self.stopped = scene, f"http://localhost:{port}", False
            opened.append(self)

        def wait(self):
            raise KeyboardInterrupt

        def stop(self):
            self.stopped = True

    monkeypatch.setitem(sys.modules, "regrasp_opt.viz.viewer", SimpleNamespace(PlanViewer=Viewer))
    return opened


def test_the_live_view_is_served_until_it_is_interrupted(path, viewers, capsys):
    outcome = in_process(capsys, "show", path, "--port", 8123)
    assert (outcome.code, outcome.out) == (0, "")
    assert outcome.err == "open http://localhost:8123 in a browser; end with Ctrl+C\n"
    assert in_process(capsys, "show", path, "--port", 8124, "--json").data == {"url": "http://localhost:8124"}
    assert [viewer.stopped for viewer in viewers] == [True, True]
    assert viewers[0].scene.title.startswith("bottle in nova2-w")


def test_a_motion_that_was_not_found_cannot_be_shown(path, tmp_path, capsys):
    plan = RegraspPlan.load(path)
    motion = tmp_path / "motion.json"
    MotionPlan(MotionStatus.NO_MOTION, "transition 0: a wall", plan, (), *[np.ones(6)] * 2, 0.0).save(motion)
    page = tmp_path / "page.html"
    outcome = in_process(capsys, "show", path, "--motion", motion, "--html", page)
    assert_refused(outcome, "there is no motion to show in")
    assert "a wall" in outcome.err and not page.exists()


def test_plots_alone_are_written_without_a_page(path, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    outcome = in_process(capsys, "show", path, "--plots", tmp_path / "plots", "--json")
    names = ["landscape-1.png", "poses.png"]
    assert outcome.data == {"html": None, "plots": [str(tmp_path / "plots" / name) for name in names]}


def test_plans_without_a_cost_or_a_pose_have_no_plots(path, bottle_problem, tmp_path, monkeypatch):
    plan = RegraspPlan.load(path)
    monkeypatch.setattr("regrasp_opt.planning.problem_data.find_arm_energy", lambda _: None)
    with pytest.raises(OptionError, match="needs an energy; run 'regrasp-opt prepare WORKCELL' first"):
        write_plan_plots(replace(plan, problem=replace(plan.problem, model_folder=None)), None, tmp_path / "plots")
    direct = solve_sequence(bottle_problem, plan.poses[0], plan.poses[0])
    with pytest.raises(OptionError, match="no intermediate pose whose cost could be plotted"):
        write_plan_plots(direct, None, tmp_path / "plots")
    assert not (tmp_path / "plots").exists()


def report(name, rows):
    return Report(name, name, "", (), rows, settings={"time limit [s]": 10.0})


def test_curves_over_time_are_drawn_of_our_planner_or_of_all_that_are_compared(tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    rows = [
        {"object": "mug", "planner": planner, "solved": solved, "first_verified": 0.5 if solved else None}
        for planner, solved in (("ours", True), ("ours", False), ("paper's method", False))
    ]
    for name in ("multi-step", "refiners"):
        folder = tmp_path / name
        assert write_bench_plots(report(name, [*rows, {"object": "x", "error": "none"}]), folder) == [
            folder / "anytime.png"
        ]
        assert (folder / "anytime.png").read_bytes().startswith(b"\x89PNG")
    unsolved = [row | {"solved": False} for row in rows]
    assert write_bench_plots(report("refiners", unsolved), tmp_path / "none") == []
    assert write_bench_plots(report("one-step", rows), tmp_path / "none") == []
    assert not (tmp_path / "none").exists()
