"""`prepare` and `bench` killed and interrupted at random moments: files must stay whole, and the next run resume.

A killed process is started again on the same folders until it has been killed often enough, and then left to finish.
After every kill each file that a later run would read is opened; in the end the results must be those of a run that
nobody disturbed. An interrupted process must end by itself, and soon.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open

from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.files import UNREADABLE_ARRAYS

GRACE = 60.0
"""Seconds after which an interrupted process that still runs is killed."""
_LOAD = "from regrasp_opt.cli import main; main()"
_BENCH = """
from functools import partial
from regrasp_opt.cli import interrupts, main
interrupts.install()
try:
    from regrasp_opt.benchmarks.harness import session
    from regrasp_opt.benchmarks.harness.oracle import Resolution
    session.QUICK_GRID = Resolution(0.1, 6)
    session.Session = partial(session.Session, names=("bottle",))
    main()
except KeyboardInterrupt:
    interrupts.leave(interrupts.conclude())
"""


@dataclass(frozen=True)
class Job:
    """A command; ``{}`` in its arguments stands for the folder. Signals are sent within its first `seconds`."""

    arguments: tuple[str, ...]
    seconds: float


PREPARE = "prepare", "nova2-w", "--object", "pentagon"
JOBS = {
    "prepare": Job(
        (_LOAD, "prepare", "nova2-w", "--object", "pentagon", "--samples", "2000", "--grasps", "60", "--jobs", "2"),
        25.0,
    ),
    "bench": Job((_BENCH, "bench", "one-step", "--quick", "--jobs", "1", "--out", "{}/results"), 20.0),
}
"""The commands by the name under which they are reported; `bench` is `one-step` on one object and a coarse grid."""


def start(job: Job, folder: Path) -> subprocess.Popen[str]:
    """Start `job` in a process group of its own, with `folder` for its data folder and results."""
    command = [sys.executable, "-c", *(text.replace("{}", str(folder)) for text in job.arguments)]
    environment = {**os.environ, "REGRASP_OPT_HOME": str(folder / "home")}
    folder.mkdir(parents=True, exist_ok=True)
    return subprocess.Popen(
        command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def finish(job: Job, folder: Path) -> str:
    """Run `job` to its end; return the last line on stderr if it failed, else nothing."""
    child = start(job, folder)
    _, errors = child.communicate()
    return (errors.strip().splitlines() or [f"exit {child.returncode}"])[-1] if child.returncode else ""


def results(folder: Path) -> dict[str, str]:
    """Return a hash of each result below `folder`, without what differs between runs: times, dates, caches."""
    found = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.name == "rows.csv":
            lines = [line.split(",") for line in path.read_text("utf-8").splitlines()]
            kept = [i for i, title in enumerate(lines[0]) if "seconds" not in title]
            found[name] = hashlib.sha256(repr([[line[i] for i in kept] for line in lines]).encode()).hexdigest()
        elif path.is_file() and "models" in path.parts and path.suffix in (".npz", ".safetensors"):
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


def half_files(folder: Path) -> list[str]:
    """Return the files below `folder` that a later run would read and cannot; temporary ones have a dot in front."""
    paths = [path for path in sorted(folder.rglob("*")) if path.is_file()]
    visible = [path for path in paths if not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    return [str(path.relative_to(folder)) for path in visible if not _is_whole(path)]


def _is_whole(path: Path) -> bool:
    try:
        if path.suffix in (".npz", ".npy"):
            loaded: Any = np.load(path, allow_pickle=False)
            _ = [loaded[name] for name in loaded.files] if path.suffix == ".npz" else loaded
        elif path.suffix == ".safetensors":
            with safe_open(path, "numpy") as file:
                _ = [file.get_tensor(name) for name in file.keys()]  # noqa: SIM118 (not a mapping)
        elif path.suffix == ".json":
            json.loads(path.read_text("utf-8"))
    except (*UNREADABLE_ARRAYS, SafetensorError):
        return False
    return True


def kill_rows(name: str, seed: int, first: int, kills: int) -> list[Row]:
    """Kill the job `name` of `JOBS` at `kills` random moments of its undisturbed time, and return one row about it.

    Parameters
    ----------
    first : int
        Number of the first of these kills in the campaign.

    Returns
    -------
    list of Row
        ``kills``; ``half_files`` that were found after them; ``failed``, runs that were left alone and did not succeed;
        ``different``, those whose results were not those of an undisturbed run; ``left_over`` temporary files of killed
        runs; ``examples`` in words.
    """
    job, rng = JOBS[name], np.random.default_rng([seed, 70, len(name), first])
    counts = {"kills": 0, "half_files": 0, "failed": 0, "different": 0, "left_over": 0}
    bad: list[str] = []
    with tempfile.TemporaryDirectory() as place:
        alone, folder = Path(place) / "alone", Path(place) / "disturbed"
        began = time.perf_counter()
        bad += [text for text in [finish(job, alone)] if text]
        whole = time.perf_counter() - began
        expected = {name.replace(str(alone), ""): value for name, value in results(alone).items()}
        while counts["kills"] < kills:
            if _killed(start(job, folder), float(rng.uniform(0.0, whole))):
                counts["kills"] += 1
                halves = half_files(folder)
                counts["half_files"] += len(halves)
                bad += halves
            else:
                _judge(job, folder, expected, counts, bad)
        _judge(job, folder, expected, counts, bad)
    return [{**counts, "examples": "; ".join(bad[:3])}]


def _killed(child: subprocess.Popen[str], delay: float) -> bool:
    """Return whether `child` still ran after `delay` [s]; it and its workers are killed then."""
    try:
        child.communicate(timeout=delay)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        child.communicate()
        return True
    return False


def _judge(job: Job, folder: Path, expected: dict[str, str], counts: dict[str, int], bad: list[str]) -> None:
    """Let the job finish in `folder`, compare the results, and clear the folder."""
    failure = finish(job, folder)
    counts["failed"] += bool(failure)
    found = results(folder)
    if not failure and found != expected:
        counts["different"] += 1
        bad.append("other results: " + ", ".join(sorted(set(found.items()) ^ set(expected.items()))[0]))
    counts["left_over"] += sum(path.name.startswith(".") for path in folder.rglob("*"))
    bad += [failure] if failure else []
    shutil.rmtree(folder)


def signal_rows(name: str, number: int, seed: int, count: int) -> list[Row]:
    """Send the signal `number` to the job `name` at `count` random moments, and return one row about it.

    Returns
    -------
    list of Row
        ``sent``; ``slowest``, the longest time until a process had ended [s]; ``late``, those that took more than 2 s;
        ``codes``, the exit codes; ``half_files``; ``tracebacks``, those that ended with one.
    """
    job, rng = JOBS[name], np.random.default_rng([seed, 71, number, len(name)])
    seconds, codes, halves, tracebacks = [], [], 0, 0
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "disturbed"
        for _ in range(count):
            child = start(job, folder)
            time.sleep(float(rng.uniform(1.0, job.seconds)))
            if child.poll() is None:
                began = time.perf_counter()
                os.killpg(child.pid, number) if number == signal.SIGINT else child.send_signal(number)
                _, errors = _ended(child)
                seconds.append(time.perf_counter() - began)
                codes.append(child.returncode)
                tracebacks += "Traceback" in errors
            else:
                child.communicate()
            halves += len(half_files(folder))
    return [
        {
            "sent": len(seconds),
            "slowest": round(max(seconds, default=0.0), 2),
            "late": sum(s > 2.0 for s in seconds),
            "codes": ", ".join(map(str, sorted(set(codes)))),
            "half_files": halves,
            "tracebacks": tracebacks,
        }
    ]


def _ended(child: subprocess.Popen[str]) -> tuple[str, str]:
    try:
        return child.communicate(timeout=GRACE)
    except subprocess.TimeoutExpired:
        os.killpg(child.pid, signal.SIGKILL)
        return child.communicate()
