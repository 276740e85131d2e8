"""Work in parallel through joblib, on its own processes or on a Dask cluster."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import joblib

from regrasp_opt.errors import OptionError
from regrasp_opt.workers import workers


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
