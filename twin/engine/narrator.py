"""Event log rows of a run, with details as readable text."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from planning.tasks.task import DOOR, Handling, TaskKind, TimeWindow
from scheduling.graph.dispatcher import Node
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import window_nodes
from twin.durations.nanoseconds import NANOSECONDS
from twin.recorders.observers import Observers
from twin.runs.events import Event, EventKind
from twin.runs.execution_record import waypoint_offsets_ns
from twin.runs.windows import broken_words
from twin.uncertainty.node_times import NodeTimes, Standstill
from twin.uncertainty.stop_times import Stops

_Change = tuple[int, str, str | None]


class Narrator:
    """Makes the event rows of one run.

    Attributes:
        handlings: (offset from the first motion [ns], object, holder) within a node, by chain
            and node.
        standstills: those of a robot before a node moves, by chain and node.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        times: NodeTimes,
        observers: Observers,
        now: Callable[[], int],
    ) -> None:
        """Pass events to observers; ``now`` returns the time of the run [ns]."""
        self._tpg = tpg
        self._observers = observers
        self._now = now
        self._task = [chain.task.tolist() for chain in tpg.chains]
        self.handlings = _handlings_by_node(tpg, times)
        self.standstills: dict[tuple[int, int], list[Standstill]] = {}
        for chain, stands in enumerate(times.standstills):
            for entry in stands:
                self.standstills.setdefault((chain, entry.node), []).append(entry)
        self._holder: dict[str, str] = {}
        self._ends: dict[Node, int] = {}
        self._due: dict[Node, list[tuple[Node | None, TimeWindow]]] = {}
        number = [(k, n) for k, own in enumerate(tpg.chains) for n in range(len(own))]
        for (_, done, due), window in zip(
            window_nodes(tpg).tolist(), tpg.windows, strict=True
        ):
            opens = None if done == TimeWindow.EARLIER else number[done]
            self._due.setdefault(number[due], []).append((opens, window))
        self._doors = {item.name for item in tpg.cell.objects if item.kind == DOOR}

    def of(self, tpg: TemporalPlanGraph, times: NodeTimes) -> Narrator:
        """Return a narrator that continues the same run with another graph."""
        other = Narrator(tpg, times, self._observers, self._now)
        other._holder, other._ends = self._holder, self._ends
        return other

    def emit(
        self,
        kind: EventKind,
        chain: int = -1,
        node: int = -1,
        name: str = "",
        detail: str = "",
        *,
        t_ns: int | None = None,
    ) -> None:
        """Emit an event now, or at a time [ns]."""
        when = self._now() if t_ns is None else t_ns
        robot = self._tpg.chains[chain].robot if chain >= 0 else ""
        task = self._task[chain][node] if node >= 0 else -1
        self._observers.record(Event(when, robot, kind, task, node, name, detail))
        if not self._due:
            return
        if kind == "completed":
            self._ends[chain, node] = when
        for opens, window in self._due.get((chain, node), ()):
            # By a planned clock it may begin before.
            opened = -round(window.ago * NANOSECONDS)
            if opens is not None:
                opened = self._ends.get(opens, when)
            words = broken_words(window, when - opened)
            if kind == "started" and words:
                self.emit("window_broken", chain, node, detail=words, t_ns=when)

    def held_by(self, holders: Mapping[str, str]) -> None:
        """Set the holders of objects where the run is continued."""
        self._holder = dict(holders)

    def close(self) -> None:
        """Close the recorders."""
        self._observers.close()

    def handle(self, chain: int, node: int, name: str, holder: str | None) -> None:
        """Emit the transfer of an object."""
        giver = self._holder.pop(name, None)
        if holder == Handling.GONE:
            detail = "opens" if name in self._doors else "leaves the cell"
            self.emit("detached", chain, node, name, detail)
            return
        if holder is None:
            detail = "put down"
            if giver is None:
                task, item = self._tpg.task_at(chain, node), self._tpg.cell.object(name)
                tried = task.kind == TaskKind.FAILED and task.object == name
                comes = item.later and not tried
                detail = (
                    "comes up at its station" if comes else "found beside its place"
                )
            detail = "shuts" if name in self._doors else detail
            self.emit("detached", chain, node, name, detail)
            return
        self._holder[name] = holder
        detail = f"to {holder}" if giver is None else f"from {giver} to {holder}"
        self.emit("attached", chain, node, name, detail)

    def stands(self, chain: int, node: int, entry: Standstill) -> None:
        """Emit the begin of a standstill; a failed attempt is emitted at its end."""
        seconds = f"{entry.duration_ns / NANOSECONDS:.3f} s"
        if entry.cause == "stall":
            self.emit("stalled", chain, node, detail=f"for {seconds}")
        elif entry.cause == "breakdown":
            detail = f"breakdown, repaired after {seconds}"
            self.emit("stopped", chain, node, detail=detail)

    def end_standstill(
        self, chain: int, node: int, entry: Standstill, attempt: int
    ) -> None:
        """Emit the end of a standstill, with the attempt of a retry (from 1)."""
        if entry.cause == "retry":
            seconds = f"{entry.duration_ns / NANOSECONDS:.3f} s"
            detail = f"attempt {attempt} failed after {seconds}"
            self.emit("retried", chain, node, detail=detail)
        else:
            self.emit("resumed", chain, node)

    def stopped(self, stops: Sequence[Stops], chain: int, node: int, t_ns: int) -> None:
        """Emit stops of a robot that begin or end at a time.

        Overlapping stops end together, each with its own row: so readers can distinguish them from
            a breakdown at the same time.

        Args:
            stops: stops of every robot.
            chain: index of the robot's chain.
            node: the current node, -1 for none.
            t_ns: the time [ns].
        """
        known = [s for s in stops[chain].until(t_ns) if s.end_ns > s.start_ns]
        for stop in known:
            if stop.start_ns == t_ns:
                self.emit("stopped", chain, node, "", stop.reason, t_ns=t_ns)
        for begin, end in stops[chain].intervals(t_ns + 1):
            if end == t_ns:
                for _ in range(sum(begin <= s.start_ns < end for s in known)):
                    self.emit("resumed", chain, node, t_ns=t_ns)


def describe_failure(tpg: TemporalPlanGraph, times: NodeTimes, chain: int) -> str:
    """Return a sentence on the task that failed for good."""
    node = times.failed[chain]
    task = tpg.task_at(chain, node)
    attempts = sum(
        entry.node == node and entry.cause == "retry"
        for entry in times.standstills[chain]
    )
    return (
        f"task {task.index} ({task.label}) of {tpg.chains[chain].robot}: "
        f"attempt {attempts} of {attempts} failed"
    )


def _handlings_by_node(
    tpg: TemporalPlanGraph, times: NodeTimes
) -> dict[tuple[int, int], list[_Change]]:
    """Return the handlings of each node, in order of time."""
    offsets = [
        waypoint_offsets_ns(chain, motion)
        for chain, motion in zip(tpg.chains, times.motion, strict=True)
    ]
    found: dict[tuple[int, int], list[_Change]] = {}
    for item in tpg.handlings:
        chain = tpg.chains[item.robot]
        waypoint = int(chain.first[item.node]) + item.waypoint - 1
        offset = int(offsets[item.robot][waypoint]) if item.waypoint > 0 else 0
        change = (offset, item.object, item.holder)
        found.setdefault((item.robot, item.node), []).append(change)
    for changes in found.values():
        changes.sort(key=lambda change: change[0])
    return found
