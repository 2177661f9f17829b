"""The event log ``events.jsonl``: one JSON object a line, written as it happens."""

from __future__ import annotations

from pathlib import Path

from planning.errors import OutputError
from twin.run.event_log import event_line, lock_log
from twin.run.events import Event


class JsonlRecorder:
    """Appends every event to a file at once: a killed run leaves a readable log."""

    def __init__(self, path: Path) -> None:
        """Open a new log; OutputError when that cannot be done."""
        try:
            self._file = path.open("w", buffering=1, encoding="utf-8", newline="\n")
        except OSError as error:
            raise OutputError(f"{path}: cannot write the event log: {error}") from error
        lock_log(self._file, path)

    def record(self, event: Event) -> None:
        """Write an event."""
        self._file.write(event_line(event))

    def close(self) -> None:
        """Close the file."""
        self._file.close()
