"""One run of the twin under way: robot processes and the dispatcher process (APEX-MR IV-D)."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Sequence
from typing import Any

import numpy as np
import simpy
from simpy.events import EventPriority

from scheduling.dispatcher import Dispatcher
from scheduling.temporal_plan_graph import TemporalPlanGraph
from twin.durations import NANOSECONDS, Nanoseconds
from twin.events import Event, EventKind
from twin.recorders.observers import Observers
from twin.run import Outcome, Policy, waypoint_offsets_ns

_LAST = EventPriority(9)
"""Priority of what happens after everything else at the same time."""

_Steps = Generator[simpy.Event, Any, None]
_Change = tuple[int, str, str | None]


class Execution:
    """One run under way."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        duration: Sequence[Nanoseconds],
        stall: Sequence[Nanoseconds],
        *,
        policy: Policy,
        queue_depth: int,
        latency_ns: int,
        observers: Observers,
    ) -> None:
        """Set the cell up at time 0; see twin.engine.simulate for the arguments."""
        self.tpg = tpg
        self.observers = observers
        self.watched = bool(observers)
        self.sequential = policy == "sequential"
        self.queue_depth = queue_depth
        self.latency = latency_ns
        self.env = simpy.Environment(initial_time=0)
        self.dispatcher = Dispatcher(tpg)
        self.task = [chain.task.tolist() for chain in tpg.chains]
        self.duration = [d.tolist() for d in duration]
        self.stall = [s.tolist() for s in stall]
        self.start = [[-1] * len(chain) for chain in tpg.chains]
        self.end = [[-1] * len(chain) for chain in tpg.chains]
        self.queue: list[deque[int]] = [deque() for _ in tpg.chains]
        self.idle: list[simpy.Event | None] = [None] * len(tpg.chains)
        self.outstanding = [0] * len(tpg.chains)
        self.released = [0] * len(tpg.chains)
        self.reports: list[tuple[int, int]] = []
        self.report_arrived = self.env.event()
        self.handlings = self._handlings_by_node() if self.watched else {}
        self.holder: dict[str, str] = {}

    @property
    def now_ns(self) -> int:
        """Time that has passed [ns]."""
        return int(self.env.now)

    def execute(self) -> Outcome:
        """Run until everything is done, nothing can go on, or the user interrupts."""
        for chain in range(len(self.tpg.chains)):
            self.env.process(self._robot(chain))
        self.env.process(self._dispatch())
        outcome: Outcome = "completed"
        try:
            self.env.run()
            if any(end and end[-1] < 0 for end in self.end):
                outcome = "failed"
                self._emit("failed", detail=self.deadlock())
        except KeyboardInterrupt:
            outcome = "aborted"
            self._emit("stopped", detail="interrupted by the user")
        finally:
            self._emit("finished", detail=outcome)
            self.observers.close()
        return outcome

    def deadlock(self) -> str:
        """Return which robots stand and what each of them waits for."""
        stuck = []
        for k, chain in enumerate(self.tpg.chains):
            if self.released[k] < len(chain):
                node = self.released[k]
                stuck.append(f"{chain.robot} at node {node} {self._cause(k, node)}")
        return "deadlock: " + "; ".join(stuck)

    # Robots

    def _robot(self, chain: int) -> _Steps:
        env, queue = self.env, self.queue[chain]
        duration, stall = self.duration[chain], self.stall[chain]
        start, end = self.start[chain], self.end[chain]
        for node in range(len(duration)):
            if not queue:
                arrival = self.idle[chain] = env.event()
                if self.watched:
                    self._after_everything_else(chain, node)
                yield arrival
            queue.popleft()
            start[node] = self.now_ns
            if self.watched:
                yield from self._execute_watched(chain, node)
            else:
                yield env.timeout(stall[node] + duration[node])
            end[node] = self.now_ns
            self._report(chain, node)
        if self.watched:
            self._emit("finished", chain)

    def _execute_watched(self, chain: int, node: int) -> _Steps:
        """Execute a node and tell of everything that happens in it."""
        env = self.env
        self._emit("started", chain, node)
        stall = self.stall[chain][node]
        if stall > 0:
            self._emit(
                "stalled", chain, node, detail=f"for {stall / NANOSECONDS:.3f} s"
            )
            yield env.timeout(stall)
            self._emit("resumed", chain, node)
        passed = 0
        for offset, name, holder in self.handlings.get((chain, node), ()):
            if offset > passed:
                yield env.timeout(offset - passed)
                passed = offset
            self._handle(chain, node, name, holder)
        if self.duration[chain][node] > passed:
            yield env.timeout(self.duration[chain][node] - passed)
        self._emit("completed", chain, node)

    def _handle(self, chain: int, node: int, name: str, holder: str | None) -> None:
        giver = self.holder.pop(name, None)
        if holder is None:
            detail = "comes up at its station" if giver is None else "put down"
            self._emit("detached", chain, node, name, detail)
            return
        self.holder[name] = holder
        detail = f"to {holder}" if giver is None else f"from {giver} to {holder}"
        self._emit("attached", chain, node, name, detail)

    def _after_everything_else(self, chain: int, node: int) -> None:
        """Tell that a robot waits unless a node reaches it at this very time."""

        def tell(_: simpy.Event) -> None:
            if self.idle[chain] is not None and self.start[chain][node] < 0:
                self._emit("waiting", chain, node, detail=self._cause(chain, node))

        check = self.env.event()
        check._ok, check._value = True, None
        check.callbacks.append(tell)
        self.env.schedule(check, priority=_LAST)

    # Messages

    def _report(self, chain: int, node: int) -> None:
        """Send the dispatcher word that a node is complete."""
        if self.latency == 0:
            self._receive_report(chain, node)
        else:
            message = self.env.timeout(self.latency)
            message.callbacks.append(lambda _: self._receive_report(chain, node))

    def _receive_report(self, chain: int, node: int) -> None:
        self.reports.append((chain, node))
        if not self.report_arrived.triggered:
            self.report_arrived.succeed()

    def _send(self, chain: int, node: int) -> None:
        """Send a robot its next node."""
        if self.latency == 0:
            self._enqueue(chain, node)
        else:
            message = self.env.timeout(self.latency)
            message.callbacks.append(lambda _: self._enqueue(chain, node))

    def _enqueue(self, chain: int, node: int) -> None:
        self.queue[chain].append(node)
        arrival, self.idle[chain] = self.idle[chain], None
        if arrival is not None:
            arrival.succeed()

    # Dispatcher

    def _dispatch(self) -> _Steps:
        while True:
            self._release_safe()
            self.report_arrived = self.env.event()
            yield self.report_arrived
            for chain, node in self.reports:
                self.dispatcher.complete(chain, node)
                self.outstanding[chain] -= 1
            self.reports.clear()

    def _release_safe(self) -> None:
        """Release what has become safe and fits into the queues."""
        chains = range(len(self.queue))
        if self.sequential:
            if not any(self.outstanding):
                ready = [k for k in chains if self._next_is_safe(k)]
                if ready:
                    self._release(
                        min(ready, key=lambda k: self.task[k][self.released[k]])
                    )
            return
        for chain in chains:
            while self.outstanding[chain] < self.queue_depth and self._next_is_safe(
                chain
            ):
                self._release(chain)

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
        if self.watched:
            self._emit("released", chain, node)
        self._send(chain, node)

    # Events

    def _emit(
        self,
        kind: EventKind,
        chain: int = -1,
        node: int = -1,
        name: str = "",
        detail: str = "",
    ) -> None:
        robot = self.tpg.chains[chain].robot if chain >= 0 else ""
        task = self.task[chain][node] if node >= 0 else -1
        self.observers.record(Event(self.now_ns, robot, kind, task, node, name, detail))

    def _cause(self, chain: int, node: int) -> str:
        """Return what a node that has not been received is waiting for."""
        waited_for = [
            f"{self.tpg.chains[k].robot} to complete node {n} "
            f"({self.tpg.tasks[self.task[k][n]].label})"
            for k, n in self.dispatcher.waits_for(chain, node)
        ]
        if waited_for:
            return "waits for " + " and ".join(waited_for)
        return "waits for its turn" if self.sequential else "waits for its release"

    def _handlings_by_node(self) -> dict[tuple[int, int], list[_Change]]:
        """Return (offset, object, holder) of the handlings of each node, in order of time."""
        offsets = [
            waypoint_offsets_ns(chain, np.array(duration, dtype=np.int64))
            for chain, duration in zip(self.tpg.chains, self.duration, strict=True)
        ]
        found: dict[tuple[int, int], list[_Change]] = {}
        for item in self.tpg.handlings:
            chain = self.tpg.chains[item.robot]
            waypoint = int(chain.first[item.node]) + item.waypoint - 1
            offset = int(offsets[item.robot][waypoint]) if item.waypoint > 0 else 0
            change = (offset, item.object, item.holder)
            found.setdefault((item.robot, item.node), []).append(change)
        for changes in found.values():
            changes.sort(key=lambda change: change[0])
        return found
