"""Seconds spent in the stages of planning, and a display of how far they have come."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from twin.host.progress import Report, of_stage, report_nothing


@dataclass
class StageWatch:
    """Measures and reports the stages of planning.

    Attributes:
        report: told how far each stage has come.
        seconds: wall-clock seconds that each stage took; a stage entered again adds up.
    """

    report: Report = report_nothing
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, key: str, label: str | None = None) -> Iterator[None]:
        """Measure a stage; with a label, show it as one piece of work."""
        start = time.perf_counter()
        if label is not None:
            self.report(label, 0, 1)
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            self.seconds[key] = self.seconds.get(key, 0.0) + elapsed
        if label is not None:
            self.report(label, 1, 1)

    def reporter(self, label: str) -> Callable[[float, float], None]:
        """Return a callback that shows the progress of a stage: done, and total."""
        return of_stage(self.report, label)
