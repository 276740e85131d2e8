"""What makes the commands pleasant: completion, colours only where wanted, logs on demand, quiet pipes."""

import json
import logging
import os
import pty
import re
import subprocess
import sys

import numpy as np
import pytest
from command import ROOT, as_process, assert_refused, in_process

from regrasp_opt.cli import completion
from regrasp_opt.cli.app import app


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("regrasp-opt pre", {"prepare"}),
        ("regrasp-opt plan --object b", {"bottle"}),
        ("regrasp-opt plan --workcell nova2-r", {"nova2-r85", "nova2-r140"}),
        ("regrasp-opt plan --refiner langevin", {"langevin", "langevin-ipopt"}),
        ("regrasp-opt bench one", {"one-step"}),
        ("regrasp-opt export mug", {"mug-nova2-w"}),
    ],
)
def test_the_shell_completes_names(line, offered, capsys, monkeypatch):
    words = line.split()
    monkeypatch.setenv("_REGRASP_OPT_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", line)
    monkeypatch.setenv("COMP_CWORD", str(len(words) - 1))
    with pytest.raises(SystemExit):
        app(prog_name="regrasp-opt")
    assert set(capsys.readouterr().out.split()) == offered


def test_the_names_offered_are_those_that_are_known():
    from regrasp_opt.cli.bench import EXPERIMENTS
    from regrasp_opt.objects import OBJECT_NAMES
    from regrasp_opt.planning.recipes import REFINERS

    assert set(completion.OBJECTS) == set(OBJECT_NAMES)
    assert set(completion.EXPERIMENTS) == set(EXPERIMENTS)
    assert set(completion.REFINERS) == set(REFINERS)


def on_a_terminal(script, **environment):
    """Run Python code with stdout and stderr on a pseudo terminal; return what it shows."""
    parent, child = pty.openpty()
    variables = {**os.environ, "TERM": "xterm-256color", "PYTHONPATH": str(ROOT), **environment}
    done = subprocess.run([sys.executable, "-c", script], stdout=child, stderr=child, env=variables, check=False)
    os.close(child)
    shown = b""
    while True:
        try:
            part = os.read(parent, 65536)
        except OSError:  # the other side is closed and everything was read
            break
        if not part:
            break
        shown += part
    os.close(parent)
    assert done.returncode == 0, shown
    return shown.decode()


WORK = """
from regrasp_opt.cli.output import make_console, working
with working("planning"):
    pass
make_console().print("[bold green]solved[/]")
"""


def test_progress_and_colours_are_shown_on_a_terminal_and_can_be_turned_off():
    shown = on_a_terminal(WORK)
    assert "planning" in shown and "0:00:00" in shown and re.search(r"\x1b\[1;32m", shown)
    plain = on_a_terminal(WORK, NO_COLOR="1")
    assert "solved" in plain and not re.search(r"\x1b\[[\d;]*3\dm", plain)


def test_the_time_that_is_left_is_shown():
    shown = on_a_terminal(WORK.replace('"planning"', '"planning", 90.0'))
    assert re.search(r"at most (90|8\d) s left", shown)


def test_a_pipe_gets_the_result_only(tmp_path):
    outcome = as_process("plan", "--refiner", "lattice", cwd=tmp_path)
    assert outcome.code == 0 and outcome.err == "" and "\x1b" not in outcome.out


