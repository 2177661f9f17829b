"""Model of the execution of a plan: dispatch policy, random durations, message latencies and disturbances."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

from planning.errors import TwinError
from twin.durations.nanoseconds import to_nanoseconds
from twin.runs.execution_record import Policy
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.skill_durations import SkillDurations

UNLIMITED = 2**40
"""Queue length without limit: larger than the number of nodes of any plan."""

OTHER = 2
"""Cause of a wait without an edge of the plan: a message in transit, the clock, the sequence."""


class Messages(NamedTuple):
    """Queue depth and latencies of messages between robots and dispatcher.

    Attributes:
        queue_depth: actions sent to a robot of which completion is not yet reported, at most; None
            for one, and for as many as are safe where robots need to know how far they may go.
        report_ns: time a message takes from robot to dispatcher [ns].
        release_ns: time a message takes from dispatcher to robot [ns].
    """

    queue_depth: int | None = None
    report_ns: int = 0
    release_ns: int = 0

    @classmethod
    def of_seconds(
        cls,
        queue_depth: int | None = None,
        report_s: float = 0.0,
        release_s: float = 0.0,
    ) -> Messages:
        """Return messages with latencies in seconds; TwinError if a number is out of range."""
        if queue_depth is not None and queue_depth < 1:
            raise TwinError(f"queue_depth must be at least 1, not {queue_depth}")
        for value in (report_s, release_s):
            if not 0 <= value < math.inf:
                raise TwinError(f"a latency must be at least 0 s, not {value}")
        report, release = to_nanoseconds([report_s, release_s]).tolist()
        return cls(queue_depth, report, release)

    def under(self, policy: Policy) -> Messages:
        """Return the messages that a policy uses where robots have no acceleration limits.

        Open loop there are no messages; sequentially the queue depth is one node.
        """
        if policy == "open-loop":
            return Messages()
        return self._replace(queue_depth=1) if policy == "sequential" else self

    def ahead(self, *, driven: bool) -> int:
        """Return the maximum number of released nodes of a robot not yet reported complete.

        Args:
            driven: whether robots keep to limits of acceleration, so that they can only go as
                fast as they know how far.
        """
        if self.queue_depth is not None:
            return self.queue_depth
        return UNLIMITED if driven else 1

    @property
    def instant(self) -> bool:
        """True if messages take no time; then the depth of the queues makes no difference."""
        return self.report_ns == 0 and self.release_ns == 0


@dataclass(frozen=True)
class ExecutionModel:
    """Execution model: policy, durations, messages and disturbances.

    Attributes:
        durations: of skills.
        policy: ``"asynchronous"`` releases every node that is safe by the TPG; ``"sequential"`` lets
            one robot work at a time, always on the first task in planned order that is safe;
            ``"synchronous"`` lets no robot enter a slot of the plan before every robot has left the
            one before; in ``"open-loop"`` every robot follows the planned clock and never
            waits, so that robots may collide.
        messages: between robots and dispatcher.
        disturbances: disturbances of the execution.
        hold: what opens a window of time is held back until the later step will be in time with this
            probability; 0 for not at all.
    """

    durations: SkillDurations
    policy: Policy = "asynchronous"
    messages: Messages = field(default_factory=Messages)
    disturbances: Disturbances = field(default_factory=Disturbances)
    hold: float = 0.0
