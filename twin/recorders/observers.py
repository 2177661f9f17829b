"""Recorders, which observe the events of a run; none can stop it."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Protocol

from twin.run.events import Event

_log = logging.getLogger(__name__)


class Recorder(Protocol):
    """Recorder: receives every event, in order."""

    def record(self, event: Event) -> None:
        """Take note of an event."""
        ...

    def close(self) -> None:
        """Finish; called once, also after a run that failed."""
        ...


class Observers:
    """Passes events on to recorders and drops those that fail, with a warning."""

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        """Watch with some recorders."""
        self._recorders = list(recorders)

    def __bool__(self) -> bool:
        """Tell whether any recorder is left."""
        return bool(self._recorders)

    def record(self, event: Event) -> None:
        """Pass an event on."""
        for recorder in tuple(self._recorders):
            try:
                recorder.record(event)
            except Exception as error:
                self._recorders.remove(recorder)
                _warn(recorder, error, f"at {event.t_ns / 1e9:.3f} s")
                _close(recorder)

    def close(self) -> None:
        """Close every recorder that is left."""
        while self._recorders:
            _close(self._recorders.pop(0))


def _close(recorder: Recorder) -> None:
    try:
        recorder.close()
    except Exception as error:
        _warn(recorder, error, "when closed")


def _warn(recorder: Recorder, error: Exception, where: str) -> None:
    name = type(recorder).__name__
    _log.warning("%s failed %s and records no more: %s", name, where, error)
