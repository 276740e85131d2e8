"""Where the commands print: colours and the terminal's width on a terminal, wide plain lines into a pipe."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.markup import escape
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task, TextColumn, TimeElapsedColumn
from rich.table import Table
from rich.text import Text

PIPE_WIDTH = 140
"""Columns of a table that is not printed on a terminal."""


def make_console(*, stderr: bool = False) -> Console:
    """Return a console on stdout or stderr; ``NO_COLOR`` is honoured."""
    stream = sys.stderr if stderr else sys.stdout
    return Console(stderr=stderr, highlight=False, width=None if stream.isatty() else PIPE_WIDTH)


def plain_table(*headings: str, right: int = 0) -> Table:
    """Return a table without lines; the last `right` columns are aligned to the right."""
    table = Table(box=None, header_style="bold")
    for left, heading in zip(range(len(headings), 0, -1), headings, strict=True):
        table.add_column(escape(heading), justify="right" if left <= right else "left")
    return table


def say_written(*paths: str | os.PathLike[str] | None) -> None:
    """Say which files were written; None stands for one that was not asked for."""
    for path in paths:
        if path is not None:
            make_console().print(f"written: {path}", markup=False, soft_wrap=True)


class _TimeLeft(ProgressColumn):
    def render(self, task: Task) -> Text:
        left = None if task.total is None else max(0.0, task.total - (task.elapsed or 0.0))
        return Text("" if left is None else f"at most {left:.0f} s left")


@contextmanager
def working(what: str, limit: float | None = None) -> Iterator[None]:
    """Show on a terminal's stderr that `what` is going on, for how long, and how much of `limit` [s] is left.

    Nothing is shown in a pipe.
    """
    console = make_console(stderr=True)
    columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn(), _TimeLeft())
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bar:
        bar.add_task(what, total=limit)
        yield
