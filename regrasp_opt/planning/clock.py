"""The time that a search may take, and where it went."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


@dataclass
class Clock:
    """Seconds spent, by part, since it was made; `limit` is how many there are [s]."""

    limit: float | None
    seconds: dict[str, float] = field(default_factory=dict)
    began: float = field(default_factory=time.perf_counter)

    @contextmanager
    def timed(self, name: str) -> Iterator[None]:
        """Count the seconds of a block as those of the part `name`."""
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - began

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.limit is not None and time.perf_counter() - self.began > self.limit

    def report(self) -> dict[str, float]:
        """Return the seconds of all parts, and in total."""
        return {**self.seconds, "total": time.perf_counter() - self.began}
