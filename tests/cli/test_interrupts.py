"""Ctrl-C and SIGTERM end a command in one line, also where a library swallows the interrupt or never lets go."""

import os
import signal
import subprocess
import sys

import pytest
from command import ROOT

SWALLOWED = """
try:
    time.sleep(60)
except KeyboardInterrupt:
    raise NameError("half imported") from None
"""
HELD_BACK = "\nwhile True:\n    try:\n        time.sleep(60)\n    except KeyboardInterrupt:\n        pass\n"
PLAIN = "\ntime.sleep(60)\n"


def script(body):
    lines = "\n".join("    " + line for line in body.splitlines())
    return f"""
import time
from regrasp_opt.cli import app, main
def busy(args, standalone_mode):
    print("busy", flush=True)
{lines}
app.app = busy
main()
"""


@pytest.mark.parametrize("body", [PLAIN, SWALLOWED, HELD_BACK], ids=["plain", "swallowed", "held back"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_in_one_line(tmp_path, body, number):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-c", script(body)], cwd=tmp_path, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as child:  # fmt: skip
        assert child.stdout.readline() == "busy\n"
        child.send_signal(number)
        _, errors = child.communicate(timeout=30)
    assert child.returncode == 128 + number
    assert errors == "interrupted\n"
