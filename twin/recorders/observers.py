"""Recorders of the events of a run, in a file or in memory; a recorder that fails does not stop the run."""

from __future__ import annotations

import logging
import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Protocol

from planning.errors import OutputError
from twin.runs.events import Event, event_line

_log = logging.getLogger(__name__)


class Recorder(Protocol):
    """Receives every event of a run, in order."""

    def record(self, event: Event) -> None:
        """Record an event."""
        ...

    def close(self) -> None:
        """Finish; called once, also after a run that failed."""
        ...


class Observers:
    """Passes events on to recorders and drops those that fail, with a warning."""

    def __init__(self, recorders: Sequence[Recorder]) -> None:
        """Observe with some recorders."""
        self._recorders = list(recorders)

    def __bool__(self) -> bool:
        """Return whether any recorder is left."""
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


class JsonlRecorder:
    """Appends every event to a file immediately, so that the log of a killed run is readable."""

    def __init__(self, path: Path, kept: int = 0) -> None:
        """Open a log and lock it.

        Args:
            path: of the log.
            kept: bytes at its beginning that stay.

        Raises:
            OutputError: it cannot be written.
        """
        try:
            self._file = path.open("a", buffering=1, encoding="utf-8", newline="\n")
            self._file.truncate(kept)
        except OSError as error:
            raise OutputError(f"{path}: cannot write the event log: {error}") from error
        self._path = path
        self._error: OSError | None = None

    def record(self, event: Event) -> None:
        """Write an event."""
        try:
            self._file.write(event_line(event))
        except OSError as error:
            self._error = error
            raise

    def sync(self) -> None:
        """Flush all events to the disk.

        Raises:
            OutputError: one could not be written.
        """
        if self._error is None:
            with suppress(OSError):
                self._to_disk()
        self.require_whole()

    def _to_disk(self) -> None:
        try:
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            self._error = self._error or error
            raise

    def close(self) -> None:
        """Flush to the disk and close the file."""
        try:
            self._to_disk()
        finally:
            with suppress(OSError):
                self._file.close()

    def require_whole(self) -> None:
        """Check that no event is missing in the log.

        Raises:
            OutputError: some event, or the end of the file, could not be written.
        """
        if self._error is not None:
            raise OutputError(f"{self._path}: events are missing: {self._error}")


class MemoryRecorder:
    """Keeps every event.

    Attributes:
        events: all events so far, in order.
    """

    def __init__(self) -> None:
        """Start with no events."""
        self.events: list[Event] = []

    def record(self, event: Event) -> None:
        """Keep an event."""
        self.events.append(event)

    def close(self) -> None:
        """Do nothing."""
