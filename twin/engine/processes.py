"""SimPy processes of one run: the robots and the dispatcher (APEX-MR IV-D)."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection, Generator, Sequence
from typing import Any

import numpy as np
import simpy
from simpy.events import EventPriority

from planning.transforms import Array
from scheduling.graph.dispatcher import Dispatcher, Node
from scheduling.graph.task_edges import machine_chains, sequential_order
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from twin.durations.model import NANOSECONDS, Nanoseconds, require_within_longest_run
from twin.engine.execution_model import Messages
from twin.engine.narrator import Narrator, failure_text
from twin.recorders.observers import Observers
from twin.run.events import EventCode, Measured, Outcome
from twin.uncertainty.node_times import NodeTimes
from twin.uncertainty.stops import Stops

_LAST = EventPriority(9)
"""Priority of what happens after everything else at the same time."""

Steps = Generator[simpy.Event, Any, None]


def impatient_edges(
    tpg: TemporalPlanGraph,
) -> dict[Node, list[tuple[Node, int]]]:
    """Return where edges lead that hold for some time at most, by source, with that time [ns]."""
    found: dict[Node, list[tuple[Node, int]]] = {}
    for k in np.flatnonzero(tpg.patience < EVER).tolist():
        a, u, b, v = tpg.edges[k].tolist()
        found.setdefault((a, u), []).append(((b, v), int(tpg.patience[k])))
    return found


class Execution:
    """State of one run in progress."""

    driven = False
    """Whether robots keep to limits of acceleration."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        times: NodeTimes,
        dispatcher: Dispatcher,
        messages: Messages,
        *,
        sequential: bool = False,
        planned: Sequence[Nanoseconds] | None = None,
        observers: Observers | None = None,
    ) -> None:
        """Set the cell up at time 0.

        Args:
            tpg: what to execute.
            times: how long every node takes and stands.
            dispatcher: of the graph, nothing complete yet.
            messages: between robots and dispatcher.
            sequential: whether one robot works at a time.
            planned: start of every node by the planned clock [ns], which all robots then
                follow without a dispatcher.
            observers: told of every event.
        """
        self.tpg = tpg
        self.times = times
        self.messages = messages
        self.ahead = messages.ahead(driven=self.driven)
        self.sequential = sequential
        self.stops = times.stops
        self.planned = None if planned is None else [row.tolist() for row in planned]
        self.env = simpy.Environment(initial_time=0)
        self.dispatcher = dispatcher
        self.narrator = (
            Narrator(tpg, times, observers, lambda: int(self.env.now))
            if observers
            else None
        )
        self.task = [chain.task.tolist() for chain in tpg.chains]
        self.motion = [motion.tolist() for motion in times.motion]
        self.stood = [stood.tolist() for stood in times.stood]
        self.start = [[-1] * len(chain) for chain in tpg.chains]
        self.end = [[-1] * len(chain) for chain in tpg.chains]
        self.queue: list[deque[int]] = [deque() for _ in tpg.chains]
        self.idle: list[simpy.Event | None] = [None] * len(tpg.chains)
        self.outstanding = [0] * len(tpg.chains)
        self.released = [0] * len(tpg.chains)
        self.machines = machine_chains(tpg)
        self.turns = self._turns() if sequential and self.machines else None
        self.impatient = impatient_edges(tpg)
        self.failed: list[int] = []
        self.reports: list[Node] = []
        self.lifts: list[tuple[Node, Node]] = []
        self.report_arrived = self.env.event()

    @property
    def now_ns(self) -> int:
        """Time that has passed [ns]."""
        return int(self.env.now)

    def execute(self) -> Outcome:
        """Run until everything is done, nothing can go on, or the user interrupts."""
        for chain in range(len(self.tpg.chains)):
            self.env.process(self._robot(chain))
        if self.planned is None:
            self.env.process(self._dispatch())
        outcome: Outcome = "failed"
        try:
            if self.narrator is not None and self.stops is not None:
                self._run_and_tell_of_stops(self.narrator, self.stops)
            else:
                while self._upcoming() < math.inf:
                    self.env.step()
            if self._done():
                outcome = self._outcome()
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

    def _done(self) -> bool:
        """Tell whether all that there is to do is done."""
        return all(not end or end[-1] >= 0 for end in self.end)

    def _outcome(self) -> Outcome:
        """Return how a run has ended in which every node was executed."""
        return "completed"

    def _upcoming(self) -> float:
        """Return when something happens next [ns]; infinity at the end of the run."""
        upcoming = self.env.peek()
        require_within_longest_run(upcoming)
        return upcoming

    def node_times(self) -> NodeTimes:
        """Return how long nodes took, and where robots stood."""
        return self.times

    def commands(self) -> tuple[Array, ...]:
        """Return what each robot was told, see ``ExecutionRecord``; empty where nothing is."""
        return ()

    def measured(self) -> dict[str, Measured]:
        """Return where robots were, as it was measured; of those of a simulation nothing is."""
        return {}

    def deadlock(self) -> str:
        """Return which robots stand and what each of them waits for."""
        stuck = []
        for k, chain in enumerate(self.tpg.chains):
            if self.released[k] < len(chain):
                node = self.released[k]
                stuck.append(f"{chain.robot} at node {node} {self._cause(k, node)}")
        return "deadlock: " + "; ".join(stuck)

    # Robots

    def _robot(self, chain: int) -> Steps:
        for node in range(len(self.motion[chain])):
            if (yield from self._pass(chain, node)):
                return
        self._finish(chain)

    def _pass(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a node once it is released, and return whether its task failed for good."""
        yield from self._until_released(chain, node)
        return (yield from self._fails(chain, node))

    def _until_released(self, chain: int, node: int) -> Steps:
        """Wait until a robot has been given a node, or for its planned start."""
        queue = self.queue[chain]
        if self.planned is not None:
            yield from self._until_planned(chain, node)
            return
        # What has arrived may be taken back at the same time.
        while not queue:
            arrival = self.idle[chain] = self.env.event()
            if self.narrator is not None:
                check = self._at_the_end_of_now(_LAST)
                check.callbacks.append(lambda _: self._tell_of_wait(chain, node))
            yield arrival
        queue.popleft()

    def _fails(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a node from rest to rest, report it, and return whether its task failed for good."""
        yield from self._until_stops_end(chain)
        failed = node == self.times.failed[chain]
        self.start[chain][node] = int(self.env.now)
        self._count_patience(chain, node)
        if self.narrator is not None:
            yield from self._execute_watched(self.narrator, chain, node)
        else:
            begin = self._worked(chain, self.now_ns, self.stood[chain][node])
            end = begin if failed else self._end_of_motion(chain, node, begin)
            yield self.env.timeout(end - self.now_ns)
        if failed:
            self.failed.append(chain)
            return True
        self._complete(chain, node)
        return False

    def _until_stops_end(self, chain: int) -> Steps:
        stops = None if self.stops is None else self.stops[chain]
        if stops is not None and (stop := stops.after(self.now_ns) - self.now_ns) > 0:
            yield self.env.timeout(stop)

    def _complete(self, chain: int, node: int, late_ns: int = 0) -> None:
        """Report a node complete, now or in a moment."""
        self.end[chain][node] = int(self.env.now) + late_ns
        if self.planned is None:
            delay = self.messages.report_ns + late_ns
            self._after(delay, self._receive_report, chain, node)

    def _finish(self, chain: int) -> None:
        if self.narrator is not None:
            self.narrator.emit("finished", chain)

    def _work(self, chain: int, busy_ns: int) -> simpy.Event:
        """Return the end of some work that begins now; stops by the clock make it later."""
        now = self.now_ns
        return self.env.timeout(self._worked(chain, now, busy_ns) - now)

    def _worked(self, chain: int, begin_ns: int, busy_ns: int) -> int:
        """Return when some work is done that begins at a time [ns]."""
        if self.stops is None:
            return begin_ns + busy_ns
        return self.stops[chain].advance(begin_ns, busy_ns)

    def _moved(self, chain: int, node: int, begin_ns: int, offset_ns: int) -> int:
        """Return when the motion of a node has gone on for a while, stops not counted [ns].

        Args:
            chain, node: whose motion.
            begin_ns: when it begins.
            offset_ns: for how long.
        """
        return self._worked(chain, begin_ns, offset_ns)

    def _end_of_motion(self, chain: int, node: int, begin_ns: int) -> int:
        return self._moved(chain, node, begin_ns, self.motion[chain][node])

    def _until_planned(self, chain: int, node: int) -> Steps:
        """Wait until the planned start of a node, whatever the others do."""
        assert self.planned is not None
        early = self.planned[chain][node] - self.now_ns
        if early > 0:
            if self.narrator is not None:
                at = f"{self.planned[chain][node] / NANOSECONDS:.3f} s"
                detail = f"waits for its planned start at {at}"
                self.narrator.emit("waiting", chain, node, detail=detail)
            yield self.env.timeout(early)

    def _execute_watched(self, narrator: Narrator, chain: int, node: int) -> Steps:
        """Execute a node and tell of everything that happens in it."""
        narrator.emit("started", chain, node)
        failed = node == self.times.failed[chain]
        stands = narrator.standstills.get((chain, node), ())
        attempt = 0
        for k, entry in enumerate(stands):
            narrator.stands(chain, node, entry)
            yield self._work(chain, entry.duration_ns)
            attempt += entry.cause == "retry"
            if failed and k == len(stands) - 1:
                detail = failure_text(self.tpg, self.times, chain)
                narrator.emit("failed", chain, node, detail=detail)
                return
            narrator.goes_on(chain, node, entry, attempt)
        begin = self.now_ns
        for offset, name, holder in narrator.handlings.get((chain, node), ()):
            passed = self._moved(chain, node, begin, offset) if offset else begin
            if passed > self.now_ns:
                yield self.env.timeout(passed - self.now_ns)
            narrator.handle(chain, node, name, holder)
        end = self._end_of_motion(chain, node, begin)
        if end > self.now_ns:
            yield self.env.timeout(end - self.now_ns)
        narrator.emit("completed", chain, node)

    def _tell_of_wait(self, chain: int, node: int) -> None:
        """Tell that a robot waits unless a node has reached it by now."""
        waits = self.idle[chain] is not None and self.start[chain][node] < 0
        if self.narrator is not None and waits:
            self.narrator.emit("waiting", chain, node, detail=self._cause(chain, node))

    def _cause(self, chain: int, node: int) -> str:
        """Return why a node has not been released, in words."""
        waited_for = [
            f"{self.tpg.chains[k].robot} to complete node {n} "
            f"({self.tpg.tasks[self.task[k][n]].label})"
            for k, n in self.dispatcher.waits_for(chain, node)
        ]
        if waited_for:
            return "waits for " + " and ".join(waited_for)
        return "waits for its turn" if self.sequential else "waits for its release"

    def _run_and_tell_of_stops(
        self, narrator: Narrator, stops: Sequence[Stops]
    ) -> None:
        """Run, and tell of stops by the clock before anything else at their time.

        They are not events of the simulation: nobody would know when to stop waiting for them.
        """
        edge = min(own.next_edge(-1) for own in stops)
        while (upcoming := self._upcoming()) < math.inf:
            # Both are of the graph that is executed, which may be extended.
            stops, narrator = self.stops or stops, self.narrator or narrator
            while edge <= upcoming:
                for chain in range(len(stops)):
                    if self._has_work_left(chain):
                        node = self._under_way(chain)
                        narrator.stopped(stops, chain, node, edge)
                edge = min(own.next_edge(edge) for own in stops)
            self.env.step()

    def _has_work_left(self, chain: int) -> bool:
        end = self.end[chain]
        return bool(end) and end[-1] < 0 and chain not in self.failed

    def _under_way(self, chain: int) -> int:
        """Return the node that a robot has started and not completed, -1 for none."""
        done = sum(end >= 0 for end in self.end[chain])
        begun = done < len(self.end[chain]) and self.start[chain][done] >= 0
        return done if begun else -1

    # Messages

    def _after(self, delay_ns: int, act: Callable[..., None], *about: Any) -> None:
        """Do something after a delay, such as to receive a message; at once if there is none."""
        if delay_ns <= 0:
            act(*about)
        else:
            message = self.env.timeout(delay_ns)
            message.callbacks.append(lambda _: act(*about))

    def _at_the_end_of_now(self, priority: EventPriority) -> simpy.Event:
        """Return an event behind those at this time that have a lower priority."""
        event = self.env.event()
        event._ok, event._value = True, None
        self.env.schedule(event, priority=priority)
        return event

    def _receive_report(self, chain: int, node: int) -> None:
        self.reports.append((chain, node))
        if not self.report_arrived.triggered:
            self.report_arrived.succeed()

    def _count_patience(self, chain: int, node: int, late_ns: int = 0) -> None:
        """Begin to count how long edges from a node hold that holds for some time at most."""
        for target, patience in self.impatient.get((chain, node), ()):
            delay = late_ns + patience + self.messages.report_ns
            self._after(delay, self._lift, (chain, node), target)

    def _lift(self, source: Node, target: Node) -> None:
        self.lifts.append((source, target))
        if not self.report_arrived.triggered:
            self.report_arrived.succeed()

    def _enqueue(self, chain: int, node: int) -> None:
        self.queue[chain].append(node)
        arrival, self.idle[chain] = self.idle[chain], None
        if arrival is not None:
            arrival.succeed()

    # Dispatcher

    def _dispatch(self) -> Steps:
        while True:
            # Reports that came before the dispatcher began count, too, as those of a run that goes on from its log.
            self.report_arrived = self.env.event()
            for chain, node in self.reports:
                self.dispatcher.complete(chain, node)
                self.outstanding[chain] -= 1
            self.reports.clear()
            for source, target in self.lifts:
                self.dispatcher.lift(source, target)
            self.lifts.clear()
            self._release_safe()
            yield self.report_arrived

    def _release_safe(self) -> None:
        """Release what has become safe and fits into the queues."""
        chains: Collection[int] = range(len(self.queue))
        if self.turns is not None:
            self._release_in_turns(self.turns)
            chains = self.machines
        elif self.sequential:
            if not any(self.outstanding):
                ready = [k for k in chains if self._next_is_safe(k)]
                if ready:
                    self._release(
                        min(ready, key=lambda k: self.task[k][self.released[k]])
                    )
            return
        for chain in chains:
            while self.outstanding[chain] < self.ahead and self._next_is_safe(chain):
                self._release(chain)

    def _turns(self) -> deque[int]:
        """Return the chains of robots in the order in which their nodes take turns.

        That order is settled beforehand: what a machine takes for its tasks must not change it.
        """
        first = np.cumsum([0, *(len(chain) for chain in self.tpg.chains)])
        order = np.fromiter(sequential_order(self.tpg), dtype=np.int64)
        chains = np.searchsorted(first, order, side="right") - 1
        return deque(k for k in chains.tolist() if k not in self.machines)

    def _release_in_turns(self, turns: deque[int]) -> None:
        """Release the node whose turn it is, if no robot is at work and it is safe."""
        if not turns or any(
            count for k, count in enumerate(self.outstanding) if k not in self.machines
        ):
            return
        if self._next_is_safe(turns[0]):
            self._release(turns.popleft())

    def _next_is_safe(self, chain: int) -> bool:
        """Return whether the next node to release waits for no other robot.

        Its own robot works through its queue in order, so it need not be done with that.
        """
        node = self.released[chain]
        if node == len(self.task[chain]):
            return False
        if self.outstanding[chain] == 0:
            return self.dispatcher.is_safe(chain, node)
        return not self.dispatcher.waits_for(chain, node)

    def _release(self, chain: int) -> None:
        node = self.released[chain]
        self.released[chain] += 1
        self.outstanding[chain] += 1
        if self.narrator is not None:
            self.narrator.emit("released", chain, node)
        self._after(self.messages.release_ns, self._enqueue, chain, node)
