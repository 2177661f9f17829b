"""The event log ``events.jsonl``: one JSON object a line, written as it happens."""

from __future__ import annotations

import json
from pathlib import Path
from typing import IO, Any

from planning.errors import OutputError
from twin.durations import NANOSECONDS
from twin.run.events import Event


def event_line(event: Event) -> str:
    """Return an event as one line of JSON with keys in fixed order.

    ``t_s`` is written in full, nine decimals: the exact time in seconds.
    """
    seconds, rest = divmod(event.t_ns, NANOSECONDS)
    return (
        f'{{"t_s": {seconds}.{rest:09d}, "robot": {json.dumps(event.robot)}, '
        f'"kind": "{event.kind}", "task": {event.task}, "node": {event.node}, '
        f'"object": {json.dumps(event.object)}, "detail": {json.dumps(event.detail)}}}\n'
    )


def hold(file: IO[Any], path: Path) -> None:
    """Keep other processes from writing a log while this one does, until it is closed.

    Where a file system or an operating system knows no locks nothing is done.

    Raises:
        OutputError: another process holds it.
    """
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        file.close()
        raise OutputError(f"{path}: a running process writes this log") from error
    except OSError:
        return


class JsonlRecorder:
    """Appends every event to a file at once: a killed run leaves a readable log."""

    def __init__(self, path: Path) -> None:
        """Open a new log; OutputError when that cannot be done."""
        try:
            self._file = path.open("w", buffering=1, encoding="utf-8", newline="\n")
        except OSError as error:
            raise OutputError(f"{path}: cannot write the event log: {error}") from error
        hold(self._file, path)

    def record(self, event: Event) -> None:
        """Write an event."""
        self._file.write(event_line(event))

    def close(self) -> None:
        """Close the file."""
        self._file.close()
