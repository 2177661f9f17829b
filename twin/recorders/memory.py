"""Events kept in memory, for what is computed after a run."""

from __future__ import annotations

from twin.run.events import Event


class MemoryRecorder:
    """Keeps every event.

    Attributes:
        events: what happened so far, in order.
    """

    def __init__(self) -> None:
        """Start with no events."""
        self.events: list[Event] = []

    def record(self, event: Event) -> None:
        """Keep an event."""
        self.events.append(event)

    def close(self) -> None:
        """Do nothing."""
