"""How robots and dispatcher talk: queues ahead, and the time that messages take."""

from __future__ import annotations

import math
from dataclasses import dataclass

from planning.errors import TwinError
from twin.durations import to_nanoseconds


@dataclass(frozen=True)
class Messages:
    """How robots and dispatcher talk.

    Attributes:
        queue_depth: actions sent to a robot of which completion is not yet reported, at most.
        report_ns: time a message takes from robot to dispatcher [ns].
        release_ns: time a message takes from dispatcher to robot [ns].
    """

    queue_depth: int = 1
    report_ns: int = 0
    release_ns: int = 0

    @classmethod
    def of_seconds(
        cls,
        queue_depth: int,
        latency_s: float = 0.0,
        report_latency_s: float | None = None,
        release_latency_s: float | None = None,
    ) -> Messages:
        """Return messages that take some seconds; ``latency_s`` where none of their own.

        Raises:
            TwinError: a number is out of range.
        """
        if queue_depth < 1:
            raise TwinError(f"queue_depth must be at least 1, not {queue_depth}")
        report = latency_s if report_latency_s is None else report_latency_s
        release = latency_s if release_latency_s is None else release_latency_s
        for name, value in (
            ("latency_s", latency_s),
            ("report_latency_s", report),
            ("release_latency_s", release),
        ):
            if not 0 <= value < math.inf:
                raise TwinError(f"{name} must be at least 0, not {value}")
        return cls(
            queue_depth, int(to_nanoseconds(report)), int(to_nanoseconds(release))
        )

    @property
    def instant(self) -> bool:
        """Whether messages take no time; then the depth of the queues makes no difference."""
        return self.report_ns == 0 and self.release_ns == 0
