"""State of a run from its log, from which a restarted dispatcher continues, and its measured samples.

``measured.csv`` has every sample of every robot as received, so that a kill loses none of them. Where
samples were lost, as after a driver was killed, a robot's position is inferred from its clearances: it
followed its path, and stood. A straight line between two samples would cut the corners of that path,
through whatever they
lead around.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TextIO

import numpy as np

from planning.bounds import LATEST_S
from planning.errors import OutputError, TwinError
from planning.files import open_regular
from planning.motion.near_path import nearest_points_on_path
from planning.transforms import Array
from scheduling.graph.dispatcher import Node
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drivers.driver import ClearedNode, Sample
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.events import Event, EventCode
from twin.runs.execution_record import Measured
from twin.runs.folder import LARGEST_RESULT

MEASURED = "measured.csv"
"""File of the measured samples of a run."""

_BEGIN = "#begin"
"""First column of the line with the start of the run."""

_LONGEST_LINE = 1 << 16
"""Most bytes of a line."""

_UNSEEN_NS = 100_000_000
"""Interval between samples above which others count as lost [ns]."""

_LATER_S = 1e-6
"""How much later than the one before each of them was measured, by the clock of the driver [s]."""


@dataclass
class MeasuredRows:
    """Measured rows of a robot: all while it moves, and both ends of each standstill.

    Attributes:
        t_ns, q, node: see ``Measured``; where it stands, the first row is of the node before, the last one of
            that which it then begins.
        begin_ns, end_ns: when it began each of its nodes, and was through with it.
        cleared_ns: clearance times of its nodes; by any clock, none began earlier.
        last: the last sample, and when it was taken in the run [ns]; None before the first.
    """

    t_ns: list[int] = field(default_factory=list)
    q: list[Array] = field(default_factory=list)
    node: list[int] = field(default_factory=list)
    begin_ns: list[int] = field(default_factory=list)
    end_ns: list[int] = field(default_factory=list)
    cleared_ns: list[int] = field(default_factory=list)
    last: tuple[int, Sample] | None = None
    _stood: tuple[int, Array] | None = None

    def is_new(self, state: Sample) -> bool:
        """Return whether a sample is later than all recorded ones.

        A restarted driver may have another clock, but its completed nodes never decrease.
        """
        if self.last is None:
            return True
        own = self.last[1]
        return (state.done, state.begun, state.at_s) > (own.done, own.begun, own.at_s)

    def add(self, t_ns: int, state: Sample) -> bool:
        """Record a sample; return whether it is new."""
        if not self.is_new(state):
            return False
        begun = self.cleared_ns[state.begun - 1 : state.begun]
        last_ns = 0 if self.last is None else self.last[0]
        t_ns = max([t_ns, last_ns, *begun])
        self.last = t_ns, state
        self.note(t_ns, state.begun, state.done)
        if state.begun == state.done:
            if self._stood is None:
                self._row(t_ns, state.q, state.done - 1)
            self._stood = t_ns, state.q
            return True
        if self._stood is not None:
            # What moved while it stood was no part of the node that it now begins.
            self._row(*self._stood, state.done - 1)
            self._row(*self._stood, state.done)
            self._stood = None
        self._row(t_ns, state.q, state.done)
        return True

    def note(self, t_ns: int, begun: int, done: int) -> None:
        """Record nodes begun and completed at a time [ns], in the order of the chain."""
        begin, end = self.begin_ns, self.end_ns
        begin += [max([t_ns, *begin[-1:], *end[-1:]])] * (begun - len(begin))
        end += [max([t_ns, *begin[done - 1 : done]])] * (done - len(end))

    def _row(self, t_ns: int, q: Array, node: int) -> None:
        if self.t_ns and t_ns <= self.t_ns[-1] and np.any(q != self.q[-1]):
            return  # its clock is known better by now, and this would be a jump
        same = self.node[-2:] == [node, node] and np.array_equal(q, self.q[-1])
        if same and np.array_equal(q, self.q[-2]):
            self.t_ns[-1] = t_ns  # it stands in the middle of a node
            return
        self.t_ns.append(t_ns)
        self.q.append(q)
        self.node.append(node)

    def measured(self) -> Measured:
        """Return the measured motion."""
        return Measured(np.array(self.t_ns), np.array(self.q), np.array(self.node))


class MeasuredLog:
    """Appends samples to a file.

    Args:
        path: of the file; None for nowhere.
    """

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._file: TextIO | None = None
        self._first: dict[str, Sample] = {}
        self._last: dict[str, str] = {}

    def begin_s(self) -> float | None:
        """Return the start of the run by the machine's clock [s]; None if unknown."""
        for first, *rest in self._lines():
            with suppress(ValueError, IndexError):
                if first == _BEGIN:
                    return float(rest[0])
        return None

    def before(
        self, known: Mapping[str, tuple[int, int]]
    ) -> Iterator[tuple[str, int, Sample]]:
        """Yield the rows of the file: robot, time in the run [ns], sample; invalid rows are skipped.

        Args:
            known: numbers of joints and of released nodes of each robot.

        Raises:
            OutputError: the file cannot be read, or is too large.
        """
        for robot, *rest in self._lines():
            with suppress(ValueError, KeyError):
                joints, nodes = known[robot]
                t_ns, at_s, begun, done, *q = rest
                time_ns = int(t_ns)
                own = Sample(float(at_s), np.array(q, float), int(begun), int(done))
                if (
                    len(q) == joints
                    and np.isfinite([own.at_s, *own.q]).all()
                    and 0 <= time_ns <= LATEST_S * NANOSECONDS
                    and 0 <= own.done <= own.begun <= min(own.done + 1, nodes)
                ):
                    yield robot, time_ns, own

    def _lines(self) -> Iterator[list[str]]:
        """Yield the columns of every complete line."""
        if self._path is None or not self._path.exists():
            return
        try:
            with open_regular(self._path) as file:
                if os.fstat(file.fileno()).st_size > LARGEST_RESULT:
                    raise OutputError(
                        f"{self._path}: larger than {LARGEST_RESULT >> 20} MiB"
                    )
                for line in iter(lambda: file.readline(_LONGEST_LINE), b""):
                    *columns, end = line.decode(errors="replace").split(",")
                    if columns and end.rstrip("\n") == ";":
                        yield columns
        except OSError as error:
            raise OutputError(f"{self._path}: cannot be read: {error}") from error

    def begin(self, begin_s: float) -> None:
        """Write the start of the run by the machine's clock [s]."""
        self._append(f"{_BEGIN},{begin_s!r}")
        self.flush()

    def write(self, robot: str, t_ns: int, own: Sample) -> None:
        """Append a sample of a robot at a time in the run [ns]; only first and last of a standstill."""
        first, q = self._first.get(robot), ",".join(map(repr, own.q.tolist()))
        line = f"{robot},{t_ns},{own.at_s!r},{own.begun},{own.done},{q}"
        if first is not None and _stands(first, own):
            self._last[robot] = line
            return
        if (last := self._last.pop(robot, None)) is not None:
            self._append(last)
        self._first[robot] = own
        self._append(line)

    def _append(self, line: str) -> None:
        if self._path is None:
            return
        if self._file is None:
            self._file = self._path.open("a", buffering=1 << 16)
            if self._file.tell():  # the last line may not have been written to its end
                self._file.write("\n")
        self._file.write(f"{line},;\n")

    def close(self) -> None:
        """Close the file, with the end of standstills that last."""
        try:
            for line in self._last.values():
                self._append(line)
        finally:
            if self._file is not None:
                self._file.close()

    def flush(self) -> None:
        """Flush the file to the operating system."""
        if self._file is not None:
            self._file.flush()


