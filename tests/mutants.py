"""A seeded sample of mutants of three layers, each run with `pytest -x` against the tests beside its layer.

    python tests/mutants.py --size 150

mutmut makes the mutants. They are drawn and run here, because mutmut runs all of them, and all of its tests before each
start: one after another in a forked process, those tests first that took least time among the ones that reach the
mutated function. What is done is kept in ``mutants/``, and a second run goes on; a mutant is tried again when its
function has changed, one that survived also with ``--again``. The counts are written where
`regrasp-opt bench reliability` reads them.
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
LAYERS = ("connectivity", "feasibility", "planning")
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


def forked(work: Callable[[], int], cpu_seconds: int) -> int:
    """Return the exit code of `work` in a forked process; negative where a signal ended it, such as a time limit."""
    pid = os.fork()
    if pid == 0:
        resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, cpu_seconds + 5))
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(20 * cpu_seconds)
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, 1)
        os.dup2(null, 2)
        os._exit(work())
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

    if forked(work, 3600) != 0:
        raise SystemExit(f"{file} does not pass without a mutant; mend that first")


def tests_by_function(layer: str, has_time: Callable[[], bool]) -> dict[str, list[tuple[float, str]]]:
    """Return (seconds, test) of the tests beside `layer` that reach each function, the quickest first."""
    found: dict[str, list[tuple[float, str]]] = {}
    for file in sorted((ROOT / "tests" / layer).glob("test_*.py")):
        kept = FOLDER / f"{layer}-{file.stem}.json"
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", type=int, default=150, help="mutants of each layer (default 150)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="begin no mutant after this time")
    parser.add_argument("--layer", choices=LAYERS, help="this layer only")
    parser.add_argument("--again", action="store_true", help="try mutants that survived again")
    options = parser.parse_args()
    end = time.monotonic() + options.seconds
    os.chdir(ROOT)
    FOLDER.mkdir(exist_ok=True)
    mutants = make_mutants()
    sys.path.insert(0, str(FOLDER))
    os.environ["PYTHONPATH"] = str(FOLDER)
    import torch  # noqa: F401 (loaded once, before the forks)

    import regrasp_opt.planning.prepare
    import regrasp_opt.planning.sequence_nlp  # noqa: F401

    kept = FOLDER / KEPT
    results = json.loads(kept.read_text("utf-8")) if kept.exists() else {}
    sample = []
    for layer in LAYERS:
        names = sorted(name for name, (_, its_layer) in mutants.items() if its_layer == layer)
        sample += random.Random(options.seed).sample(names, min(options.size, len(names)))
    for layer in [options.layer] if options.layer else LAYERS:
        reach = tests_by_function(layer, lambda: time.monotonic() < end)
        for name in [name for name in sample if mutants[name][1] == layer]:
            code_hash, change = source_of(name, mutants[name][0])
            before = results.get(name, {})
            done = before.get("hash") == code_hash and not (options.again and before["result"] in UNSEEN)
            if done or time.monotonic() > end:
                continue
            tests = reach.get(function_of(name), [])
            limit = 60 + 5 * int(sum(seconds for seconds, _ in tests))
            test_ids = [test for _, test in tests]
            code = forked(partial(run_tests, test_ids, name), limit) if tests else 0
            # 4 or 5: pytest did not find the tests. A mutant that breaks the import of their files is killed by that;
            # where they are missing without the mutant as well, what is kept about them is out of date.
            if code in (4, 5) and forked(partial(run_tests, ["--collect-only", *test_ids]), limit) != 0:
                raise SystemExit(f"pytest finds no test of {name}; delete {FOLDER} and run this again")
            result = "no_tests" if not tests else "survived" if code == 0 else "timeout" if code < 0 else "killed"
            results[name] = {"hash": code_hash, "result": result, "change": change}
            kept.write_text(json.dumps(results, indent=1), encoding="utf-8")
            print(f"{result:9} {name}" + (f"\n{change}" if result in UNSEEN else ""), flush=True)
    counted = [results[name]["result"] for name in sample if name in results]
    counts = {kind: counted.count(kind) for kind in ("killed", "timeout", "survived", "no_tests")}
    (FOLDER / COUNTS).write_text(json.dumps({**counts, "of": len(sample), "seed": options.seed}), encoding="utf-8")
    print(f"{len(counted)} of {len(sample)} mutants: {counts}")


if __name__ == "__main__":
    main()
