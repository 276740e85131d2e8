"""A seeded sample of mutants of eight layers, each run with `pytest -x` against the tests that reach its function.

    python tests/mutants.py --size 75 --jobs 2

mutmut makes the mutants. They are drawn and run here, because mutmut runs all of them, and all of its tests before each
start. Each mutant is tried in a forked process, with the tests beside its layer first, and of these the quickest first;
tests that would take longer than `BUDGET` in all are left out, so that a mutant counted as survived may be noticed by a
slow test. What is done is kept in ``mutants/``, and a second run goes on; a mutant is tried again when its function has
changed, one that survived also with ``--again``. The counts are written where `regrasp-opt bench reliability` reads
them.
"""

from __future__ import annotations

import argparse
import difflib
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mutmut.mutation import trampoline
from mutmut.mutation.file_mutation import mutate_file_contents

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "mutants"
LAYERS = ("connectivity", "energy", "feasibility", "grasps", "objects", "planning", "robots", "solvers")
BUDGET = 40.0
"""Seconds of tests that a mutant has to pass to survive."""
SLOW = "tests/planning/test_hundred_pairs.py"
Mutated = dict[str, Any]
"""A file with all its mutants: ``code``, ``names``, the lines (``spans``) and ``hashes`` of its functions."""
UNSEEN = ("survived", "no_tests")
KEPT, COUNTS = "sample.json", "counts.json"


def make_mutants() -> dict[str, tuple[Mutated, str]]:
    """Write the package with all mutants in it to `FOLDER`; return mutated file and layer by name of mutant."""
    shutil.rmtree(FOLDER / "regrasp_opt", ignore_errors=True)
    shutil.copytree(ROOT / "regrasp_opt", FOLDER / "regrasp_opt", ignore=shutil.ignore_patterns("__pycache__"))
    found: dict[str, tuple[Mutated, str]] = {}
    for layer in LAYERS:
        for path in sorted((FOLDER / "regrasp_opt" / layer).glob("*.py")):
            mutated = mutate(path.read_text("utf-8"))
            path.write_text(mutated["code"], encoding="utf-8")
            module = f"regrasp_opt.{layer}.{path.stem}"
            found |= {f"{module}.{name}": (mutated, layer) for name in mutated["names"]}
    return found


def mutate(source: str) -> Mutated:
    """Return what mutmut makes of a file, or made of it before."""
    kept = FOLDER / "made" / f"{hashlib.sha256(source.encode()).hexdigest()}.json"
    if not kept.exists():
        kept.parent.mkdir(exist_ok=True)
        made = mutate_file_contents("", source)
        spans = {name: (span.start, span.end) for name, span in made.line_span_by_function_name.items()}
        content = {"code": made.code, "names": [*made.mutant_names], "spans": spans}
        kept.write_text(json.dumps({**content, "hashes": {**made.hash_by_function_name}}), encoding="utf-8")
    return dict(json.loads(kept.read_text("utf-8")))


def function_of(mutant: str) -> str:
    """Return the qualified name under which mutmut's wrapper of the mutated function reports calls."""
    return mutant.partition("__mutmut_")[0]


def source_of(mutant: str, mutated: Mutated) -> tuple[str, str]:
    """Return the function's hash, and what the mutant changes in it as a diff."""
    name = mutant.rpartition(".")[2]
    original = function_of(name)
    lines = mutated["code"].splitlines()
    spans = [mutated["spans"][key] for key in (f"{original}__mutmut_orig", name)]
    before, after = (lines[start - 1 : end] for start, end in spans)
    return mutated["hashes"][original], "\n".join(difflib.unified_diff(before, after, lineterm="", n=1))


def started(work: Callable[[], int], cpu_seconds: int) -> int:
    """Return the id of a forked process that exits with what `work` returns."""
    pid = os.fork()
    if pid == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 5))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(10 * cpu_seconds)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        os._exit(work())
    return pid


def ended(pid: int) -> int:
    """Return the exit code of a process; negative where a signal ended it, such as a time limit."""
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def run_tests(tests: list[str], mutant: str = "", plugins: Any = ()) -> int:
    """Run pytest on `tests` in this process with one mutant, or none, in force."""
    trampoline.set_mutant_under_test(mutant)
    return int(pytest.main(["-x", "-q", "-p", "no:cacheprovider", f"--rootdir={ROOT}", *tests], plugins=plugins))


class Reached:
    """A pytest plugin that notes how long each test takes and which functions with mutants it calls."""

    def __init__(self) -> None:
        self.tests: dict[str, tuple[float, list[str]]] = {}
        self.calls: set[str] = set()
        self.seconds = 0.0
        trampoline.record_trampoline_hit = lambda name, caller=None: self.calls.add(name)

    def pytest_runtest_makereport(self, call: Any) -> None:
        self.seconds += call.duration

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        self.tests[nodeid] = (self.seconds, sorted(self.calls))
        self.seconds, self.calls = 0.0, set()


def measure(file: Path, kept: Path) -> None:
    """Run one test file without any mutant, and write what each of its tests reaches to `kept`."""

    def work() -> int:
        reached = Reached()
        code = run_tests([str(file)], "stats", [reached])
        if code == 0:
            kept.write_text(json.dumps(reached.tests), encoding="utf-8")
        return code

    if ended(started(work, 3600)) != 0:
        raise SystemExit(f"{file} does not pass without a mutant; mend that first")