def _stands(first: Sample, own: Sample) -> bool:
    """Return whether a robot has stood since a sample: between two nodes, or at the same point of one."""
    if (first.begun, first.done) != (own.begun, own.done):
        return False
    return own.begun == own.done or np.array_equal(first.q, own.q)


def samples_between(
    before: tuple[int, Sample],
    after: tuple[int, Sample],
    nodes: Sequence[ClearedNode],
    cleared_ns: Sequence[int],
    start: Array,
) -> list[tuple[int, Sample]]:
    """Return the corners of a robot's path between two samples, passed as fast as planned.

    Args:
        before, after: both samples with their times in the run [ns].
        nodes: all that it was cleared for, from its first one on.
        cleared_ns: when it was cleared for each [ns]; it passes no corner of a node before.
        start: where the first one begins, shape (n,).

    Returns:
        Times in the run [ns] and samples, in order; none where nothing need have been lost.
    """
    (begin_ns, first), (end_ns, last) = before, after
    near = end_ns - begin_ns <= _UNSEEN_NS or last.done > len(nodes)
    if near or last.done < first.done or np.array_equal(first.q, last.q):
        return []
    found: list[tuple[int, Sample]] = []
    t_ns = begin_ns

    def pass_by(q: Array, begun: int, done: int) -> None:
        at_s = first.at_s + (len(found) + 1) * _LATER_S
        found.append((min(t_ns, end_ns), Sample(at_s, q, begun, done)))

    gone, until = _passed(nodes, first, start), _passed(nodes, last, start)
    q = first.q
    for k in range(first.done, min(last.begun, len(nodes))):
        own, whole = nodes[k], k < last.done
        t_ns = max(t_ns, cleared_ns[k])
        if k >= first.begun:
            pass_by(q, k + 1, k)
        for corner, second in zip(own.waypoints, own.seconds, strict=True):
            ends = whole and second == own.seconds[-1]
            if k == first.done and second <= gone and not ends:
                continue
            if not whole and second >= until:
                break
            t_ns += round(max(second - gone, 0.0) * NANOSECONDS)
            gone, q = float(second), corner
            pass_by(q, k + 1, k + bool(ends))
        gone = 0.0
    return found


