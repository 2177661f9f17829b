"""Queue of driver reports for the dispatcher, with limited memory per robot."""

from __future__ import annotations

import queue
import threading
from collections import Counter

from twin.live.messages import Report

_REPORT_WEIGHT = 50
"""Memory of a report without samples, in units of the memory of one sample."""

_MOST_WEIGHT = 50_000
"""Memory limit of the queued reports of one robot, in the same unit."""


class Inbox:
    """Queue of reports; reports beyond the memory limit of a robot are dropped.

    A report contains the complete state of a robot, and samples are sent again until they are acknowledged. A dropped
    report therefore causes no loss of data.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Report] = queue.SimpleQueue()
        self._weight: Counter[str] = Counter()
        self._turn = threading.Lock()
        self._left: int | None = None

    def put(self, report: Report) -> None:
        """Append a report without blocking, unless its robot's bound is reached."""
        with self._turn:
            if self._weight[report.robot] < _MOST_WEIGHT:
                self._weight[report.robot] += _weight(report)
                self._queue.put(report)

    def get(self, timeout: float) -> Report:
        """Return the oldest report.

        Args:
            timeout: how long to wait for one [s].

        Raises:
            queue.Empty: there was none.
        """
        report = self._queue.get(timeout=timeout)
        if self._left:
            self._left -= 1
        with self._turn:
            self._weight[report.robot] -= _weight(report)
        return report

    def is_behind(self) -> bool:
        """Return whether reports are waiting that must be processed first.

        Those are all reports waiting after this was false; later ones are processed after it is false
        again.
        """
        if self._left is None:
            self._left = self._queue.qsize()
        behind = self._left > 0
        if not behind:
            self._left = None
        return behind


def _weight(report: Report) -> int:
    return _REPORT_WEIGHT + len(report.state.samples)
