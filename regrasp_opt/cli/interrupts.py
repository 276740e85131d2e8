"""Ctrl-C and SIGTERM: the command ends soon, in one line, with what it has finished kept.

Both raise a KeyboardInterrupt where the command is. Some libraries swallow that, and a long call into one of them holds
it back, so a thread ends the process `GRACE` seconds later in any case. Files are written under another name and then
moved into place, so nothing on disk is half written then.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import sys
import threading
import time
from types import FrameType
from typing import NoReturn

GRACE = 1.0
"""Seconds that a command has to end by itself after a signal."""
SIGNALS = (signal.SIGINT, signal.SIGTERM)
_TRACKER = "ignore::UserWarning:joblib.externals.loky.backend.resource_tracker"
"""What keeps the process that cleans up behind killed workers from listing what it cleans up."""

_received: list[int] = []
_message = ["interrupted"]
_speaking = threading.Lock()


def install() -> None:
    """Take over SIGINT and SIGTERM; to be called by the main thread, before worker processes are started."""
    if signal.getsignal(signal.SIGINT) is _interrupt:
        return
    os.environ["PYTHONWARNINGS"] = ",".join(filter(None, (os.environ.get("PYTHONWARNINGS"), _TRACKER)))
    receiver, sender = socket.socketpair()
    sender.setblocking(False)
    signal.set_wakeup_fd(sender.detach(), warn_on_full_buffer=False)
    for number in SIGNALS:
        signal.signal(number, _interrupt)
    threading.Thread(target=_watch, args=(receiver,), daemon=True).start()


def resumable() -> None:
    """Say, if the command is interrupted, that the same command resumes where this one stopped."""
    _message[0] = "interrupted; run the same command again to resume"


def let_go() -> None:
    """Let a signal end the process at once; to be called when nothing else is left to do."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)


def received() -> bool:
    """Return whether a signal has come."""
    return bool(_received)


def conclude() -> int:
    """Say that the command was interrupted, once, and return the exit code: 130 for Ctrl-C, 143 for SIGTERM."""
    if _speaking.acquire(blocking=False):
        sys.stderr.write(f"{_message[0]}\n")
        sys.stderr.flush()
    return 128 + (_received[0] if _received else signal.SIGINT)


def leave(code: int) -> NoReturn:
    """End the process without taking down libraries and workers one by one, which can take seconds."""
    with contextlib.suppress(OSError):
        sys.stdout.flush()
    os._exit(code)


def _interrupt(number: int, frame: FrameType | None) -> None:
    _received.append(number)
    raise KeyboardInterrupt


def _watch(receiver: socket.socket) -> None:
    """End the process some time after the first signal; the byte comes even while a library keeps Python waiting."""
    number = 0
    while number not in SIGNALS:
        number = receiver.recv(1)[0]
    time.sleep(GRACE)
    if _speaking.acquire(blocking=False):
        os.write(2, f"{_message[0]}\n".encode())
    os._exit(128 + number)
