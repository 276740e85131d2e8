"""A full disk, folders that cannot be written, and two processes at once on one cache."""

import json
import os
import subprocess
import sys

from command import ROOT, as_process, assert_refused, in_process

FULL_DISK = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
from regrasp_opt.cli import main
main()
"""

PREPARE = "prepare", "nova2-w", "--object", "pentagon"


def command(script, *arguments, home):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "REGRASP_OPT_HOME": str(home)}
    environment.pop("COVERAGE_PROCESS_CONFIG", None)  # its data would not fit onto the full disk either
    return subprocess.Popen(
        [sys.executable, "-c", script, *map(str, arguments)], env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip


def test_a_full_disk_is_one_line_and_keeps_the_old_plan(tmp_path):
    out = tmp_path / "plan.json"
    out.write_text("old", encoding="utf-8")
    child = command(FULL_DISK, "plan", "--out", out, home=tmp_path / "home")
    said, errors = child.communicate()
    assert child.returncode == 2 and said == "", errors
    assert errors == f"error: File too large: {out}\n"
    assert out.read_text("utf-8") == "old"
    assert [path.name for path in tmp_path.rglob("*") if path.is_file()] == ["plan.json"]


def test_a_cache_that_cannot_be_written_is_no_error_for_a_plan_but_is_for_prepare(tmp_path, monkeypatch):
    blocker = tmp_path / "file"
    blocker.write_text("kept", encoding="utf-8")
    monkeypatch.setenv("REGRASP_OPT_HOME", str(blocker / "home"))
    assert as_process("plan", cwd=tmp_path).code == 0
    assert_refused(
        as_process(
            "prepare", "nova2-w", "--object", "pentagon", "--samples", 300, "--grasps", 20, "--jobs", 1, cwd=tmp_path
        ),
        "file",
    )
    assert blocker.read_text("utf-8") == "kept" and list(tmp_path.iterdir()) == [blocker]


def test_two_processes_on_one_fresh_cache_make_the_same_plan(tmp_path, capsys):
    arguments = ("plan", "--object", "mug", "--seed", "3", "--json")
    main = "from regrasp_opt.cli import main; main()"
    children = [command(main, *arguments, home=tmp_path) for _ in range(2)]
    plans = []
    for child in children:
        said, errors = child.communicate()
        assert child.returncode == 0 and errors == ""
        plans.append(json.loads(said))
    plans.append(in_process(capsys, *arguments).data)
    assert all(plan.pop("timings") for plan in plans)
    assert plans[0] == plans[1] == plans[2]
