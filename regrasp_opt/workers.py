"""Worker processes that leave Ctrl-C to the process that started them."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import joblib


@contextmanager
def workers(jobs: int, return_as: str) -> Iterator[joblib.Parallel]:
    """Yield a `joblib.Parallel` whose processes are running.

    They inherit a blocked SIGINT: one that was still importing when Ctrl-C came would print a traceback.

    Parameters
    ----------
    jobs : int
        Workers, as joblib counts them; the backend is joblib's current one.
    return_as : str
        "generator" or "generator_unordered".
    """
    with joblib.Parallel(n_jobs=jobs, return_as=return_as) as parallel:
        blocks = hasattr(signal, "pthread_sigmask")  # Windows has none
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if blocks else None
        try:
            nothing: list[Any] = [joblib.delayed(int)() for _ in range(joblib.effective_n_jobs(jobs))]
            list(parallel(nothing))
        finally:
            if before is not None:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
        yield parallel
