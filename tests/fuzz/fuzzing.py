"""Damaged files for every reader: none may end in anything but an answer or a `RegraspError`.

Readers are run in a process of their own, because the parsers below them are C++ and a crash there ends the process.
That process says after each file how it went; one that falls silent for `SILENCE` seconds is ended by its own watchdog,
one that dies is started again behind the file that killed it. Cases have numbers instead of coming from Hypothesis: a
run resumes behind the last batch, and each is made again from the reader's name and its number.
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import logging
import os
import resource
import subprocess
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

from regrasp_opt.benchmarks.harness.runner import Row
from regrasp_opt.errors import RegraspError

from . import TESTS
from .targets import TARGETS, case, seeds

SILENCE = 10.0
"""Seconds that a reader may take over one file."""
MEMORY = 8 * 2**30
"""Address space of the process that reads [bytes]; more is an error there instead of a machine without memory."""
READ, REFUSED = "read", "refused"
_SHOWN = 3

_WORK = f"import sys; sys.path.append({TESTS!r}); from fuzz.fuzzing import work; "
_WORK += "work(sys.argv[1], *map(int, sys.argv[2:]))"


def fuzz_rows(name: str, seed: int, first: int, count: int) -> list[Row]:
    """Read the damaged files `first` to ``first + count - 1`` of a target, and return one row about them.

    Returns
    -------
    list of Row
        ``inputs``, how many were ``read`` and ``refused``, how many ended in a ``traceback``, a ``crash`` or a
        ``hang``, how many files were ``harmed``, and the first of these in words (``examples``).
    """
    outcomes: list[str] = []
    while len(outcomes) < count:
        outcomes += _batch(name, seed, first + len(outcomes), count - len(outcomes))
    kinds = Counter(text.split(":")[0] for text in outcomes)
    bad = [f"{first + i}: {t}" for i, t in enumerate(outcomes) if t not in (READ, REFUSED)]
    keys = (READ, REFUSED, "traceback", "crash", "hang", "harmed")
    return [{"inputs": count, **{key: kinds[key] for key in keys}, "examples": "; ".join(bad[:_SHOWN])}]


def _batch(name: str, seed: int, first: int, count: int) -> list[str]:
    """Return the outcomes of a process: `count` of them, or fewer, the last of which ended it."""
    command = [sys.executable, "-c", _WORK, name, str(seed), str(first), str(count)]
    done = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    outcomes = [json.loads(line) for line in done.stdout.splitlines() if line.startswith('"')]
    if len(outcomes) < count:
        hung = "Timeout (" in done.stderr
        last = (done.stderr.strip().splitlines() or [""])[-1][:200]
        outcomes.append("hang: no answer" if hung else f"crash: exit {done.returncode}, {last}")
    return outcomes


def work(name: str, seed: int, first: int, count: int) -> None:
    """Read damaged files in this process, which is started for it, and print each outcome as a line of JSON."""
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as place:
        here = Path(place)
        seeds(name, here)  # made before memory is limited
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        for number in range(first, first + count):
            suffix, content = case(name, seed, number, here)
            faulthandler.dump_traceback_later(SILENCE, exit=True)
            outcome = read_once(name, suffix, content, here)
            faulthandler.cancel_dump_traceback_later()
            sys.stdout.write(json.dumps(outcome) + "\n")
            sys.stdout.flush()


def read_once(name: str, suffix: str, content: bytes, folder: Path) -> str:
    """Return how the reader of a target took a file: read, refused, or what went wrong.

    The file and its folder must be afterwards as they were before.
    """
    with tempfile.TemporaryDirectory(dir=folder) as place:
        path = Path(place) / f"input{suffix}"
        path.write_bytes(content)
        outcome = _outcome(TARGETS[name].read, path)
        if os.listdir(place) != [path.name] or path.read_bytes() != content:
            return "harmed: the file or its folder was changed"
    return outcome


class _Tracebacks(logging.Handler):
    """Remembers log records that carry a traceback."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info:
            self.seen.append(record.name)


def _outcome(read: Any, path: Path) -> str:
    logged = _Tracebacks()
    logging.getLogger().handlers = [logged]
    outcome = _raised(read, path)
    return f"traceback: logged by {logged.seen[0]}" if logged.seen and outcome in (READ, REFUSED) else outcome


def _raised(read: Any, path: Path) -> str:
    try:
        with contextlib.redirect_stdout(None), warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # arithmetic that breaks down, and text on stderr
            read(path)
    except RegraspError:
        return REFUSED
    except BaseException as error:  # whatever it is, it is what is looked for
        frames = traceback.extract_tb(error.__traceback__)
        frame = frames[-1]
        own = ([f for f in frames if "regrasp_opt" in f.filename] or frames)[-1]
        where = f"{Path(own.filename).name}:{own.lineno}"
        return f"traceback: {type(error).__name__} at {where} in {Path(frame.filename).name}: {error}"[:300]
    return READ