def tests_by_function(has_time: Callable[[], bool]) -> dict[str, list[tuple[float, str]]]:
    """Return (seconds, test) of the tests beside the layers that reach each function, the quickest first."""
    found: dict[str, list[tuple[float, str]]] = {}
    for file in (file for layer in LAYERS for file in sorted((ROOT / "tests" / layer).glob("test_*.py"))):
        kept = FOLDER / f"{file.parent.name}-{file.stem}.json"
        if str(file.relative_to(ROOT)) == SLOW:
            continue
        if not kept.exists() or kept.stat().st_mtime < file.stat().st_mtime:
            if not has_time():
                raise SystemExit(f"out of time before {file} was run without a mutant; run this again")
            measure(file, kept)
        for test, (seconds, calls) in json.loads(kept.read_text("utf-8")).items():
            for name in calls:
                found.setdefault(name, []).append((seconds, test))
    return {name: sorted(tests) for name, tests in found.items()}


def within_budget(tests: list[tuple[float, str]], layer: str) -> tuple[list[str], float]:
    """Return the tests that a mutant of `layer` is run against, in their order, and the seconds that they take."""
    chosen, total = [], 0.0
    for seconds, test in sorted(tests, key=lambda item: not item[1].startswith(f"tests/{layer}/")):
        if not chosen or total + seconds <= BUDGET:
            chosen.append(test)
            total += seconds
    return chosen, total


def verdict(code: int, tests: list[str], limit: int) -> str:
    """Return what the exit code of a mutant's tests says."""
    # 4 or 5: pytest did not find the tests. A mutant that breaks the import of their files is killed by that;
    # where they are missing without the mutant as well, what is kept about them is out of date.
    if code in (4, 5) and ended(started(partial(run_tests, ["--collect-only", *tests]), limit)) != 0:
        raise SystemExit(f"pytest does not find all of {tests}; delete {FOLDER} and run this again")
    return "survived" if code == 0 else "timeout" if code < 0 else "killed"


def load_libraries() -> None:
    """Import what takes long once, before the forks."""
    import torch  # noqa: F401

    import regrasp_opt.planning.prepare
    import regrasp_opt.planning.sequence_nlp  # noqa: F401


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=75, help="mutants of each layer (default 75)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no mutant after this time")
    parser.add_argument("--jobs", type=int, default=1, help="mutants that are tried at a time")
    parser.add_argument("--layer", choices=LAYERS, action="append", help="this layer only; may be repeated")
    parser.add_argument("--again", action="store_true", help="try mutants that survived again")
    options = parser.parse_args()
    end = time.monotonic() + options.seconds
    os.chdir(ROOT)
    FOLDER.mkdir(exist_ok=True)
    mutants = make_mutants()
    sys.path.insert(0, str(FOLDER))
    os.environ["PYTHONPATH"] = str(FOLDER)
    load_libraries()

    kept = FOLDER / KEPT
    results = json.loads(kept.read_text("utf-8")) if kept.exists() else {}
    sample = []
    for layer in LAYERS:
        names = sorted(name for name, (_, its_layer) in mutants.items() if its_layer == layer)
        sample += random.Random(options.seed).sample(names, min(options.size, len(names)))
    reach = tests_by_function(lambda: time.monotonic() < end)
    running: dict[int, tuple[str, list[str], int]] = {}

    def note(name: str, result: str) -> None:
        code_hash, change = source_of(name, mutants[name][0])
        results[name] = {"hash": code_hash, "result": result, "change": change}
        kept.write_text(json.dumps(results, indent=1), encoding="utf-8")
        print(f"{result:9} {name}" + (f"\n{change}" if result in UNSEEN else ""), flush=True)

    def wait_for_one() -> None:
        pid, status = os.wait()
        name, tests, limit = running.pop(pid)
        note(name, verdict(os.waitstatus_to_exitcode(status), tests, limit))

    for name in sample:
        layer, before = mutants[name][1], results.get(name, {})
        done = before.get("hash") == source_of(name, mutants[name][0])[0]
        if (done and not (options.again and before["result"] in UNSEEN)) or layer not in (options.layer or LAYERS):
            continue
        tests, seconds = within_budget(reach.get(function_of(name), []), layer)
        if not tests:
            note(name, "no_tests")
            continue
        while len(running) >= options.jobs:
            wait_for_one()
        if time.monotonic() > end:
            break
        limit = 30 + 3 * int(seconds)
        running[started(partial(run_tests, tests, name), limit)] = name, tests, limit
    while running:
        wait_for_one()
    counted = [results[name]["result"] for name in sample if name in results]
    counts = {kind: counted.count(kind) for kind in ("killed", "timeout", "survived", "no_tests")}
    (FOLDER / COUNTS).write_text(json.dumps({**counts, "of": len(sample), "seed": options.seed}), encoding="utf-8")
    print(f"{len(counted)} of {len(sample)} mutants: {counts}")


if __name__ == "__main__":
    main()
