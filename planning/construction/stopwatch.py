"""Stopwatch that adds up the seconds of planning by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, process_time


class Stopwatch:
    """Adds up times by name.

    Attributes:
        seconds: wall-clock seconds by name.
        cpu: processor seconds by name.
    """

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.cpu: Counter[str] = Counter()

    @contextmanager
    def time(self, name: str) -> Iterator[None]:
        """Add the time that the block takes to a name."""
        wall, cpu = perf_counter(), process_time()
        try:
            yield
        finally:
            self.seconds[name] += perf_counter() - wall  # type: ignore[assignment]
            self.cpu[name] += process_time() - cpu  # type: ignore[assignment]
