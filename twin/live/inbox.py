"""The reports that wait for the dispatcher, a bounded number of each robot."""

from __future__ import annotations

import queue
import threading
from collections import Counter

from twin.live.messages import Report

_REPORT_WEIGHT = 50
"""Memory of a report without samples, in samples."""

_MOST_WEIGHT = 50_000
"""Most memory of the reports of one robot that wait, in samples."""


class Inbox:
    """A queue of reports that drops what a robot sends faster than it is heard.

    A report says how a robot is as a whole, and samples are told again until they have been heard of: so nothing is
    lost by a report that is dropped.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Report] = queue.SimpleQueue()
        self._weight: Counter[str] = Counter()
        self._turn = threading.Lock()
        self._left: int | None = None

    def put(self, report: Report) -> None:
        """Append a report, unless too much of its robot waits; it returns at once."""
        with self._turn:
            if self._weight[report.robot] < _MOST_WEIGHT:
                self._weight[report.robot] += _weight(report)
                self._queue.put(report)

    def get(self, timeout: float) -> Report:
        """Return the report that has waited longest.

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
        """Tell whether reports wait that are to be heard before anything else.

        Those are all that wait once this was false; what comes meanwhile is heard after it was false again.
        """
        if self._left is None:
            self._left = self._queue.qsize()
        behind = self._left > 0
        if not behind:
            self._left = None
        return behind


def _weight(report: Report) -> int:
    return _REPORT_WEIGHT + len(report.state.samples)
