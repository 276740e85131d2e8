"""Atomic writes, content hashes, files that files name, and the folder where energies are kept."""

from __future__ import annotations

import hashlib
import logging
import os
import shutil
import struct
import sys
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tokenize import TokenError
from typing import Any
from zipfile import BadZipFile

import numpy as np

UNREADABLE_ARRAYS = (
    OSError, ValueError, LookupError, TypeError, AttributeError, EOFError, RuntimeError, MemoryError, SyntaxError,
    BadZipFile, TokenError, struct.error, zlib.error,
)  # fmt: skip
"""What `numpy.load` raises on a broken file; NotImplementedError is a RuntimeError."""

logger = logging.getLogger(__name__)


def report_outside(source: Path, named: Iterable[Path], folders: Iterable[Path] = ()) -> None:
    """Log one warning if files that `source` names lie neither in its folder nor in `folders`, links followed."""
    inside = [folder.resolve() for folder in (source.parent, source.resolve().parent, *folders)]
    paths = dict.fromkeys(path.resolve() for path in named if os.path.exists(path))
    outside = [path for path in paths if not any(path.is_relative_to(folder) for folder in inside)]
    if outside:
        more = f" and {len(outside) - 1} more" if len(outside) > 1 else ""
        text = "%s refers to '%s'%s outside its folder, and reads it; check %s if you did not write the file"
        logger.warning(text, source, outside[0], more, "it" if len(outside) == 1 else "them")


@contextmanager
def captured_stderr() -> Iterator[list[str]]:
    """Keep what C++ libraries print to the process's stderr off the screen; its lines are in the list afterwards."""
    sys.stderr.flush()
    lines, saved = list[str](), os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            sink.seek(0)
            lines += sink.read().decode(errors="replace").splitlines()


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it replaces `path`, on any failure it is removed.

    An OSError on the way, such as that of a full disk, names `path`.
    """
    target = Path(path)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{target.stem}-", suffix=target.suffix, dir=target.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(target)
    except OSError as error:
        if error.errno is None or error.filename not in (None, name):
            raise
        raise OSError(error.errno, error.strerror, str(target)) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def replaced_folder(folder: Path) -> Iterator[Path]:
    """Yield an empty folder beside `folder`; on success it takes that one's place, on any failure it is removed."""
    folder = folder.resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    fresh, old = (Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent)) for _ in range(2))
    try:
        yield fresh
        fresh.chmod(0o755)
        if folder.exists():
            folder.rename(old / "old")
        fresh.rename(folder)
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        shutil.rmtree(old, ignore_errors=True)


@contextmanager
def exchanged_files(folder: Path, last: str) -> Iterator[Path]:
    """Yield an empty folder in `folder`; on success its files replace those of their names, `last` at the end.

    Where writing fails or is interrupted, none does. While they are exchanged there is no file called `last`, which
    refers to the others; if that fails, it is missing. An OSError names the file that was to be written.
    """
    made = not folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(prefix=".new-", dir=folder))
    try:
        yield fresh
        (folder / last).unlink(missing_ok=True)
        for path in sorted(fresh.iterdir(), key=lambda path: (path.name == last, path.name)):
            path.replace(folder / path.name)
    except OSError as error:
        name = str(error.filename or fresh).replace(str(fresh), str(folder))
        raise error if error.errno is None else OSError(error.errno, error.strerror, name) from error
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
        if made:
            with suppress(OSError):  # it is not empty on success
                folder.rmdir()


def machine_memory() -> float:
    """Return the physical memory of this machine [bytes]; infinity where the system does not say."""
    try:
        pages, size = os.sysconf("SC_PHYS_PAGES"), os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return float("inf")
    return float(pages * size) if min(pages, size) > 0 else float("inf")


def content_hash(*parts: Any) -> str:
    """Return the SHA-256 hex digest of arrays (rounded to 1e-9), strings, numbers, None and nested sequences."""
    digest = hashlib.sha256()

    def feed(part: Any) -> None:
        if isinstance(part, np.ndarray):
            rounded = np.round(part, 9) + 0.0 if part.dtype.kind == "f" else part
            digest.update(f"{part.dtype.str}{part.shape}".encode())
            digest.update(np.ascontiguousarray(rounded).tobytes())
        elif isinstance(part, (list, tuple)):
            digest.update(f"({len(part)}".encode())
            for item in part:
                feed(item)
        else:
            digest.update(f"{type(part).__name__}:{part!r};".encode())

    feed(parts)
    return digest.hexdigest()


def data_home() -> Path:
    """Return the folder of trained energies and caches: ``$REGRASP_OPT_HOME``, or the user's data folder."""
    from platformdirs import user_data_path

    return Path(os.environ.get("REGRASP_OPT_HOME") or user_data_path("regrasp-opt"))
