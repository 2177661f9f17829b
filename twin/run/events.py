"""Events of a run, and the log ``events.jsonl``: its lines, written and read.

Record of one execution: outcome, node times, waits.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation
from enum import StrEnum
from pathlib import Path
from typing import Literal, NamedTuple, cast, get_args

import numpy as np

from planning.bounds import LATEST_S
from planning.errors import OutputError, TwinError
from planning.files import parse_json, read_file
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain
from twin.durations.model import NANOSECONDS, Nanoseconds
from twin.uncertainty.node_times import Standstill
from twin.uncertainty.stops import StoppedClock

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


_CODES = {code.value: code for code in EventCode}


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    Attributes:
        t_ns: time since the start of the run [ns].
        robot: who it happened to, empty for the whole cell.
        kind: what happened.
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
        """Code that the detail is the value of, None where it is text for people."""
        return _CODES.get(self.detail)


_KINDS = frozenset(get_args(EventKind))

LARGEST_LOG = 256 << 20
"""Most bytes of an event log [B]."""

MOST_LINES = 4_000_000
"""Most lines of an event log."""


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
    """Return the whole lines of an event log, each with its newline; a torn last one is left out.

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


def parse_event(line: str) -> Event:
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
    if not all(type(value) is int and -1 <= value < 2**31 for value in (task, node)):
        raise EventLogError(
            f"task and node must be whole numbers: {_excerpt(line)}", line=line
        )
    texts = robot, row.get("object", ""), row.get("detail", "")
    if not all(isinstance(text, str) for text in texts):
        raise EventLogError(
            f"robot, object and detail must be text: {_excerpt(line)}", line=line
        )
    t_ns = round(Decimal(seconds) * NANOSECONDS)
    return Event(t_ns, robot, cast(EventKind, kind), task, node, texts[1], texts[2])


def _excerpt(line: str) -> str:
    line = line.strip()
    return repr(line if len(line) <= 60 else f"{line[:57]}...")


Outcome = Literal["completed", "failed", "aborted"]
Policy = Literal["asynchronous", "sequential", "synchronous", "open-loop"]
POLICIES: tuple[Policy, ...] = (
    "asynchronous",
    "sequential",
    "synchronous",
    "open-loop",
)


class RobotWait(NamedTuple):
    """A robot stands still because its next node may not start yet, from when to when [ns]."""

    chain: int
    node: int
    start_ns: int
    end_ns: int


class Measured(NamedTuple):
    """Where a robot was, as it was measured.

    Attributes:
        t_ns: shape (rows,), never falling [ns].
        q: joint positions, shape (rows, n) [rad or m].
        node: node that each row belongs to, shape (rows,); -1 before the first.
    """

    t_ns: Nanoseconds
    q: Array
    node: Nanoseconds


@dataclass(frozen=True)
class ExecutionRecord:
    """One execution of a TPG.

    The arrays hold one entry a chain of the TPG, each of shape (nodes,). A time of -1 stands for
    what has not happened, which only occurs when the outcome is not ``"completed"``.

    Attributes:
        outcome: how it ended.
        policy: how nodes were released.
        seed, replication: what its random draws were named by.
        duration_ns: motion of each node, without stalls [ns].
        stood_ns: standstills of each node, after it started and before it moves [ns].
        start_ns: when each node started [ns].
        end_ns: when each node was complete [ns].
        makespan_ns: end of the last node, or when the run was broken off [ns].
        standstills: what ``stood_ns`` is made of, one entry a chain.
        stops_ns: when each robot was stopped by the clock, also in the middle of a node:
            start and end, without overlaps, one entry a chain [ns]. Node times include this.
        failed_nodes: the node at which each robot failed for good, -1 for none.
        failure: what failed, for people; empty when nothing did.
        raised_skills: number of skills that were drawn shorter than their joints' speed limits
            allow, and took what these allow.
        commands: what each robot was told where robots keep to limits of acceleration, one entry
            a chain; empty otherwise. Pieces of constant acceleration, each of which lasts until the
            next one begins, shape (pieces, 5): when it begins [ns], in which node, how far into it [ns],
            the speed at that moment as a share of full speed, and its change [1/ns].
        speed_override: share of planned speed at which nodes of stretches were executed, shape (nodes,)
            each; empty where it is 1 for all.
        measured: where robots were that others move, by name; those of a simulation are where their nodes
            say.
    """

    outcome: Outcome
    policy: Policy
    seed: int
    replication: int
    duration_ns: tuple[Nanoseconds, ...]
    stood_ns: tuple[Nanoseconds, ...]
    start_ns: tuple[Nanoseconds, ...]
    end_ns: tuple[Nanoseconds, ...]
    makespan_ns: int
    standstills: tuple[tuple[Standstill, ...], ...]
    stops_ns: tuple[tuple[tuple[int, int], ...], ...]
    failed_nodes: tuple[int, ...]
    failure: str
    raised_skills: int = 0
    commands: tuple[Array, ...] = ()
    speed_override: tuple[Array, ...] = ()
    measured: Mapping[str, Measured] = field(default_factory=dict)

    @property
    def makespan_s(self) -> float:
        """End of the last node [s]."""
        return self.makespan_ns / NANOSECONDS

    def wait_ns(self, chain: int) -> int:
        """Return how long a robot waited until its last node was complete [ns].

        That is the end of its last node minus the durations and stalls of its nodes, and
        minus the time for which the clock had stopped it.
        """
        done = self.end_ns[chain] >= 0
        if not np.any(done):
            return 0
        busy = self.duration_ns[chain][done].sum() + self.stood_ns[chain][done].sum()
        end = int(self.end_ns[chain][done][-1])
        return end - int(busy) - self.stopped_ns(chain, end)

    def standing_ns(self, chain: int) -> int:
        """Return how long a robot stood in the nodes that it completed [ns]."""
        return int(self.stood_ns[chain][self.end_ns[chain] >= 0].sum())

    def stopped_ns(self, chain: int, until_ns: int) -> int:
        """Return for how long the clock had stopped a robot before a time [ns]."""
        stops = self.stops_ns[chain]
        return sum(min(b, until_ns) - a for a, b in stops if a < until_ns)

    def pace(self, chain: int) -> StoppedClock:
        """Return the clock of a robot, which stands while the robot is stopped."""
        return StoppedClock(self.stops_ns[chain])

    def waits(self) -> tuple[RobotWait, ...]:
        """Return every wait that ended, by chain and time."""
        found = []
        for k, (start, end) in enumerate(zip(self.start_ns, self.end_ns, strict=True)):
            before = np.concatenate([[0], end[:-1]])
            for node in np.flatnonzero((start > before) & (start >= 0)).tolist():
                found.append(RobotWait(k, node, int(before[node]), int(start[node])))
        return tuple(found)


class DeadlockError(TwinError):
    """No robot can go on although work is left.

    Attributes:
        run: what happened until then.
    """

    def __init__(self, message: str, run: ExecutionRecord) -> None:
        """Keep the run."""
        super().__init__(message)
        self.run = run


def waypoint_offsets_ns(chain: NodeChain, duration_ns: Nanoseconds) -> Nanoseconds:
    """Return the time at which a chain passes each waypoint, from its node's first motion.

    Args:
        chain: p waypoints in its nodes.
        duration_ns: motion of each node, shape (nodes,) [ns].

    Returns:
        Shape (p,) [ns]; the last waypoint of a node has the node's duration.
    """
    per_waypoint = np.repeat(duration_ns, np.diff(chain.first))
    return np.rint(chain.fraction * per_waypoint).astype(np.int64)
