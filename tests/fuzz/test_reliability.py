"""The reliability campaign in small: damage is seeded, outcomes are told apart, figures are those of the rows."""

import json
from pathlib import Path

import numpy as np
import pytest
import typer
from verifying import plan_verifier

from fuzz import fuzzing, targets
from fuzz.faults import JOBS, Job, finish, half_files, kill_rows, results
from fuzz.fuzzing import fuzz_rows, read_once
from fuzz.tables import branch_coverage, mutants, reliability_tables
from fuzz.targets import TARGETS, Target, case
from fuzz.trials import choose_pairs, trial_rows, write_obstacles
from regrasp_opt import RegraspProblem
from regrasp_opt.benchmarks.harness.instances import PosePool
from regrasp_opt.cli import check as check_command
from regrasp_opt.errors import MeshError
from regrasp_opt.scene import load_workcell

SLOWLY_READ = ("plan", "motion", "command line")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return one folder for all good files, so that each target's are made once."""
    return tmp_path_factory.mktemp("targets")


@pytest.mark.parametrize("name", TARGETS)
def test_readers_take_or_refuse_damaged_files(name, folder):
    for number in range(6 if name in SLOWLY_READ else 12):
        suffix, content = case(name, 1, number, folder)
        assert (suffix, content) == case(name, 1, number, folder)
        outcome = read_once(name, suffix, content, folder)
        assert outcome in ("read", "refused"), (number, outcome)


@pytest.mark.parametrize("name", [name for name in TARGETS if name != "command line"])
def test_undamaged_files_are_read(name, folder):
    for suffix, content in targets.seeds(name, folder):
        assert read_once(name, suffix, content, folder) == "read"


def test_command_lines_are_run_among_their_files(folder):
    lines = {content: json.loads(content) for _, content in targets.seeds("command line", folder)}
    begun = {content: read_once("command line", ".json", content, folder) for content in lines}
    refused = [words for content, words in lines.items() if begun[content] == "refused"]
    assert set(begun.values()) == {"read", "refused"}
    assert {words[0] for words in refused} == {"bench", "plan", "prepare"}  # without meshes, a model, samples
    for words in refused:
        assert "part.stl" in words or "cell.toml" in words or words[0] == "bench", words


def spoil_the_plan():
    Path("plan.json").write_text("", encoding="utf-8")
    raise MeshError("no")


def end(code):
    raise typer.Exit(code)


@pytest.mark.parametrize(
    ("act", "said"),
    [
        (lambda: 1 // 0, "internal error"),
        (lambda: Path("unnamed").touch(), "changed ['unnamed']"),
        (spoil_the_plan, "changed ['plan.json']"),
        (lambda: end(2), "is not an error"),
        (lambda: end(7), "exit 7"),
    ],
)
def test_what_goes_wrong_on_the_command_line_is_told_apart(act, said, tmp_path, monkeypatch):
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "plan.json").write_text("{}", encoding="utf-8")
    monkeypatch.setattr(check_command, "run_check", lambda plan, as_json: act())
    outcome = read_once("command line", ".json", b'["check", "plan.json"]', tmp_path)
    assert outcome.startswith("traceback: RuntimeError") and said in outcome


def test_what_goes_wrong_in_a_reader_is_told_apart(tmp_path, monkeypatch):
    def read(path):
        how = path.read_text("utf-8")
        if how == "refuse":
            raise MeshError("no")
        if how == "break":
            raise KeyError("a defect")
        if how == "harm":
            path.with_name("other").write_text("", encoding="utf-8")

    monkeypatch.setitem(TARGETS, "mesh", Target(read, lambda folder: [], ()))
    said = [read_once("mesh", ".stl", how.encode(), tmp_path) for how in ("take", "refuse", "break", "harm")]
    assert [text.split(":")[0] for text in said] == ["read", "refused", "traceback", "harmed"]
    assert "KeyError" in said[2] and not list(tmp_path.iterdir())


def test_files_that_kill_or_hang_the_reader_are_counted_and_the_others_read(monkeypatch):
    script = """
import os, sys, time, faulthandler
name, seed, first, count = sys.argv[1], *map(int, sys.argv[2:])
for number in range(first, first + count):
    faulthandler.dump_traceback_later(2.0, exit=True)
    if number == 12: os.abort()
    if number == 14: time.sleep(60)
    print('"read"', flush=True)
"""
    monkeypatch.setattr(fuzzing, "_WORK", script)
    [row] = fuzz_rows("mesh", 0, 10, 8)
    assert (row["inputs"], row["read"], row["crash"], row["hang"]) == (8, 6, 1, 1)
    assert row["examples"].startswith("12: crash") and "14: hang" in row["examples"]


def test_the_fuzzing_process_reports_every_file():
    [row] = fuzz_rows("pose", 3, 0, 15)
    assert row["read"] + row["refused"] == row["inputs"] == 15 and row["examples"] == ""


