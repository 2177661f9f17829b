"""Stopwatch that sums up the planning time of each named activity."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, process_time


class Stopwatch:
    """Accumulates times by name; a nested block counts for its own name only.

    Attributes:
        seconds: wall-clock seconds by name.
        cpu: processor seconds by name.
    """

    def __init__(self) -> None:
        self.seconds: Counter[str] = Counter()
        self.cpu: Counter[str] = Counter()
        self._within = [0.0, 0.0]

    @contextmanager
    def time(self, name: str) -> Iterator[None]:
        """Add the duration of the block to a name."""
        wall, cpu = perf_counter(), process_time()
        around, self._within = self._within, [0.0, 0.0]
        try:
            yield
        finally:
            spent = perf_counter() - wall, process_time() - cpu
            self.seconds[name] += spent[0] - self._within[0]  # type: ignore[assignment]
            self.cpu[name] += spent[1] - self._within[1]  # type: ignore[assignment]
            self._within = [a + b for a, b in zip(around, spent, strict=True)]
