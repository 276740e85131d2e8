"""Where the commands print: colours and the terminal's width on a terminal, wide plain lines into a pipe."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

PIPE_WIDTH = 140
"""Columns of a table that is not printed on a terminal."""


def make_console(*, stderr: bool = False) -> Console:
    """Return a console on stdout or stderr; ``NO_COLOR`` is honoured."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else PIPE_WIDTH)


@contextmanager
def working(what: str) -> Iterator[None]:
    """Show on a terminal's stderr that `what` is going on and for how long; nothing is shown in a pipe."""
    console = make_console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        bar.add_task(what, total=None)
        yield
