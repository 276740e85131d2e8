"""`bench arms` at a size of seconds, and what its tables tell."""

from dataclasses import replace

import pytest

from regrasp_opt.benchmarks.comparisons import arms
from regrasp_opt.benchmarks.comparisons.arms import QUICK, arm_tables, run_arms
from regrasp_opt.benchmarks.harness.report import write_report
from regrasp_opt.benchmarks.harness.session import Session
from regrasp_opt.planning import arm_energy, problem


@pytest.mark.filterwarnings("ignore")
def test_an_arm_is_trained_for_plans_and_moves(tmp_path, monkeypatch):
    tiny = replace(QUICK, truth=60, pool=30, checks=500, poses=12_000)
    monkeypatch.setattr(arms, "QUICK", tiny)
    monkeypatch.setattr(arm_energy, "UNSEEN_POSES", 10)
    monkeypatch.setattr(problem, "DEFAULT_GRASPS", 50)
    session = Session(tmp_path, quick=True, names=("pentagon",), jobs=1, quiet=True)
    report = run_arms(session)
    arm, pair = report.rows
    assert (arm["robot"], arm["tool"], arm["joints"]) == ("iiwa7", "w", 7) and "locked" in arm["solver"]
    assert arm["training"] > 0 and arm["checks"] > 0 and arm["branches"] > 6
    assert 0 < arm["least_ap"] <= arm["ap"] <= 1
    assert pair["status"] in ("solved", "not_found", "time_limit") and pair["minimum"] is not None
    assert write_report(report, tmp_path / "arms")["rows"] == 2
    assert run_arms(session).rows == report.rows  # read from the files of the first run


def test_tables_tell_what_has_a_plan_and_a_motion():
    def plan(solved, N, first, moves, seconds):
        pair = {"workcell": "z1-w", "object": "mug", "pair": "z1-w/mug/any/0", "minimum": 1, "status": "x"}
        motion = {"first_moves": first, "moves": moves, "motion_seconds": 2.0, "reason": "" if first else "no way"}
        return {**pair, "solved": solved, "num_regrasps": N, "seconds": seconds, "processor": 0.1, **motion}

    rows = [
        {"workcell": "z1-w", "joints": 6, "solver": "analytic", "branches": 3.46, "checks": 12345.0, "training": 21.4,
         "ap": 0.98765, "least_ap": None, "poses": 9},
        plan(True, 1, True, True, 0.1),
        plan(True, 2, True, True, 0.3),
        plan(True, 1, False, True, 0.2),
        {"workcell": "z1-w", "pair": "p", "minimum": 2, "status": "not_found", "solved": False, "num_regrasps": None,
         "seconds": 9.0, "processor": 8.0},
        {"workcell": "z1-w", "object": "mug", "error": "no pair"},
    ]  # fmt: skip
    trained, plans, missed = arm_tables(rows)
    assert trained.rows == (("z1-w", 6, "analytic", 3.5, 12300, 21.0, 0.9877, None),)
    assert plans.rows == (("z1-w", 4, 75.0, 66.7, 0.2, 0.29, 0.1, 66.7, 100.0, 2.0),)
    pair = "z1-w/mug/any/0"
    assert missed.rows == (
        (pair, "x", 2, 1, None, "yes"),
        (pair, "x", 1, 1, "no way", "yes"),
        ("p", "not_found", None, 2, None, "no"),
    )
