"""Running the items of an experiment in parallel, so that a killed run goes on where it stopped.

Workers are joblib's, on its own processes or on a Dask cluster.

Every item has a key; its rows are written to one file, atomically, under a hash of the key and of all that
the rows depend on. A second run reads the files it finds and computes the others, so no row is repeated or lost.
"""

from __future__ import annotations

import csv
import json
import logging
import subprocess
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

import joblib
from rich.console import Console
from rich.progress import Progress, TaskID

from regrasp_opt.errors import OptionError, RegraspError
from regrasp_opt.files import UNREADABLE_ARRAYS, atomic_path, content_hash
from regrasp_opt.workers import workers

logger = logging.getLogger(__name__)

Found = TypeVar("Found")
Row = dict[str, Any]
"""One row of a result: column name to text, number, truth value or None."""


@dataclass(frozen=True)
class Item:
    """A piece of an experiment that one worker computes; its `key` is unique within the experiment.

    The worker calls `function`, which lives at the top level of a module, with `arguments`; each of the rows that come
    back starts with `columns`. `depends` is a hash of everything, besides the code, that the rows depend on.
    """

    key: str
    depends: str
    function: Callable[..., list[Row]]
    arguments: tuple[Any, ...]
    columns: Row

    @property
    def file_name(self) -> str:
        """Name of the file that holds the rows."""
        return f"{content_hash('item-2', self.key, self.depends)[:32]}.json"


@dataclass(frozen=True)
class Results:
    """The rows of a run in the order of its items, and the git revisions of the code that made them."""

    rows: list[Row]
    revisions: tuple[str, ...]


def run_items(items: Sequence[Item], folder: Path, *, jobs: int = -1, quiet: bool = False) -> Results:
    """Compute the rows of `items`, except where `folder` holds them already, by `jobs` workers, as joblib counts them.

    An item that raises a `RegraspError` becomes one row with its message in the column ``error``; it is tried again in
    the next run. Two items of the same key are an `OptionError`.
    """
    if len({item.key for item in items}) < len(items):
        raise OptionError("two items of the benchmark have the same key; give each its own")
    revision = git_revision()
    by_path = {folder / item.file_name: item for item in items}

    def keep(content: dict[str, Any], path: Path) -> None:
        if not any("error" in row for row in content["rows"]):
            with atomic_path(path) as temporary:
                temporary.write_text(json.dumps(content), encoding="utf-8")

    with progress(quiet) as show:
        contents = resumed(
            by_path,
            lambda path: _read(path, by_path[path]),
            lambda path: joblib.delayed(_compute)(path, by_path[path], revision),
            keep,
            jobs,
            partial(show, "instances"),
        ).values()
    rows = [row for content in contents for row in content["rows"]]
    return Results(rows, tuple(sorted({str(content["revision"]) for content in contents})))


def _compute(path: Path, item: Item, revision: str) -> tuple[Path, dict[str, Any]]:
    try:
        rows = item.function(*item.arguments)
    except RegraspError as error:
        rows = [{"error": str(error)}]
    return path, {"key": item.key, "revision": revision, "rows": [{**item.columns, **row} for row in rows]}


def _read(path: Path, item: Item) -> dict[str, Any]:
    content = json.loads(path.read_text(encoding="utf-8"))
    good = content["key"] == item.key and isinstance(content["revision"], str)
    if not good or not all(isinstance(row, dict) for row in content["rows"]):
        raise ValueError(f"not the rows of '{item.key}'")
    return dict(content)


def resumed(
    paths: Iterable[Path],
    read: Callable[[Path], Found],
    work: Callable[[Path], Any],
    keep: Callable[[Found, Path], None],
    jobs: int,
    progress: Callable[[int, int], None] | None,
) -> dict[Path, Found]:
    """Return what `paths` hold, and of the others what workers make, each kept as soon as it is there.

    A file that `read` cannot read is reported and made again. ``work(path)`` is the ``joblib.delayed`` call that
    returns the path and what was made; there are `jobs` workers, as joblib counts them, on its current backend.
    `progress` is called with (number there, number in all).
    """
    paths, found = list(paths), dict[Path, Found]()
    for path in filter(Path.is_file, paths):
        try:
            found[path] = read(path)
        except (RegraspError, *UNREADABLE_ARRAYS):
            logger.warning("the stored file '%s' is corrupt; it is made again", path)
    missing = [path for path in paths if path not in found]
    tell = progress or (lambda done, total: None)
    tell(len(found), len(paths))
    if missing:
        with warnings.catch_warnings(), workers(jobs, "generator_unordered") as parallel:
            warnings.filterwarnings("ignore", message="A worker stopped")  # joblib replaces workers that have grown
            for path, value in parallel(work(path) for path in missing):
                keep(value, path)
                found[path] = value
                tell(len(found), len(paths))
    return {path: found[path] for path in paths}


@contextmanager
def dask_cluster(address: str | None) -> Iterator[None]:
    """Let joblib use the Dask cluster at `address` inside the block; with None, its own processes.

    Raises an `OptionError` if Dask is not installed or nothing answers at `address`.
    """
    if address is None:
        yield
        return
    try:
        from distributed import Client
    except ImportError as error:
        raise OptionError(
            "Dask is not installed; install the extra regrasp-opt[cluster], or leave --dask out"
        ) from error
    try:
        client = Client(address, timeout="5s")
    except (OSError, ValueError) as error:
        raise OptionError(f"no Dask scheduler answers at '{address}'; start one, or leave --dask out") from error
    with client, joblib.parallel_config(backend="dask"):
        yield


@cache
def git_revision() -> str:
    """Return the revision of the code, with ``-dirty`` where files differ from it, or ``unknown`` outside a clone."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=10)
    except (OSError, subprocess.TimeoutExpired):
        return "unknown"
    return (done.returncode == 0 and done.stdout.strip()) or "unknown"


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """Write `rows` to `path`, atomically; columns in the order in which they first occur, None as nothing."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)


@contextmanager
def progress(quiet: bool = False) -> Iterator[Callable[[str, int, int], None]]:
    """Yield what shows (what, done, in all) on stderr; nothing is shown where that is not a terminal."""
    console = Console(stderr=True)
    with Progress(console=console, disable=quiet or not console.is_terminal, transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def show(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield show
