"""`bench motion` at a size of seconds."""

from oracles.motions import verify_motion

from regrasp_opt.benchmarks.comparisons import motion
from regrasp_opt.benchmarks.harness.report import write_report
from regrasp_opt.benchmarks.harness.session import Session


def test_motions_are_measured_and_kept(tmp_path, monkeypatch):
    monkeypatch.setattr(motion, "PAIRS", {True: 1})
    session = Session(tmp_path, quick=True, names=("mug",), jobs=1, quiet=True)
    report = motion.run_motion(session)
    summary = write_report(report, tmp_path / report.name)
    assert summary["errors"] == [] and all(table["rows"] or table["note"] for table in summary["tables"])
    (row,) = report.rows
    assert row["solved"] and row["first_moves"] and row["moves"]
    (saved,) = (tmp_path / "motion" / "motions").iterdir()
    assert verify_motion(saved) == []
    assert 0 < row["duration"] < row["stopping"]
    assert row["seconds"] >= row["pose_seconds"] > 0
    assert motion.run_motion(session).rows == report.rows