def _passed(nodes: Sequence[ClearedNode], sample: Sample, start: Array) -> float:
    """Return the planned time into the current node at the robot's position [s]."""
    k = sample.done
    if sample.begun == k:
        return 0.0
    before = nodes[k - 1].waypoints[-1] if k else start
    near = nearest_points_on_path(
        np.vstack([before, nodes[k].waypoints]), sample.q[None]
    )
    return nodes[k].passed_s(int(near.leg[0]), float(near.share[0]))


@dataclass
class History:
    """History of a run.

    Attributes:
        cleared_ns, start_ns, end_ns: release, start and end of each node of each chain, as far
            as they were, one entry a chain [ns].
        finished: chains that have come to their end.
        holders: robot that holds each held object.
        handled: number of logged handlings of each node, by chain and node.
        held: robots stopped by a person.
        starts: how often the dispatcher was started.
        since_ns: how late it is in the run [ns].
    """

    cleared_ns: list[list[int]] = field(default_factory=list)
    start_ns: list[list[int]] = field(default_factory=list)
    end_ns: list[list[int]] = field(default_factory=list)
    finished: set[int] = field(default_factory=set)
    holders: dict[str, str] = field(default_factory=dict)
    handled: Counter[Node] = field(default_factory=Counter)
    held: set[str] = field(default_factory=set)
    starts: int = 1
    since_ns: int = 0


def history_of(tpg: TemporalPlanGraph, events: Sequence[Event]) -> History:
    """Return the history in a log.

    Args:
        tpg: the plan.
        events: the log.

    Raises:
        TwinError: the run was replanned, which cannot be reconstructed from the log.
    """
    chains = tpg.chain_index
    cleared, begun, done = (list[list[int]]() for _ in range(3))
    for own in (cleared, begun, done):
        own += [[] for _ in tpg.chains]
    found = History(cleared, begun, done)
    rows = {
        "released": found.cleared_ns,
        "started": found.start_ns,
        "completed": found.end_ns,
    }
    for event in events:
        if event.kind in ("failed", "replanned", "recovered"):
            at = f"{event.t_ns / 1e9:.3f} s"
            raise TwinError(
                f"at {at} something failed ({event.detail}): what was planned since is not in the log, so"
                " that the run cannot continue from there; clear the cell and run the rest"
            )
        found.since_ns = max(found.since_ns, event.t_ns)
        if event.code is EventCode.DISPATCHER_RESTARTED:
            found.starts += 1
        elif event.kind == "ordered":
            names = {event.robot} if event.robot else set(chains)
            hold = event.code is EventCode.HOLD
            found.held = found.held - names | (names if hold else set())
        elif event.robot in chains:
            k = chains[event.robot]
            if event.kind in rows:
                rows[event.kind][k].append(event.t_ns)
            elif event.kind == "finished":
                found.finished.add(k)
            elif event.kind in ("attached", "detached"):
                found.handled[k, event.node] += 1
                found.holders.pop(event.object, None)
                if event.kind == "attached":
                    found.holders[event.object] = event.robot
    return found
