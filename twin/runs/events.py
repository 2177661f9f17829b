"""Events of a run, and the log ``events.jsonl``: its lines, written and read."""

from __future__ import annotations

import json
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from enum import StrEnum
from pathlib import Path
from typing import Literal, cast, get_args

from planning.bounds import LATEST_S
from planning.errors import OutputError, TwinError
from planning.files import read_file
from planning.json_files import parse_json
from twin.durations.nanoseconds import NANOSECONDS

EventKind = Literal[
    "released",
    "started",
    "completed",
    "waiting",
    "attached",
    "detached",
    "stalled",
    "resumed",
    "stopped",
    "failed",
    "retried",
    "window_broken",
    "replanned",
    "recovered",
    "asked",
    "ordered",
    "finished",
]
_KINDS = frozenset(get_args(EventKind))

LARGEST_LOG = 256 << 20
"""Most bytes of an event log [B]."""

MOST_LINES = 4_000_000
"""Most lines of an event log."""


class EventCode(StrEnum):
    """Event details that programs act on; the value is the detail as the log has it."""

    COMPLETED = "completed"
    FAILED = "failed"
    ABORTED = "aborted"
    INTERRUPTED = "interrupted by the user"
    OUT_OF_SERVICE = "is out for good"
    DISPATCHER_RESTARTED = "the dispatcher was started anew"
    HOLD = "hold"
    GO_ON = "go on"
    OUT = "out"


@dataclass(frozen=True, slots=True)
class Event:
    """An event of a run.

    Attributes:
        t_ns: time since the start of the run [ns].
        robot: name of the robot, empty for the whole cell.
        kind: kind of event.
        task: index of the task, -1 where there is none.
        node: index of the robot's TPG node, -1 where there is none.
        object: name of the object, empty where there is none.
        detail: more, for people and for causes, such as the edge waited for.
    """

    t_ns: int
    robot: str
    kind: EventKind
    task: int = -1
    node: int = -1
    object: str = ""
    detail: str = ""

    @property
    def code(self) -> EventCode | None:
        """Code of the detail, None where it is text for people."""
        try:
            return EventCode(self.detail)
        except ValueError:
            return None

    @classmethod
    def parse(cls, line: str) -> Event:
        """Return the event of one line; its time is exact.

        Raises:
            EventLogError: the line is no event.
        """
        try:
            row = parse_json(line, Decimal)
        except ValueError as error:
            raise EventLogError(
                f"not JSON: {error}: {_excerpt(line)}", line=line
            ) from error
        except InvalidOperation as error:
            far = "an exponent that no number has"
            raise EventLogError(f"{far}: {_excerpt(line)}", line=line) from error
        if not isinstance(row, dict):
            raise EventLogError(f"not an object: {_excerpt(line)}", line=line)
        try:
            seconds = row["t_s"]
            robot, kind = row["robot"], row["kind"]
        except KeyError as error:
            raise EventLogError(
                f"no {error.args[0]!r}: {_excerpt(line)}", line=line
            ) from error
        if not isinstance(kind, str) or kind not in _KINDS:
            short = _excerpt(str(kind))
            raise EventLogError(
                f"unknown kind {short}", line=line, choices=get_args(EventKind)
            )
        if not isinstance(seconds, int | Decimal) or isinstance(seconds, bool):
            raise EventLogError(f"t_s is no number: {_excerpt(line)}", line=line)
        if Decimal(seconds).is_nan() or not 0 <= seconds <= LATEST_S:
            raise EventLogError(
                f"t_s must be 0 to {LATEST_S:.0e}: {_excerpt(line)}", line=line
            )
        task, node = row.get("task", -1), row.get("node", -1)
        if not all(
            type(value) is int and -1 <= value < 2**31 for value in (task, node)
        ):
            raise EventLogError(
                f"task and node must be whole numbers: {_excerpt(line)}", line=line
            )
        texts = robot, row.get("object", ""), row.get("detail", "")
        if not all(isinstance(text, str) for text in texts):
            raise EventLogError(
                f"robot, object and detail must be text: {_excerpt(line)}", line=line
            )
        t_ns = round(Decimal(seconds) * NANOSECONDS)
        return cls(t_ns, robot, cast(EventKind, kind), task, node, texts[1], texts[2])


class EventLogError(TwinError):
    """A line of an event log is no event.

    Attributes:
        line: of the log.
    """

    def __init__(
        self, message: str, *, line: str, choices: tuple[str, ...] = ()
    ) -> None:
        self.line = line
        super().__init__(message, choices=choices)


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


def read_log(path: Path) -> tuple[str, ...]:
    """Return the complete lines of an event log with newlines, without a torn last one.

    Raises:
        OutputError: it cannot be read.
    """
    try:
        content = read_file(path, LARGEST_LOG)
        if content.count(b"\n") > MOST_LINES:
            raise OutputError(f"{path}: has more than {MOST_LINES} lines")
        text = content[: content.rfind(b"\n") + 1].decode("utf-8")
    except UnicodeDecodeError as error:
        raise OutputError(f"{path}: not UTF-8 (byte {error.start})") from error
    except OSError as error:
        raise OutputError(f"{path}: cannot read the event log: {error}") from error
    return tuple(line + "\n" for line in text.split("\n")[:-1])


def _excerpt(line: str) -> str:
    line = line.strip()
    return repr(line if len(line) <= 60 else f"{line[:57]}...")
