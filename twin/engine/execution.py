"""Execution of a temporal plan graph: the state of one run, and the dispatcher (APEX-MR, section IV-D).

``Dispatcher`` in scheduling/graph/dispatcher.py finds the nodes that may start; ``Execution`` releases them to robots.
The module ``ports`` defines the interfaces of an execution to robots, object deliveries, replanning and people.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Any

import simpy
from simpy.events import EventPriority

from scheduling.graph.dispatcher import Dispatcher, Node, timed_edges
from scheduling.graph.task_edges import turn_order
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import Nanoseconds, require_within_longest_run
from twin.engine.ending import Ending
from twin.engine.execution_model import Messages
from twin.engine.narrator import Narrator
from twin.engine.ports import Audience, Replanner, RobotPort, Steps, SupplyPort
from twin.recorders.observers import Observers
from twin.runs.events import EventCode
from twin.runs.execution_record import Outcome
from twin.uncertainty.node_times import NodeTimes


@dataclass(frozen=True)
class Ports:
    """Factories of the interface objects (ports) of an execution; each takes the execution as argument.

    Attributes:
        robots: execute nodes.
        supply: objects that arrive late; None if all are present from the beginning.
        replanner: extends the graph after failures, see twin/operations/replanner.py; None for a fixed graph.
        audience: people next to the cell; None for none.
    """

    robots: Callable[[Execution], RobotPort]
    supply: Callable[[Execution], SupplyPort] | None = None
    replanner: Callable[[Execution], Replanner] | None = None
    audience: Callable[[Execution], Audience] | None = None


class Execution:
    """State of one run in progress, and its dispatcher.

    Attributes:
        robots, supply, replanner, audience: its ports.
        ended: cause of an end before the plan is complete; None without a known cause.
        failed: chains whose task has failed for good, without a replanner.
        finished: number of nodes of each chain when it was last reported finished.
        revision: number of the graph that is executed, from 1.
        gates: functions of ports; a safe node is released once all of them return True for its chain.
        release_hooks: functions of ports, called with chain and node after a release.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        times: NodeTimes,
        dispatcher: Dispatcher,
        messages: Messages,
        ports: Ports,
        *,
        sequential: bool = False,
        planned: Sequence[Nanoseconds] | None = None,
        observers: Observers | None = None,
    ) -> None:
        """Initialize the state at time 0.

        Args:
            tpg: graph to execute.
            times: how long every node takes and stands.
            dispatcher: of the graph, nothing complete yet.
            messages: between robots and dispatcher.
            ports: makers of the ports.
            sequential: whether one robot works at a time.
            planned: start of every node by the planned clock [ns], which all robots then
                follow without a dispatcher.
            observers: notified of every event.
        """
        self.tpg = tpg
        self.times = times
        self.messages = messages
        self.sequential = sequential
        self.stops = times.stops
        self.planned = None if planned is None else [row.tolist() for row in planned]
        self.env = simpy.Environment(initial_time=0)
        self.dispatcher = dispatcher
        self.start: list[list[int]] = []
        self.end: list[list[int]] = []
        self.queue: list[deque[int]] = []
        self.idle: list[simpy.Event | None] = []
        self.outstanding: list[int] = []
        self.released: list[int] = []
        self._resize([0] * len(tpg.chains))
        self._turns = deque(turn_order(tpg)) if sequential and self.machines else None
        self.impatient = timed_edges(tpg)
        self.failed: list[int] = []
        self.finished: dict[int, int] = {}
        self.ended: Ending | None = None
        self.revision = 1
        self.gates: list[Callable[[int], bool]] = []
        self.release_hooks: list[Callable[[int, int], None]] = []
        self._withdrawn: Counter[Node] = Counter()
        self._reports: list[Node] = []
        self._lifts: list[tuple[Node, Node]] = []
        self._report_arrived = self.env.event()
        self.audience = ports.audience and ports.audience(self)
        if self.audience is not None:
            own = () if observers is None else (observers,)
            observers = Observers((*own, self.audience))
        self.narrator = (
            Narrator(tpg, times, observers, lambda: int(self.env.now))
            if observers
            else None
        )
        self.supply = ports.supply and ports.supply(self)
        self.replanner = ports.replanner and ports.replanner(self)
        self.robots = ports.robots(self)
        self.ahead = messages.ahead(driven=self.robots.driven)

    @property
    def now_ns(self) -> int:
        """Time that has passed [ns]."""
        return int(self.env.now)

    def execute(self) -> Outcome:
        """Run until everything is done, nothing can continue, or the user interrupts."""
        outcome: Outcome | None = None
        try:
            try:
                self.robots.begin()
                if self.replanner is not None:
                    self.replanner.begin()
                outcome = self._execute()
            finally:
                self.robots.close()
        finally:
            if self.audience is not None:
                self.audience.finish(outcome)
        return outcome

    def _execute(self) -> Outcome:
        for chain in range(len(self.tpg.chains)):
            self.env.process(self._robot(chain))
        if self.planned is None:
            self.env.process(self._dispatch())
        outcome: Outcome = "failed"
        try:
            edge_ns = math.inf
            if self.narrator is not None and self.stops is not None:
                edge_ns = min(own.next_edge(-1) for own in self.stops)
            upcoming, step = self.robots.upcoming, self.env.step
            while (due_ns := upcoming()) < math.inf:
                if edge_ns <= due_ns:
                    edge_ns = self._report_stops(edge_ns, due_ns)
                step()
            if self.is_done():
                short = self.replanner is not None and self.replanner.short
                outcome = "failed" if short else "completed"
            elif self.narrator is not None and not self.failed:
                self.narrator.emit("failed", detail=self.deadlock())
        except KeyboardInterrupt:
            outcome = "aborted"
            if self.narrator is not None:
                self.narrator.emit("stopped", detail=EventCode.INTERRUPTED.value)
        finally:
            if self.narrator is not None:
                self.narrator.emit("finished", detail=outcome)
                self.narrator.close()
        return outcome

    def is_done(self) -> bool:
        """Return whether all nodes are complete, apart from those of machines without deliveries."""
        coming = () if self.supply is None else self.supply.arriving
        rows = (end for k, end in enumerate(self.end) if k not in coming)
        return all(not end or end[-1] >= 0 for end in rows)

    def next_event_ns(self) -> float:
        """Return the time of the next event [ns]; infinity at the end of the run."""
        upcoming = self.env.peek()
        require_within_longest_run(upcoming)
        if self.replanner is None:
            return upcoming
        if (
            self.replanner.planning
            or not self.is_done()
            or upcoming <= max((end[-1] for end in self.end if end), default=0)
        ):
            return upcoming
        return math.inf

    def deadlock(self) -> str:
        """Return why the run ends early: its ending, or the waits of a deadlock."""
        if self.ended is not None:
            return self.ended.words
        stuck = (
            f"{chain.robot} at node {node} {self.wait_cause(k, node)}"
            for k, chain in enumerate(self.tpg.chains)
            if (node := self.released[k]) < len(chain)
        )
        return "deadlock: " + "; ".join(stuck)

    def _robot(self, chain: int) -> Steps:
        end = self.end[chain]
        node = next((n for n, t in enumerate(end) if t < 0), len(end))
        execute = self.robots.execute
        while True:
            while node < len(self.motion[chain]):
                if (yield from execute(chain, node)):
                    if self.replanner is None:
                        self.failed.append(chain)
                        return
                    yield from self.replanner.recover(chain, node)
                node += 1
            planning = self.replanner is not None and self.replanner.planning
            if not planning and self.finished.get(chain) != node:
                self.finished[chain] = node
                if self.narrator is not None:
                    self.narrator.emit("finished", chain)
            if self.replanner is None:
                return
            yield self.replanner.revised()

    def complete(self, chain: int, node: int, late_ns: int = 0) -> None:
        """Report a node complete, now or after a delay [ns]."""
        self.end[chain][node] = int(self.env.now) + late_ns
        if self.planned is None:
            delay = self.messages.report_ns + late_ns
            self.after(delay, self._receive_report, chain, node)

    def after(self, delay_ns: int, act: Callable[..., None], *about: Any) -> None:
        """Call a function after a delay [ns], such as to receive a message; immediately for 0."""
        if delay_ns <= 0:
            act(*about)
        else:
            message = self.env.timeout(delay_ns)
            message.callbacks.append(lambda _: act(*about))

    def end_of_instant(self, priority: EventPriority) -> simpy.Event:
        """Return an event after all others of lower priority number at this time."""
        event = self.env.event()
        event._ok, event._value = True, None
        self.env.schedule(event, priority=priority)
        return event

    def count_patience(self, chain: int, node: int, late_ns: int = 0) -> None:
        """Schedule the removal of timed edges from a node that begins now, or after a delay [ns]."""
        for target, patience in self.impatient.get((chain, node), ()):
            delay = late_ns + patience + self.messages.report_ns
            self.after(delay, self._lift, (chain, node), target)

    def report_wait(self, chain: int, node: int) -> None:
        """Record that a robot waits, unless it has received a node by now."""
        machine = self.supply is not None and chain in self.supply.arriving
        waits = self.idle[chain] is not None and self.start[chain][node] < 0
        if self.narrator is not None and waits and not machine:
            detail = self.wait_cause(chain, node)
            self.narrator.emit("waiting", chain, node, detail=detail)

    def wait_cause(self, chain: int, node: int) -> str:
        """Return why a node has not been released, as text."""
        waited_for = [
            f"{self.tpg.chains[k].robot} to complete node {n} "
            f"({self.tpg.tasks[self.task[k][n]].label})"
            for k, n in self.dispatcher.waits_for(chain, node)
        ]
        if waited_for:
            return "waits for " + " and ".join(waited_for)
        return "waits for its turn" if self.sequential else "waits for its release"

    def withdraw(self, chain: int, count: int) -> None:
        """Withdraw released nodes of a robot beyond its first ones, including messages in transit."""
        back = self.released[chain] - count
        if back > 0:
            self.released[chain] = count
            self.outstanding[chain] -= back
            queue = self.queue[chain]
            self._withdrawn.update((chain, n) for n in range(count, count + back))
            while queue and queue[-1] >= count:
                self._withdrawn[chain, queue.pop()] -= 1

    def redispatch(self) -> None:
        """Let the dispatcher release safe nodes now."""
        if not self._report_arrived.triggered:
            self._report_arrived.succeed()

    def dispatch_by(self, held: TemporalPlanGraph) -> None:
        """Dispatch a new graph from now on, of which no node has been reported."""
        self.dispatcher = Dispatcher(held)
        self.impatient = timed_edges(held)
        self._lifts.clear()

    def extend(
        self,
        tpg: TemporalPlanGraph,
        held: TemporalPlanGraph,
        times: NodeTimes,
        counts: Sequence[int],
        failed: Sequence[Node],
    ) -> None:
        """Replace the graph by one with the same committed prefix.

        Args:
            tpg: the graph; its first chains are those of the present one, in their order.
            held: the same graph with edges that hold back tasks that open time windows.
            times: of its nodes.
            counts: number of committed nodes of each chain.
            failed: first nodes of skills that have failed for good, which count as complete.
        """
        before = len(self.tpg.chains)
        completed = [self.dispatcher.completed(k) for k in range(before)]
        for chain, node in failed:
            completed[chain] = node + 1
        self.tpg, self.times, self.stops = tpg, times, times.stops
        self.dispatch_by(held)
        for k, count in enumerate(completed):
            if count:
                self.dispatcher.observe(k, count - 1)
        if self.supply is not None:
            self.supply.lift_unknown()
        self._resize(counts)
        for k in range(before, len(tpg.chains)):
            self.env.process(self._robot(k))
        for k, node in self.impatient:
            if (begun := self.start[k][node]) >= 0:
                self.count_patience(k, node, begun - self.now_ns)
        for chain, node in failed:
            self.outstanding[chain] = 0
            self.released[chain] = node + 1
        self.revision += 1
        self.robots.extended()
        if self.narrator is not None:
            self.narrator = self.narrator.of(tpg, times)

    def _resize(self, counts: Sequence[int]) -> None:
        for _ in range(len(self.start), len(self.tpg.chains)):
            self.start.append([])
            self.end.append([])
            self.queue.append(deque())
            self.idle.append(None)
            self.outstanding.append(0)
            self.released.append(0)
        for k, (chain, count) in enumerate(zip(self.tpg.chains, counts, strict=True)):
            more = [-1] * (len(chain) - count)
            self.start[k] = [*self.start[k][:count], *more]
            self.end[k] = [*self.end[k][:count], *more]
        self.task = [chain.task.tolist() for chain in self.tpg.chains]
        self.motion = [motion.tolist() for motion in self.times.motion]
        self.stood = [stood.tolist() for stood in self.times.stood]
        self.machines = self.tpg.machine_chains()

    def _report_stops(self, edge_ns: float, until_ns: float) -> float:
        """Record stops that begin or end until a time; return the next such time [ns].

        They are no events of the simulation, which would otherwise never run out of events.
        """
        assert self.narrator is not None
        assert self.stops is not None
        while edge_ns <= until_ns:
            at_ns = int(edge_ns)
            for chain, end in enumerate(self.end[: len(self.stops)]):
                if end and end[-1] < 0 and chain not in self.failed:
                    done = sum(t >= 0 for t in end)
                    node = done if self.start[chain][done] >= 0 else -1
                    self.narrator.stopped(self.stops, chain, node, at_ns)
            edge_ns = min(own.next_edge(at_ns) for own in self.stops)
        return edge_ns

    def _receive_report(self, chain: int, node: int) -> None:
        self._reports.append((chain, node))
        # Inlined ``redispatch``, since this is the most frequent call of all.
        if not self._report_arrived.triggered:
            self._report_arrived.succeed()

    def _lift(self, source: Node, target: Node) -> None:
        # It may be an edge of a graph that has been replaced.
        if any(to == target for to, _ in self.impatient.get(source, ())):
            self._lifts.append((source, target))
            self.redispatch()

    def enqueue(self, chain: int, node: int) -> None:
        """Let a released node arrive at its robot."""
        # Withdrawn nodes in transit arrive before those released since.
        if self._withdrawn and self._withdrawn[chain, node]:
            self._withdrawn[chain, node] -= 1
            return
        self.queue[chain].append(node)
        arrival, self.idle[chain] = self.idle[chain], None
        if arrival is not None:
            arrival.succeed()

    def _dispatch(self) -> Steps:
        """Process reports of complete nodes as they arrive, and release the nodes that become safe by them."""
        while True:
            # Reports before the start of the dispatcher count, too, as in a run continued from its log.
            self._report_arrived = self.env.event()
            for chain, node in self._reports:
                self.dispatcher.complete(chain, node)
                self.outstanding[chain] -= 1
            self._reports.clear()
            for source, target in self._lifts:
                self.dispatcher.lift(source, target)
            self._lifts.clear()
            self._release_safe()
            yield self._report_arrived

    def _release_safe(self) -> None:
        """Release nodes that have become safe and fit into the queues."""
        chains: Collection[int] = range(len(self.queue))
        if self._turns is not None:
            # One node at a time of robots; machines need not take turns.
            counts = enumerate(self.outstanding)
            busy = any(n for k, n in counts if k not in self.machines)
            if self._turns and not busy and self._next_is_safe(self._turns[0]):
                self._release(self._turns.popleft())
            chains = self.machines
        elif self.sequential:
            idle = not any(self.outstanding)
            if ready := [k for k in chains if idle and self._next_is_safe(k)]:
                self._release(min(ready, key=lambda k: self.task[k][self.released[k]]))
            return
        outstanding, ahead = self.outstanding, self.ahead
        for chain in chains:
            while outstanding[chain] < ahead and self._next_is_safe(chain):
                self._release(chain)

    def _next_is_safe(self, chain: int) -> bool:
        """Return whether the next node has no open dependency and passes the gates of all ports.

        Earlier nodes of its own robot need not be complete, since a robot executes its queue in order.
        """
        node = self.released[chain]
        if node == len(self.task[chain]):
            return False
        if self.outstanding[chain] == 0:
            safe = self.dispatcher.is_safe(chain, node)
        else:
            safe = not self.dispatcher.waits_for(chain, node)
        if safe and self.gates:
            return all(own(chain) for own in self.gates)
        return safe

    def _release(self, chain: int) -> None:
        node = self.released[chain]
        self.released[chain] += 1
        self.outstanding[chain] += 1
        if self.narrator is not None:
            self.narrator.emit("released", chain, node)
        self.after(self.messages.release_ns, self.enqueue, chain, node)
        for notify in self.release_hooks:
            notify(chain, node)