def test_the_planner_and_the_verifier_agree_on_suction_cups_and_obstacles(tmp_path, bottle_problem):
    path = write_obstacles(tmp_path / "cell.toml")
    cell = load_workcell(path)
    assert [shape.name for shape in cell.obstacles] == ["wall", "left post", "right post"]
    problem = RegraspProblem.load("bottle", cell, grasps=bottle_problem.grasps)
    T, wall = problem.pose(0, 0.1, 0.2, 0.4), problem.pose(0, 0.0, 0.45)
    verifier = plan_verifier(problem)
    assert not verifier.pose_problems(T) and "wall" in verifier.pose_problems(wall)[0]
    suction = RegraspProblem.load("bottle", "nova2-s1")
    for one, checked in ((problem, verifier), (suction, plan_verifier(suction))):
        ids = np.flatnonzero(one.feasible_grasps(T))[:4]
        found = one.checker.configurations(T, ids)
        assert len(ids)
        for g, q in zip(ids, found, strict=True):
            assert checked.grasp_problems(q[0], T, one.grasps.T_object_tcp[g], one.grasps.width[g]) == []


def test_trials_are_half_apart_and_their_plans_are_verified(bottle_problem):
    pool = PosePool.draw(bottle_problem, 0)
    instances = choose_pairs(pool, 6, np.random.default_rng(0), "bottle")
    apart = [
        not (bottle_problem.feasible_grasps(i.start) & bottle_problem.feasible_grasps(i.goal)).any() for i in instances
    ]
    assert apart[::2] == [True] * 3
    row, direct = trial_rows(bottle_problem, instances[2:4], 0)
    assert row["solved"] and row["num_regrasps"] >= 1 and row["wrong"] == ""
    assert row["low"] >= row["low_failed"] >= 0 and row["low"] > 0 and direct["solved"]


def test_half_files_are_found_and_temporary_ones_are_not(tmp_path):
    for name in ("a.json", "b.npz", "c.npy", "d.safetensors", ".e.json", "f.txt"):
        (tmp_path / name).write_bytes(b"{")
    assert half_files(tmp_path) == ["a.json", "b.npz", "c.npy", "d.safetensors"]


_STEPS = """
import sys, time
from pathlib import Path
from regrasp_opt.files import atomic_path
folder = Path(sys.argv[1])
for number in range(4):
    path = folder / "models" / f"{number}.npz"
    if not path.exists():
        time.sleep(0.05)
        with atomic_path(path) as temporary:
            import numpy; numpy.savez(temporary, a=numpy.arange(number))
"""


def test_kills_are_counted_and_the_results_compared(monkeypatch, tmp_path):
    job = Job((_STEPS, "{}"), 0.5)
    monkeypatch.setitem(JOBS, "prepare", job)
    [row] = kill_rows("prepare", 0, 0, 3)
    assert (row["kills"], row["half_files"], row["failed"], row["different"]) == (3, 0, 0, 0), row
    assert finish(job, tmp_path) == "" and sorted(results(tmp_path)) == [f"models/{n}.npz" for n in range(4)]
    assert "boom" in finish(Job(("raise SystemExit('boom')",), 1.0), tmp_path)


PLAN = {"part": "plans", "object": "mug", "workcell": "a", "low": 4, "low_failed": 1, "wrong": "", "status": "solved"}


def summary(rows):
    return {line[0]: line[1] for line in reliability_tables(rows)[0].rows}


def test_the_summary_counts_what_the_rows_hold(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [{**PLAN, "condition": "all grasps", "solved": True} for _ in range(3)]
    rows += [{**PLAN, "condition": "all grasps", "solved": False, "minimum": n} for n in (1, 9, None)]
    rows += [{**PLAN, "condition": "paper's energy", "solved": False, "minimum": 1}, {"object": "x", "error": "no"}]
    rows += [
        {"part": "files", "reader": "mesh", "inputs": 5, "read": 1, "refused": 3, "crash": 1, "examples": "3: crash"}
    ]
    rows += [{"part": "faults", "command": "bench", "signal": "SIGKILL", "kills": 7, "half_files": 0, "failed": 1}]
    rows += [{"part": "faults", "command": "bench", "signal": "SIGINT", "sent": 2, "slowest": 1.5, "half_files": 0}]
    found = summary(rows)
    assert found["planning problems tried"] == 7 and found["false positives: plans that one of the two refutes"] == 0
    assert found["false negatives: solvable on the exact grid, but not solved"] == 1
    assert found["false negatives, share of the solvable [%]"] == 25.0
    assert found["tracebacks, crashes, hangs, files harmed"] == 1
    assert found["damaged files and command lines tried"] == 5
    assert found["kills"] == 7 and found["half files, runs that did not recover, other results"] == 1
    assert found["longest time to end [s]"] == 1.5
    assert found["branch coverage [%]"] is None and found["mutants killed [%]"] is None
    assert summary([{**rows[0], "wrong": "x"}])["false positives: plans that one of the two refutes"] == 1
    assert "3: crash" in reliability_tables(rows)[2].note


def test_coverage_and_mutants_are_read_from_the_files_of_their_tools(tmp_path):
    coverage, counts = tmp_path / "coverage.json", tmp_path / "counts.json"
    coverage.write_text(json.dumps({"totals": {"num_branches": 8, "covered_branches": 6}}), encoding="utf-8")
    counts.write_text(json.dumps({"killed": 5, "timeout": 2, "survived": 2, "no_tests": 1}), encoding="utf-8")
    assert branch_coverage(coverage) == 75.0 and mutants(counts) == (10, 70.0)
    coverage.write_text("[]", encoding="utf-8")
    assert branch_coverage(coverage) is None and mutants(tmp_path / "none") == (None, None)
