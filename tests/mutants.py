"""A seeded sample of mutants of eight layers, each tried against the tests that reach its function.

    python tests/mutants.py --size 75 --jobs 2

mutmut makes the mutants. They are drawn and run here, because mutmut runs all of them, and all of its tests before each
start. pytest collects the tests once; each mutant is then tried in a process forked from there, until a test fails:
those beside its layer first, and of these the quickest first. Tests beyond the budget are left out, so that a mutant
that survived may be noticed by a slow one: ``--again --budget 200`` tells. What is done is kept in ``mutants/``, and a
second run goes on; a mutant is tried again when its function has changed, one that survived also with ``--again``. The
counts are written where `regrasp-opt bench reliability` reads them.
"""

from __future__ import annotations

import argparse
import difflib
import gc
import hashlib
import itertools
import json
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from mutmut.mutation import trampoline
from mutmut.mutation.file_mutation import mutate_file_contents

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "mutants"
LAYERS = ("connectivity", "energy", "feasibility", "grasps", "objects", "planning", "robots", "solvers")
SLOW = "tests/planning/test_hundred_pairs.py"
ELSEWHERE = ("tests/cli/test_inspect.py",)
"""Tests of these layers that stand in other folders."""
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


class Processes:
    """Forked processes, so many at a time; each has a folder for its temporary files, which goes when it ends."""

    def __init__(self, jobs: int) -> None:
        self._jobs = jobs
        self._running: dict[int, tuple[Path, Callable[[int], None]]] = {}

    def start(self, work: Callable[[], int], cpu_seconds: int, then: Callable[[int], None]) -> None:
        """Run `work` in a fork, and call `then` with what it returns; negative where a limit ended it."""
        while len(self._running) >= self._jobs:
            self._wait()
        folder = Path(tempfile.mkdtemp(prefix="mutant-"))
        pid = os.fork()
        if pid == 0:
            os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
            resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 5))
            signal.signal(signal.SIGALRM, signal.SIG_DFL)
            signal.alarm(20 * cpu_seconds)
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, 1)
            os.dup2(null, 2)
            code = 1
            try:
                code = work()
            finally:
                os._exit(code)
        self._running[pid] = folder, then

    def finish(self) -> None:
        """Wait for all."""
        while self._running:
            self._wait()

    def _wait(self) -> None:
        pid, status = os.wait()
        folder, then = self._running.pop(pid)
        shutil.rmtree(folder, ignore_errors=True)
        then(os.waitstatus_to_exitcode(status))


