"""Work in parallel through joblib, on its own processes or on a Dask cluster."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import joblib

from regrasp_opt.errors import OptionError, RegraspError
from regrasp_opt.files import UNREADABLE_ARRAYS
from regrasp_opt.workers import workers

Found = TypeVar("Found")

logger = logging.getLogger(__name__)


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
        raise OptionError("Dask is not installed; install regrasp-opt[cluster], or leave --dask out") from error
    try:
        client = Client(address, timeout="5s")
    except (OSError, ValueError) as error:
        raise OptionError(f"no Dask scheduler answers at '{address}'; start one, or leave --dask out") from error
    with client, joblib.parallel_config(backend="dask"):
        yield
