"""The reliability campaign as a whole, in seconds: its tables say what its rows say, and a second run resumes."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import trimesh

from fuzz import faults, reliability, trials
from fuzz.faults import JOBS, Job, signal_rows
from fuzz.reliability import Sizes, main, run_reliability
from fuzz.targets import TARGETS
from fuzz.trials import Condition, workcells
from regrasp_opt.benchmarks.harness import session as session_module
from regrasp_opt.benchmarks.harness.oracle import Resolution
from regrasp_opt.benchmarks.harness.report import write_report
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.planning.problem import RegraspProblem

ROOT = Path(__file__).parents[2]
FEW = (Condition("20 grasps", 20), Condition("12 grasps", 12))
WRITES = """
import os, sys
with open(sys.argv[1] + "/.rows", "w") as file:
    file.write("pair,seconds\\na,1\\n")
os.replace(sys.argv[1] + "/.rows", sys.argv[1] + "/rows.csv")
"""
SLEEPS = "import sys, time; open(sys.argv[1], 'w').close(); time.sleep(600)"  # the file says that it is ready
SAYS_SO = f"""
import signal, sys
def leave(number, frame): sys.exit(128 + number)
signal.signal(signal.SIGTERM, leave); signal.signal(signal.SIGINT, leave)
{SLEEPS}
"""
TRACEBACK = f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {SLEEPS}"
STUBBORN = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {SLEEPS}"


@pytest.fixture
def session(tmp_path, monkeypatch):
    """A campaign of two trials on the bottle, files for one reader, and one job that is soon done."""
    monkeypatch.setattr(session_module, "QUICK_GRID", Resolution(0.15, 4))
    monkeypatch.setattr(reliability, "QUICK", Sizes(1, 3, 1, 1))
    monkeypatch.setattr(reliability, "CONDITIONS", FEW)
    monkeypatch.setattr(reliability, "TARGETS", {"pose": TARGETS["pose"]})
    monkeypatch.setattr(reliability, "JOBS", {"prepare": JOBS["prepare"]})
    monkeypatch.setitem(JOBS, "prepare", Job((WRITES, "{}"), 1.0))
    return Session(tmp_path, quick=True, names=("bottle",), jobs=1, quiet=True)


def columns(table):
    return [dict(zip(table.columns, row, strict=True)) for row in table.rows]


def of(rows, part):
    return [row for row in rows if row.get("part") == part]


def test_the_tables_say_what_the_rows_say_and_a_second_run_resumes(session):
    report = run_reliability(session)
    summary = write_report(report, session.folder / report.name)
    plans, [files], (kills, *signals) = (of(report.rows, part) for part in ("plans", "files", "faults"))
    assert summary["errors"] == [] and len(plans) + 1 + 1 + len(signals) == len(report.rows)

    head, plan_table, file_table, fault_table = report.tables
    told = {row["what"]: row["measured"] for row in columns(head)}
    assert told["planning problems tried"] == len(plans) == 2
    assert told["false positives: plans that one of the two refutes"] == 0
    assert all(row["wrong"] == "" for row in plans)
    assert told["damaged files and command lines tried"] == files["inputs"] == 3
    assert told["kills"] == kills["kills"] == 1
    assert told["half files, runs that did not recover, other results"] == 0

    lines = {line["condition"]: line for line in columns(plan_table)}
    assert list(lines) == ["20 grasps", "12 grasps"]
    for row in plans:
        assert lines[row["condition"]]["solved"] == row["solved"]
        assert lines[row["condition"]]["low-energy candidates"] == row["low"]
        assert len(report.instances[row["pair"]]) == 16
    assert [line["read"] + line["refused"] for line in columns(file_table)] == [3]
    assert [line["signal"] for line in columns(fault_table)] == ["SIGKILL", "SIGINT", "SIGTERM"]

    again = run_reliability(session)
    assert again.rows == report.rows and again.instances == report.instances


def test_a_trial_without_a_plan_is_asked_of_the_oracle(session, monkeypatch):
    monkeypatch.setattr(reliability, "TARGETS", {})
    monkeypatch.setattr(reliability, "JOBS", {})
    conditions = (Condition("20 grasps", 20), Condition("2 grasps", 2), Condition("paper's energy", 20, "paper"))
    monkeypatch.setattr(reliability, "CONDITIONS", conditions)
    monkeypatch.setattr(trials, "TIME_LIMIT", 1e-9)  # no trial that needs a regrasp has the time for it
    report = run_reliability(replace(session, seed=2))
    rows = {row["condition"]: row for row in report.rows}
    assert not any(row["solved"] for row in rows.values())
    assert rows["20 grasps"]["status"] == "time_limit" and rows["20 grasps"]["minimum"] == 1
    assert rows["2 grasps"]["minimum"] is None  # two grasps that no pose of the grid joins
    assert "minimum" not in rows["paper's energy"]
    lost = {line["condition"]: line["false no plan"] for line in columns(report.tables[1])}
    assert lost == {"20 grasps": 1, "2 grasps": 0, "paper's energy": None}


def test_an_object_that_cannot_be_prepared_is_a_row_and_the_rest_runs_on(session, tmp_path, monkeypatch):
    monkeypatch.setattr(reliability, "TARGETS", {})
    monkeypatch.setattr(reliability, "JOBS", {})
    monkeypatch.setattr(reliability, "CONDITIONS", FEW[:1])
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    trimesh.creation.box((0.4, 0.4, 0.4)).export(meshes / "crate.stl")  # no finger goes around it
    report = run_reliability(replace(session, objects=meshes))
    [error] = report.errors
    assert (error["object"], error["workcell"]) == ("crate.stl", "nova2-w") and "grasp" in error["error"]
    assert [row["object"] for row in of(report.rows, "plans")] == ["bottle"]


def test_a_full_campaign_has_a_workcell_with_obstacles(tmp_path):
    assert [name for name, _ in workcells(tmp_path, True)] == ["nova2-w"]
    cells = dict(workcells(tmp_path, False))
    assert list(cells) == [*trials.WORKCELLS, trials.OBSTACLES]
    assert len(cells[trials.OBSTACLES].obstacles) == 3


def test_few_grasps_are_drawn_of_all(bottle_problem):
    rng = session_module.Session("", names=()).rng(1)
    few, ids = trials.reduced(bottle_problem, Condition("5 grasps", 5), rng)
    assert len(few.grasps) == len(set(ids)) == 5 and isinstance(few, RegraspProblem)
    assert (few.grasps.T_object_tcp == bottle_problem.grasps.T_object_tcp[ids]).all()


@pytest.fixture
def signal_after(monkeypatch):
    """Return a function that lets signals be sent as soon as a child has done something, at no set time."""
    children, start = [], faults.start

    def started(job, folder):
        children.append(start(job, folder))
        return children[-1]

    def signal_after(done):
        def wait(seconds):
            while not done(children[-1]) and children[-1].poll() is None:
                time.sleep(0.01)

        monkeypatch.setattr(faults, "time", SimpleNamespace(sleep=wait, perf_counter=time.perf_counter))

    monkeypatch.setattr(faults, "start", started)
    return signal_after


@pytest.mark.parametrize(
    ("script", "number", "codes", "tracebacks"),
    [
        (SAYS_SO, signal.SIGTERM, "143", 0),
        (SAYS_SO, signal.SIGINT, "130", 0),
        (TRACEBACK, signal.SIGINT, "-2", 1),
        (STUBBORN, signal.SIGTERM, "-9", 0),
    ],
    ids=["SIGTERM", "SIGINT", "with a traceback", "killed after the grace"],
)
def test_how_a_command_ends_on_a_signal_is_told(script, number, codes, tracebacks, tmp_path, monkeypatch, signal_after):
    ready = tmp_path / "ready"
    signal_after(lambda child: ready.exists())
    monkeypatch.setattr(faults, "GRACE", 0.2 if script is STUBBORN else 60.0)
    monkeypatch.setitem(JOBS, "job", Job((script, str(ready)), 1.0))
    [row] = signal_rows("job", number, 0, 1)
    assert (row["sent"], row["codes"], row["tracebacks"], row["half_files"]) == (1, codes, tracebacks, 0)


def test_a_command_that_is_done_before_the_signal_is_not_counted_but_its_files_are_opened(monkeypatch, signal_after):
    signal_after(lambda child: child.poll() is not None)
    monkeypatch.setitem(JOBS, "job", Job(("import sys; open(sys.argv[1], 'w').write('{')", "{}/half.json"), 1.0))
    [row] = signal_rows("job", signal.SIGTERM, 0, 1)
    assert (row["sent"], row["slowest"], row["codes"], row["half_files"]) == (0, 0.0, "", 1)


def test_the_command_writes_its_page_and_refuses_a_folder_without_meshes(session, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(reliability, "Session", lambda folder, **options: replace(session, folder=folder))
    monkeypatch.setattr(reliability, "CONDITIONS", ())
    monkeypatch.setattr(reliability, "JOBS", {})
    assert main(["--quick", "--seed", "1", "--out", str(tmp_path / "results")]) == 0
    page = tmp_path / "results" / "reliability" / "reliability.md"
    assert f"written: {page}" in capsys.readouterr().out
    assert "This page is written by `python -m tests.fuzz.reliability`." in page.read_text("utf-8")
    assert "Command: `python -m tests.fuzz.reliability --quick`." in page.read_text("utf-8")
    monkeypatch.setattr(reliability, "Session", Session)
    assert main(["--objects", str(tmp_path / "none"), "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("error: ")


def test_it_runs_from_the_repository_and_its_readers_in_processes_of_their_own(tmp_path):
    code = "from tests.fuzz.fuzzing import fuzz_rows; [row] = fuzz_rows('pose', 0, 0, 2); print(row['inputs'])"
    for command in (["-m", "tests.fuzz.reliability", "--help"], ["-c", code]):
        done = subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True, check=True)
        assert "--objects" in done.stdout or done.stdout == "2\n"
