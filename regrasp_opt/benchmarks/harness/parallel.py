"""Work in parallel through joblib, on its own processes or on a Dask cluster."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

import joblib

from regrasp_opt.errors import OptionError
from regrasp_opt.workers import workers

Key = TypeVar("Key", bound=Hashable)
Found = TypeVar("Found")


def in_parallel(work: Iterable[Any], jobs: int) -> Iterator[Any]:
    """Yield the results of ``joblib.delayed`` calls as they come, on the backend that is current in joblib.

    Parameters
    ----------
    jobs : int
        Workers, as joblib counts them.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="A worker stopped")  # joblib replaces workers that have grown
        with workers(jobs, "generator_unordered") as parallel:
            yield from parallel(work)


def resumed(
    keys: Sequence[Key],
    read: Callable[[Key], Found | None],
    work: Callable[[Key], Any],
    keep: Callable[[Key, Found], None],
    jobs: int,
    progress: Callable[[int, int], None] | None,
) -> dict[Key, Found]:
    """Return what `read` finds of `keys`, and of the others what workers make, each kept as soon as it is there.

    Parameters
    ----------
    work : callable
        Returns the ``joblib.delayed`` call for a key, which returns the key and what was made.
    progress : callable, optional
        Called with (number there, number in all).
    """
    stored = {key: read(key) for key in keys}
    found = {key: value for key, value in stored.items() if value is not None}
    missing = [key for key in stored if key not in found]
    tell = progress or (lambda done, total: None)
    tell(len(found), len(stored))
    for key, value in in_parallel([work(key) for key in missing], jobs) if missing else ():
        keep(key, value)
        found[key] = value
        tell(len(found), len(stored))
    return {key: found[key] for key in stored}


@contextmanager
def dask_cluster(address: str | None) -> Iterator[None]:
    """Let joblib use the Dask cluster at `address` inside the block; with None, its own processes.

    Raises
    ------
    OptionError
        If Dask is not installed or nothing answers at `address`.
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
