"""Where the commands print: colours and the terminal's width on a terminal, wide plain lines into a pipe."""

from __future__ import annotations

import sys

from rich.console import Console

PIPE_WIDTH = 140
"""Columns of a table that is not printed on a terminal."""


def make_console(*, stderr: bool = False) -> Console:
    """Return a console on stdout or stderr; ``NO_COLOR`` is honoured."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else PIPE_WIDTH)