class Campaign:
    """A pytest plugin that tries mutants instead of running the collected tests."""

    def __init__(self, options: argparse.Namespace, mutants: dict[str, tuple[Mutated, str]]) -> None:
        self.options, self.mutants = options, mutants
        self.end = time.monotonic() + options.seconds
        kept = FOLDER / KEPT
        self.results: dict[str, dict[str, str]] = json.loads(kept.read_text("utf-8")) if kept.exists() else {}
        self.calls: set[str] = set()

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        gc.collect()
        gc.freeze()  # what the forks share stays shared
        self.items = {item.nodeid: item for item in session.items}
        self.processes = Processes(self.options.jobs)
        self._measure_all()
        reach = self._reach()
        sample = self._sample()
        for name in sample:
            self._try(name, reach.get(function_of(name), []))
        self.processes.finish()
        counted = [self.results[name]["result"] for name in sample if name in self.results]
        counts = {kind: counted.count(kind) for kind in ("killed", "timeout", "survived", "no_tests")}
        content = json.dumps({**counts, "of": len(sample), "seed": self.options.seed})
        (FOLDER / COUNTS).write_text(content, encoding="utf-8")
        print(f"{len(counted)} of {len(sample)} mutants: {counts}")
        return True

    def _run(self, tests: list[str], mutant: str) -> Iterator[tuple[str, bool]]:
        """Run tests one after the other with a mutant in force, and yield each with whether all have passed so far."""
        trampoline.set_mutant_under_test(mutant)
        items = [self.items[test] for test in tests]
        for item, after in itertools.zip_longest(items, items[1:]):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=after)
            yield item.nodeid, item.session.testsfailed == 0

    def _measure_all(self) -> None:
        """Note how long each test takes and which functions it calls, for test files that are new."""
        by_file: dict[Path, list[str]] = {}
        for test, item in self.items.items():
            by_file.setdefault(item.path, []).append(test)
        for file, tests in by_file.items():
            kept = kept_for(file)
            if kept.exists() and kept.stat().st_mtime > file.stat().st_mtime:
                continue
            if time.monotonic() > self.end:
                pytest.exit(f"out of time before {file} was run without a mutant; run this again", 1)

            def check(code: int, file: Path = file) -> None:
                if code != 0:
                    pytest.exit(f"{file} does not pass without a mutant; mend that first", 1)

            self.processes.start(partial(self._measure, kept, tests), 3600, check)
        self.processes.finish()

    def _measure(self, kept: Path, tests: list[str]) -> int:
        trampoline.record_trampoline_hit = lambda name, caller=None: self.calls.add(name)
        found, began = {}, cpu_seconds()
        for test, good in self._run(tests, "stats"):
            if not good:
                return 1
            found[test] = cpu_seconds() - began, sorted(self.calls)
            began = cpu_seconds()
            self.calls.clear()
        kept.write_text(json.dumps(found), encoding="utf-8")
        return 0

    def _reach(self) -> dict[str, list[tuple[float, str]]]:
        """Return (seconds, test) of the tests that reach each function, the quickest first."""
        found: dict[str, list[tuple[float, str]]] = {}
        for file in {item.path for item in self.items.values()}:
            for test, (seconds, calls) in json.loads(kept_for(file).read_text("utf-8")).items():
                for name in calls:
                    found.setdefault(name, []).append((seconds, test))
        return {name: sorted(tests) for name, tests in found.items()}

    def _sample(self) -> list[str]:
        """Return the mutants of all layers by turns, so that a run that is cut short has some of each."""
        drawn = []
        for layer in LAYERS:
            names = [name for name, (_, its_layer) in self.mutants.items() if its_layer == layer]
            drawn.append(sorted(names, key=self._rank)[: self.options.size])
        return [name for turn in itertools.zip_longest(*drawn) for name in turn if name is not None]

    def _rank(self, name: str) -> bytes:
        """Return where a mutant comes in the draw; it depends on no other, so that most stay when code changes."""
        return hashlib.sha256(f"{self.options.seed} {name}".encode()).digest()

    def _try(self, name: str, reached: list[tuple[float, str]]) -> None:
        mutated, layer = self.mutants[name]
        code_hash, change = source_of(name, mutated)
        before = self.results.get(name, {})
        done = before.get("hash") == code_hash and not (self.options.again and before["result"] in UNSEEN)
        if done or layer not in (self.options.layer or LAYERS) or time.monotonic() > self.end:
            return
        tests, seconds = within_budget(reached, layer, self.options.budget)

        def note(code: int) -> None:
            result = "no_tests" if not tests else "survived" if code == 0 else "timeout" if code < 0 else "killed"
            self.results[name] = {"hash": code_hash, "result": result, "change": change}
            (FOLDER / KEPT).write_text(json.dumps(self.results, indent=1), encoding="utf-8")
            print(f"{result:9} {name}" + (f"\n{change}" if result in UNSEEN else ""), flush=True)

        if not tests:
            note(0)
            return
        run = self._run(tests, name)
        self.processes.start(lambda: int(not all(good for _, good in run)), 30 + 3 * int(seconds), note)


def cpu_seconds() -> float:
    """Return the processor time of this process and the children that it has waited for."""
    return sum(os.times()[:4])


def kept_for(file: Path) -> Path:
    """Return where it is kept what the tests of `file` reach."""
    return FOLDER / f"{file.parent.name}-{file.stem}.json"


def within_budget(tests: list[tuple[float, str]], layer: str, budget: float) -> tuple[list[str], float]:
    """Return the tests that a mutant of `layer` is tried with, in their order, and the seconds that they take."""
    chosen: list[str] = []
    total = 0.0
    for seconds, test in sorted(tests, key=lambda item: not item[1].startswith(f"tests/{layer}/")):
        if not chosen or total + seconds <= budget:
            chosen.append(test)
            total += seconds
    return chosen, total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=75, help="mutants of each layer (default 75)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no mutant after this time")
    parser.add_argument("--budget", type=float, default=20.0, help="processor seconds of tests for each (default 20)")
    parser.add_argument("--jobs", type=int, default=1, help="mutants that are tried at a time")
    parser.add_argument("--layer", choices=LAYERS, action="append", help="this layer only; may be repeated")
    parser.add_argument("--again", action="store_true", help="try mutants that survived again")
    options = parser.parse_args()
    os.chdir(ROOT)
    FOLDER.mkdir(exist_ok=True)
    campaign = Campaign(options, make_mutants())
    sys.path.insert(0, str(FOLDER))
    os.environ["PYTHONPATH"] = str(FOLDER)
    files = [str(file) for layer in LAYERS for file in sorted((ROOT / "tests" / layer).glob("test_*.py"))]
    files.remove(str(ROOT / SLOW))
    files += [str(ROOT / name) for name in ELSEWHERE]
    ours = [
        "-q",
        "-s",
        "--tb=native",
        "-p",
        "no:cacheprovider",
        f"--rootdir={ROOT}",
    ]  # other tracebacks parse all mutants
    sys.exit(pytest.main([*ours, *files], plugins=[campaign]) not in (0, pytest.ExitCode.NO_TESTS_COLLECTED))


if __name__ == "__main__":
    main()
