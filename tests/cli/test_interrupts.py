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


def assert_ends_with(script, said, folder, *arguments, number=signal.SIGINT):
    """Send the signal `number` to `script` when it says that it is busy, and look at how it ends."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-c", script, *arguments], cwd=folder, env=environment, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    ) as child:  # fmt: skip
        assert child.stdout.readline() == "busy\n"
        child.send_signal(number)
        _, errors = child.communicate(timeout=30)
    assert child.returncode == 128 + number
    assert errors == said


@pytest.mark.parametrize("body", [PLAIN, SWALLOWED, HELD_BACK], ids=["plain", "swallowed", "held back"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_command_in_one_line(tmp_path, body, number):
    assert_ends_with(script(body), "interrupted\n", tmp_path, number=number)


def test_an_interrupted_prepare_says_how_to_go_on(tmp_path):
    body = """
import time
from regrasp_opt.cli import main, prepare
def busy(*arguments, **options):
    print("busy", flush=True)
    time.sleep(60)
prepare.run_prepare_object = busy
main()
"""
    assert_ends_with(
        body, "interrupted; run the same command again to resume\n", tmp_path, "prepare", "nova2-w", "--object", "mug"
    )
