"""Ways to run the command line in tests."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

from regrasp_opt.cli.app import run

ROOT = Path(__file__).parents[2]


class Outcome(NamedTuple):
    """Exit code and what was written to stdout and stderr."""

    code: int
    out: str
    err: str

    @property
    def data(self):
        return json.loads(self.out)


def in_process(capsys, *arguments):
    """Run the command in this process."""
    capsys.readouterr()
    code = run([str(argument) for argument in arguments])
    return Outcome(code, *capsys.readouterr())


def as_process(*arguments, cwd):
    """Run the command in a process of its own, from the folder `cwd`."""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", "from regrasp_opt.cli import main; main()", *map(str, arguments)],
        cwd=cwd, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    return Outcome(done.returncode, done.stdout, done.stderr)


def assert_refused(outcome, said=""):
    """Assert that bad input ended as it must: exit code 2, one line on stderr, nothing on stdout."""
    assert outcome.code == 2, outcome
    assert outcome.out == ""
    assert len(outcome.err.splitlines()) == 1 and outcome.err.startswith("error: "), outcome.err
    assert "Traceback" not in outcome.err
    assert said in outcome.err
