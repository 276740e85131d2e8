"""One BLAS thread while planning.

The matrices of a plan are small. A second BLAS thread gains little on an idle machine, and on a busy one the threads
wait for each other: plans then take two to four times as long.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import threadpoolctl


class _CasadiOpenBlas(threadpoolctl.OpenBLASController):  # type: ignore[misc]  # threadpoolctl has no types
    """The OpenBLAS that CasADi brings along, which goes by a name of its own."""

    filename_prefixes = ("libcasadi-tp-openblas",)


threadpoolctl.register(_CasadiOpenBlas)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let NumPy and CasADi use one thread for linear algebra, and what they used before afterwards."""
    with threadpoolctl.threadpool_limits(limits=1, user_api="blas"):
        yield


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Let torch, which must be installed, use one thread, and what it used before afterwards."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
