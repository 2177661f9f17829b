"""Event rows of a run for recorders, with details in words (paper terms, exact times)."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import NANOSECONDS
from twin.recorders.observers import Observers
from twin.run.events import Event, EventKind
from twin.run.run_record import waypoint_offsets_ns
from twin.uncertainty.halts import Halts
from twin.uncertainty.node_times import NodeTimes, Standstill

_Change = tuple[int, str, str | None]


class Narrator:
    """Makes the event rows of one run."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        times: NodeTimes,
        observers: Observers,
        now: Callable[[], int],
    ) -> None:
        """Tell observers of a run; ``now`` returns its time [ns]."""
        self._tpg = tpg
        self._observers = observers
        self._now = now
        self._task = [chain.task.tolist() for chain in tpg.chains]
        self._handlings = _handlings_by_node(tpg, times)
        self._standstills: dict[tuple[int, int], list[Standstill]] = {}
        for chain, stands in enumerate(times.standstills):
            for entry in stands:
                self._standstills.setdefault((chain, entry.node), []).append(entry)
        self._holder: dict[str, str] = {}

    def emit(
        self,
        kind: EventKind,
        chain: int = -1,
        node: int = -1,
        name: str = "",
        detail: str = "",
    ) -> None:
        """Tell of an event that happens now."""
        self._emit_at(self._now(), kind, chain, node, name, detail)

    def close(self) -> None:
        """Tell that there is no more to come."""
        self._observers.close()

    def handlings(self, chain: int, node: int) -> Sequence[_Change]:
        """Return (offset from the first motion [ns], object, holder) within a node."""
        return self._handlings.get((chain, node), ())

    def standstills(self, chain: int, node: int) -> Sequence[Standstill]:
        """Return the standstills of a robot before a node moves."""
        return self._standstills.get((chain, node), ())

    def handle(self, chain: int, node: int, name: str, holder: str | None) -> None:
        """Tell that an object changes hands."""
        giver = self._holder.pop(name, None)
        if holder is None:
            detail = "comes up at its station" if giver is None else "put down"
            self.emit("detached", chain, node, name, detail)
            return
        self._holder[name] = holder
        detail = f"to {holder}" if giver is None else f"from {giver} to {holder}"
        self.emit("attached", chain, node, name, detail)

    def stands(self, chain: int, node: int, entry: Standstill) -> None:
        """Tell that a robot begins to stand; a failed attempt is told of at its end."""
        seconds = f"{entry.duration_ns / NANOSECONDS:.3f} s"
        if entry.cause == "stall":
            self.emit("stalled", chain, node, detail=f"for {seconds}")
        elif entry.cause == "breakdown":
            detail = f"breakdown, repaired after {seconds}"
            self.emit("stopped", chain, node, detail=detail)

    def goes_on(self, chain: int, node: int, entry: Standstill, attempt: int) -> None:
        """Tell that a robot has stood long enough.

        Args:
            chain, node: where.
            entry: why it stood.
            attempt: number of the attempt that failed, from 1; of no account otherwise.
        """
        if entry.cause == "retry":
            seconds = f"{entry.duration_ns / NANOSECONDS:.3f} s"
            detail = f"attempt {attempt} failed after {seconds}"
            self.emit("retried", chain, node, detail=detail)
        else:
            self.emit("resumed", chain, node)

    def stopped(self, halts: Sequence[Halts], chain: int, node: int, t_ns: int) -> None:
        """Tell of the stops of a robot by the clock that begin or end at a time.

        Stops that overlap end together, each with a row of its own: so whoever reads the rows can
        tell them from a breakdown during which they happen.

        Args:
            halts: stops of every robot.
            chain: index of the robot's chain.
            node: the node under way, -1 for none.
            t_ns: the time [ns].
        """
        stops = [s for s in halts[chain].stops(t_ns) if s.end_ns > s.start_ns]
        for stop in stops:
            if stop.start_ns == t_ns:
                self._emit_at(t_ns, "stopped", chain, node, "", stop.reason)
        for begin, end in halts[chain].intervals(t_ns + 1):
            if end == t_ns:
                for _ in range(sum(begin <= s.start_ns < end for s in stops)):
                    self._emit_at(t_ns, "resumed", chain, node, "", "")

    def _emit_at(
        self,
        t_ns: int,
        kind: EventKind,
        chain: int,
        node: int,
        name: str,
        detail: str,
    ) -> None:
        robot = self._tpg.chains[chain].robot if chain >= 0 else ""
        task = self._task[chain][node] if node >= 0 else -1
        self._observers.record(Event(t_ns, robot, kind, task, node, name, detail))


def waiting_cause(
    tpg: TemporalPlanGraph,
    dispatcher: Dispatcher,
    chain: int,
    node: int,
    *,
    sequential: bool = False,
) -> str:
    """Return the cause for which a node has not been released, in words."""
    waited_for = [
        f"{tpg.chains[k].robot} to complete node {n} "
        f"({tpg.tasks[int(tpg.chains[k].task[n])].label})"
        for k, n in dispatcher.waits_for(chain, node)
    ]
    if waited_for:
        return "waits for " + " and ".join(waited_for)
    return "waits for its turn" if sequential else "waits for its release"


def failure_text(tpg: TemporalPlanGraph, times: NodeTimes, chain: int) -> str:
    """Return which task of a robot failed for good, in words."""
    node = times.failed[chain]
    task = tpg.tasks[int(tpg.chains[chain].task[node])]
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
    """Return (offset, object, holder) of the handlings of each node, in order of time."""
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
    return {node: [*changes] for node, changes in found.items()}
