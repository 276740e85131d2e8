"""`show`: what is drawn of which plan, and the page that is served until Ctrl-C."""

import socket
import threading
from dataclasses import replace
from urllib.request import urlopen

import numpy as np
import pytest
from command import assert_refused, in_process

from regrasp_opt.cli import show
from regrasp_opt.errors import OptionError
from regrasp_opt.motion import MotionPlan, MotionStatus
from regrasp_opt.planning import RegraspPlan, solve_sequence
from regrasp_opt.planning.tasks import random_task
from regrasp_opt.viz.plots import write_plan_plots


@pytest.fixture(scope="module")
def path(bottle_problem, tmp_path_factory):
    """The file of a plan with one regrasp."""
    task = random_task(bottle_problem, np.random.default_rng(0), needs_regrasp=True)
    plan = solve_sequence(bottle_problem, task.start, task.goal, "lattice")
    assert plan.num_regrasps == 1
    file = tmp_path_factory.mktemp("show") / "plan.json"
    plan.save(file)
    return file


def visit(monkeypatch, seen):
    """Let a browser open what is served, and its user press Ctrl-C then."""

    def once(server):
        answers = threading.Thread(target=server.handle_request)
        answers.start()
        with urlopen(f"http://127.0.0.1:{server.server_port}") as answer:
            seen.append((server.server_address, answer.headers["Content-Type"], answer.read().decode("utf-8")))
        answers.join()
        raise KeyboardInterrupt

    monkeypatch.setattr(show.ThreadingHTTPServer, "serve_forever", once)


def test_the_page_is_served_to_this_machine_until_it_is_interrupted(path, tmp_path, monkeypatch, capsys):
    seen = []
    visit(monkeypatch, seen)
    with socket.create_server(("127.0.0.1", 0)) as busy:
        taken = busy.getsockname()[1]
        outcome = in_process(capsys, "show", path, "--port", taken, "--json")
    [((host, port), kind, page)] = seen
    assert (outcome.code, outcome.data) == (0, {"url": f"http://127.0.0.1:{port}"}) and port != taken
    assert outcome.err == f"open http://127.0.0.1:{port} in a browser; end with Ctrl+C\n"
    assert host == "127.0.0.1" and kind == "text/html"
    assert in_process(capsys, "show", path, "--html", tmp_path / "page.html").code == 0
    assert page == (tmp_path / "page.html").read_text("utf-8")
    outcome = in_process(capsys, "show", path, "--port", port)
    assert (outcome.code, outcome.out) == (0, "") and seen[1][0] == (host, port)


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