def test_verbose_logs_what_was_tried(capsys, caplog):
    with caplog.at_level(logging.INFO):
        assert in_process(capsys, "--verbose", "plan", "--refiner", "lattice", "--json").code == 0
    said = "\n".join(record.getMessage() for record in caplog.records)
    assert "200 grasps, 5 placements" in said and "tried num_regrasps 1" in said and "solved; seconds" in said


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("check",), "recomputed"),
        (("motion",), "solved; planned in"),
        (("show", "--candidates", "lattice", "--html", "page.html"), "candidates in 2 frames"),
    ],
)
def test_every_command_on_a_plan_logs_what_it_did(capsys, caplog, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    assert in_process(capsys, "plan", "--refiner", "lattice", "--out", "plan.json").code == 0
    with caplog.at_level(logging.INFO):
        assert in_process(capsys, "--verbose", arguments[0], "plan.json", *arguments[1:]).code == 0
    messages = [record.getMessage() for record in caplog.records if record.name.startswith("regrasp_opt")]
    assert re.match(r"regrasp-opt [\d.]+, Python 3\.\d+\.\d+ on ", messages[0])
    assert any(said in message for message in messages)
    assert re.fullmatch(r"took [\d.]+ s", messages[-1])


@pytest.mark.parametrize("command", ["plan", "prepare", "check", "motion", "show", "export", "bench"])
def test_every_help_has_an_example(capsys, command):
    assert f"regrasp-opt {command} " in re.sub(
        r"\s+", " ", in_process(capsys, command, "--help").out.split("Usage:")[1][40:]
    )


def test_show_writes_a_page(capsys, tmp_path):
    plan, page = tmp_path / "plan.json", tmp_path / "page.html"
    assert in_process(capsys, "plan", "--refiner", "lattice", "--out", plan).code == 0
    outcome = in_process(capsys, "show", plan, "--html", page)
    assert (outcome.code, outcome.out, outcome.err) == (0, f"written: {page}\n", "")
    assert "bottle in nova2-w" in page.read_text("utf-8")
    assert in_process(capsys, "show", tmp_path / "none.json").code == 2
    assert_refused(in_process(capsys, "show", plan, "--motion", plan, "--html", page), "is not a motion of schema")


def test_show_writes_candidates_and_plots(capsys, tmp_path):
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    plan, page, plots = (tmp_path / name for name in ("plan.json", "page.html", "plots"))
    assert in_process(capsys, "plan", "--out", plan).code == 0
    asked = ("--candidates", "ipopt", "--html", page, "--plots", plots, "--json")
    outcome = in_process(capsys, "show", plan, *asked)
    assert outcome.code == 0 and outcome.err == ""
    drawn = sorted(str(path) for path in plots.iterdir())
    assert outcome.data == {"html": str(page), "plots": outcome.data["plots"]}
    assert (
        sorted(outcome.data["plots"])
        == drawn
        == [str(plots / f"{n}.png") for n in ("candidates", "landscape-1", "poses")]
    )
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in plots.iterdir())
    held = json.loads(re.search(r'type="application/json">(.*?)</script>', page.read_text("utf-8"), re.S)[1])
    assert held["candidates"]["accepted"] >= 0 and held["candidates"]["labels"][-1].startswith("ipopt, refined")
    assert_refused(in_process(capsys, "show", plan, "--candidates", "newton", "--html", page), "ipopt")


def test_show_writes_a_page_of_a_motion(capsys, tmp_path):
    plan, motion, page = (tmp_path / name for name in ("plan.json", "motion.json", "page.html"))
    assert in_process(capsys, "plan", "--refiner", "lattice", "--out", plan).code == 0
    assert in_process(capsys, "motion", plan, "--out", motion).code == 0
    assert in_process(capsys, "show", plan, "--motion", motion, "--html", page).code == 0
    held = json.loads(re.search(r'type="application/json">(.*?)</script>', page.read_text("utf-8"), re.S)[1])
    seconds = sum(s["times"][-1] for s in json.loads(motion.read_text("utf-8"))["segments"])
    assert held["seconds"] == pytest.approx(seconds)
    assert len(held["steps"]) == np.ceil(25 * seconds) + 1
    assert {"move 0: reach", "move 0: transfer", "move 1: retreat"} <= {step["label"] for step in held["steps"]}
    other = tmp_path / "other.json"
    assert in_process(capsys, "plan", "--refiner", "lattice", "--seed", 5, "--out", other).code == 0
    assert_refused(in_process(capsys, "show", other, "--motion", motion, "--html", page), "is not a motion of the plan")
