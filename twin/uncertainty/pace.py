"""Conversion between the time of a run and a robot's own time, without its stops."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin.durations import Nanoseconds


class Pace:
    """Translates between the run's time and the time for which a robot was not stopped.

    Args:
        intervals: start and end of every stop, in order and without overlaps [ns].
    """

    def __init__(self, intervals: Sequence[tuple[int, int]]) -> None:
        pairs = np.array(intervals, dtype=np.int64).reshape(-1, 2)
        self._starts = pairs[:, 0]
        self._stopped = np.concatenate([[0], np.cumsum(pairs[:, 1] - pairs[:, 0])])
        self.stops_at: Nanoseconds = self._starts - self._stopped[:-1]
        """Own time at every stop, shape (stops,) [ns]."""

    def own(self, t_ns: Nanoseconds) -> Nanoseconds:
        """Return the robot's own time at times of the run [ns]."""
        before = np.searchsorted(self._starts, t_ns, side="right")
        own = t_ns - self._stopped[before]
        # Within a stop, own time is what it was when the stop began.
        floor = np.concatenate([[np.iinfo(np.int64).min], self.stops_at])[before]
        return np.asarray(np.maximum(own, floor), dtype=np.int64)

    def real(self, own_ns: Nanoseconds) -> Nanoseconds:
        """Return the time of the run at own times; where a stop begins then, its end [ns]."""
        passed = np.searchsorted(self.stops_at, own_ns, side="right")
        return np.asarray(own_ns + self._stopped[passed], dtype=np.int64)
