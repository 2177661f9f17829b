"""Execution of a graph that is cut and extended while it is executed.

A skill that fails for good, and a robot that is out, do not end the run: what can still be brought to
an end is, meanwhile what is left is planned from the world that comes of it, and then the longer graph
takes the place of the one that is executed.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Callable, Collection, Generator
from typing import Any

import numpy as np
import simpy
from simpy.events import EventPriority

from scheduling.graph.dispatcher import Dispatcher, Node
from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.task_edges import machine_chains
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import opened_at
from scheduling.rolling.forecast import Clock
from twin.durations.model import NANOSECONDS
from twin.engine.driven import DrivenExecution
from twin.engine.passage import Passage
from twin.engine.processes import Steps, impatient_edges
from twin.engine.supplied import SuppliedExecution
from twin.operate.committed import Failure, Incident, Version
from twin.operate.continued_times import continued_times
from twin.operate.going import Planner
from twin.run.events import EventCode, Outcome

_AFTER_ALL = EventPriority(10)
"""Priority of what looks at all that has happened at a time."""

_AHEAD_NS = NANOSECONDS // 2
"""Time before the end of what was released at which a robot is released its next task: more than it brakes for."""

Keep = Callable[[int, TemporalPlanGraph], None]
"""Keeps a version of the plan, given its number, from 1, before anything is told of it."""

Hold = Callable[[TemporalPlanGraph], TemporalPlanGraph]
"""Returns a graph with edges that hold back what opens windows of time."""


class RollingExecution(SuppliedExecution):
    """State of one run in which the graph may be extended.

    Attributes:
        versions: graphs that took the place of the first one, in order.
    """

    def __init__(
        self,
        *rest: Any,
        planner: Planner[Any],
        hold: Hold | None = None,
        far: bool = False,
        halting: bool = False,
        keep: Keep | None = None,
        **options: Any,
    ) -> None:
        """Set the cell up at time 0; see Execution.

        Args:
            rest, options: as of an execution.
            planner: plans what is left.
            hold: makes graphs wait where what opens windows of time is held back; by default nothing is.
            far: whether robots are released as much as is safe; else no task long before it begins.
            halting: whether everybody stops after the task at hand when something is to be planned.
            keep: keeps each graph that takes over.
        """
        super().__init__(*rest, **options)
        self._hold = hold or (lambda tpg: tpg)
        self._dispatch_by(self._hold(self.tpg))
        self.versions: list[Version] = []
        self._planner = planner
        self._halting, self._keep_version = halting, keep
        messages_ns = self.messages.report_ns + self.messages.release_ns
        self._ahead_ns = None if far else _AHEAD_NS + messages_ns
        self._limit = [len(chain) for chain in self.tpg.chains]
        self._failures: list[Failure] = []
        self._out: set[str] = set()
        self._unwanted: set[int] = set()
        self._more = 0
        self._team = {r.name for r in (*self.tpg.cell.robots, *self.tpg.cell.machines)}
        self._to_come = 0
        self._again = False
        self._planning = False
        self._finished: dict[int, int] = {}
        self._void: Counter[Node] = Counter()
        self._swapped = self.env.event()

    @property
    def out(self) -> frozenset[str]:
        """Robots that are out."""
        return frozenset(self._out)

    def outage(self, robot: str, at_ns: int) -> None:
        """Let a robot stop for good at a time [ns]."""

        def stop() -> Steps:
            yield self.env.timeout(max(at_ns - self.now_ns, 0))
            if robot not in self._out and not self._done():
                self._out.add(robot)
                if robot in self.tpg.chain_index:
                    k = self.tpg.chain_index[robot]
                    self._limit[k] = min(self._limit[k], self.released[k])
                    self._tell_of_outage(k)
                self._replan()

        self.env.process(stop())

    def order(self, drop: Collection[int], more: int, at_ns: int) -> None:
        """Let steps be not wanted any more, and more products be wanted, from a time on [ns]."""
        self._to_come += 1

        def change() -> Steps:
            yield self.env.timeout(at_ns)
            self._to_come -= 1
            self._unwanted.update(drop)
            self._more += more
            failed = {f.chain: f.node for f in self._failures}
            counts = [failed.get(k, n) for k, n in enumerate(self.released)]
            if more or self._unwanted - self._planner.begun(self.tpg, counts):
                self._replan()

        self.env.process(change())

    def execute(self) -> Outcome:
        """Run as any execution; what is planned anew on the way terminates, see ``termination``."""
        self._planner.begin(self._events())
        return super().execute()

    def _outcome(self) -> Outcome:
        return "failed" if self._planner.short else "completed"

    def _events(self) -> int:
        """Return how many events from outside can still occur."""
        unknown = {*self._coming.values()} - self._missed
        return len(self._team - self._out) + self._to_come + len(unknown)

    def _tell_of_outage(self, chain: int) -> None:
        if self.narrator is not None:
            self.narrator.emit("failed", chain, detail=EventCode.OUT_OF_SERVICE.value)

    def _upcoming(self) -> float:
        upcoming = super()._upcoming()
        if self._planning or not self._done():
            return upcoming
        last = max((end[-1] for end in self.end if end), default=0)
        return upcoming if upcoming <= last else math.inf

    # Robots

    def _robot(self, chain: int, node: int = 0) -> Steps:
        while True:
            if node < len(self.motion[chain]):
                if (yield from self._pass(chain, node)):
                    yield from self._fail(chain, node)
                node += 1
                continue
            if not self._planning and self._finished.get(chain) != node:
                self._finished[chain] = node
                self._finish(chain)
            yield self._swapped

    def _fail(self, chain: int, node: int) -> Steps:
        """Tell the planner that a skill has failed, and wait for what it makes of that."""
        self.failed.remove(chain)
        failed_ns = self.now_ns
        missing = self._missing(chain, node) is not None
        if self.messages.report_ns:
            # Until the message is there the robot is at work, for all that anybody knows.
            yield self.env.timeout(self.messages.report_ns)
        self.end[chain][node] = failed_ns
        lost = not missing and chain in self.times.lost
        self._failures.append(Failure(chain, node, lost, missing))
        self._limit[chain] = node
        self._take_back(chain, node + 1)
        self._replan()
        yield self._swapped

    def _take_back(self, chain: int, count: int) -> None:
        """Take back what a robot was released beyond some of its nodes."""
        back = self.released[chain] - count
        if back > 0:
            self.released[chain] = count
            self.outstanding[chain] -= back
            queue = self.queue[chain]
            self._void.update((chain, n) for n in range(count, count + back))
            while queue and queue[-1] >= count:
                self._void[chain, queue.pop()] -= 1

    def _enqueue(self, chain: int, node: int) -> None:
        # What was on its way when it was taken back comes before what is released since.
        if self._void[chain, node]:
            self._void[chain, node] -= 1
        else:
            super()._enqueue(chain, node)

    def _next_is_safe(self, chain: int) -> bool:
        more = self.released[chain] < self._limit[chain] and self._needs_more(chain)
        return more and super()._next_is_safe(chain)

    def _needs_more(self, chain: int) -> bool:
        """Tell whether a robot is to be released more, unless it begins a task too early.

        What is released is not taken back, and the more is, the less can be planned anew.
        """
        node, task = self.released[chain], self.task[chain]
        count = self.outstanding[chain]
        if self._ahead_ns is None or not count or task[node] == task[node - 1]:
            return True
        return int(sum(self.motion[chain][node - count : node])) < self._ahead_ns

    def _release(self, chain: int) -> None:
        super()._release(chain)
        node, task = self.released[chain] - 1, self.task[chain]
        if node == 0 or task[node] != task[node - 1]:
            self._plan_more()

    # Planning

    def _plan_more(self) -> None:
        """Plan more where it is time for it."""
        if not self._planning and self._planner.due(self.tpg, self.released):
            self._plan_again()

    def _replan(self) -> None:
        """Plan what is left, or once more what is being planned, as something has happened."""
        if self._halting:
            self._halt()
        self._plan_again()

    def _plan_again(self) -> None:
        self._again = True
        if not self._planning:
            self._planning = True
            self.env.process(self._plan())

    def _halt(self) -> None:
        """Take back all that was released beyond the tasks at hand."""
        for k, own in enumerate(self.start):
            count = sum(begun >= 0 for begun in own)
            while not self._rests_between_tasks(k, count):
                count += 1
            self._take_back(k, count)
            self._limit[k] = min(self._limit[k], count)

    def _rests_between_tasks(self, chain: int, count: int) -> bool:
        """Tell whether a robot is at rest, and in no task, after so many of its nodes."""
        task = self.task[chain]
        return count in (0, len(task)) or task[count - 1] != task[count]

    def _plan(self) -> Steps:
        # After all that happens at this time.
        yield self._at_the_end_of_now(_AFTER_ALL)
        while self._again:
            self._again = False
            version = yield from self._version()
            self._limit = list(version.counts[: len(self._limit)])
            if version.planning_ns:
                yield self.env.timeout(version.planning_ns)
        self._planning = False
        self._planner.swapped()
        if self._failures or plan_sha256(version.tpg) != plan_sha256(self.tpg):
            self._swap(version)
        else:
            self._keep()

    def _keep(self) -> None:
        """Go on with the graph that there is, as planning anew has changed nothing."""
        self._set_limits()
        self._wake()

    def _version(self) -> Generator[simpy.Event, Any, Version]:
        """Plan what is left of all that has happened by now."""
        yield from ()
        return self._planner.plan(self.tpg, self._incident())

    def _incident(self) -> Incident:
        """Return what has happened by now."""
        opened = opened_at(self.tpg, np.array([t for own in self.end for t in own]))
        return Incident(
            tuple(self._failures),
            frozenset(self._out),
            frozenset(self._unwanted),
            # Whatever is done, what is to be brought is brought.
            tuple(max(n, int(k in self._coming)) for k, n in enumerate(self.released)),
            {k: (self.now_ns - t) / NANOSECONDS for k, t in opened.items()},
            self._clock(),
            due=not (self._failures or self._out or self._unwanted or self._more),
            more=self._more,
            events=self._events(),
        )

    def _clock(self) -> Clock:
        begun, ended = (
            tuple(np.array([t for t in own if t >= 0]) / NANOSECONDS for own in rows)
            for rows in (self.start, self.end)
        )
        return Clock(self.now_ns / NANOSECONDS, begun, ended)

    def _dispatch_by(self, held: TemporalPlanGraph) -> None:
        """Dispatch by a graph from now on, of which nothing has been reported yet."""
        self.dispatcher = Dispatcher(held)
        self.impatient = impatient_edges(held)
        self.lifts.clear()

    def _lift(self, source: Node, target: Node) -> None:
        # It may be an edge of a graph that is followed no more.
        if any(to == target for to, _ in self.impatient.get(source, ())):
            super()._lift(source, target)

    def _swap(self, version: Version) -> None:
        """Go on with another graph."""
        failures, self._failures = self._failures, []
        tpg, old = version.tpg, self.dispatcher
        reported = [old.completed(k) for k in range(len(self.tpg.chains))]
        for failure in failures:
            reported[failure.chain] = failure.node + 1
        self.times = continued_times(self.times, version, self.end)
        self.stops = self.times.stops
        self.tpg = tpg
        self._dispatch_by(self._hold(tpg))
        for k, count in enumerate(reported):
            if count:
                self.dispatcher.observe(k, count - 1)
        self._lift_unknown()
        self._resize(version)
        for k, node in self.impatient:
            if (begun := self.start[k][node]) >= 0:
                self._count_patience(k, node, begun - self.now_ns)
        for failure in failures:
            self.outstanding[failure.chain] = 0
            self.released[failure.chain] = failure.node + 1
        if self._keep_version is not None:
            self._keep_version(len(self.versions) + 2, tpg)
        if self.narrator is not None:
            self.narrator = self.narrator.of(tpg, self.times)
            self._tell_of_swap(version, failures)
        self.versions.append(version)
        self._wake()

    def _wake(self) -> None:
        """Let robots go on that have waited for a plan."""
        swapped, self._swapped = self._swapped, self.env.event()
        swapped.succeed()
        self._dispatch_again()
        self._plan_more()

    def _tell_of_swap(self, version: Version, failures: list[Failure]) -> None:
        assert self.narrator is not None
        cut = ", ".join(
            f"{chain.robot} {count}"
            for chain, count in zip(version.tpg.chains, version.counts, strict=True)
        )
        seconds = version.planning_ns / NANOSECONDS
        self.narrator.emit(
            "replanned",
            detail=f"version {len(self.versions) + 2}, {plan_sha256(version.tpg)[:12]}:"
            f" {version.cause}; cut at {cut}; planned in {seconds:.3f} s",
        )
        for failure, words in zip(failures, version.recovered, strict=True):
            lost = failure.chain, failure.node
            for h in version.tpg.handlings:
                if (h.robot, h.node) == lost:
                    self.narrator.handle(*lost, h.object, h.holder)
            self.narrator.emit("recovered", *lost, detail=words)

    def _resize(self, version: Version) -> None:
        """Make room for the nodes of the graph, and let robots that had none begin."""
        tpg, before = self.tpg, len(self.start)
        for k, chain in enumerate(tpg.chains):
            if k >= before:
                self.start.append([])
                self.end.append([])
                self.queue.append(deque())
                self.idle.append(None)
                self.outstanding.append(0)
                self.released.append(0)
            count = version.counts[k]
            more = [-1] * (len(chain) - count)
            self.start[k] = [*self.start[k][:count], *more]
            self.end[k] = [*self.end[k][:count], *more]
        self.task = [chain.task.tolist() for chain in tpg.chains]
        self.motion = [motion.tolist() for motion in self.times.motion]
        self.stood = [stood.tolist() for stood in self.times.stood]
        self.machines = machine_chains(tpg)
        self._set_limits()
        for k in range(before, len(tpg.chains)):
            self.env.process(self._robot(k))

    def _set_limits(self) -> None:
        """Let robots that are in service be released all of the graph."""
        self._limit = [
            self.released[k] if chain.robot in self._out else len(chain)
            for k, chain in enumerate(self.tpg.chains)
        ]


class RollingDrivenExecution(RollingExecution, DrivenExecution):
    """State of one run in which the graph may be extended, and robots pass borders at speed."""

    def _never_tried(self, chain: int, node: int) -> None:
        super()._never_tried(chain, node)
        self._given[chain].pop(node, None)

    def _rests_between_tasks(self, chain: int, count: int) -> bool:
        ends = count == len(self.task[chain]) or self._opens(chain, count)
        return ends and super()._rests_between_tasks(chain, count)

    def _resize(self, version: Version) -> None:
        super()._resize(version)
        self._take_drives(self.tpg, self.times)
        for k, drive in enumerate(self._drives):
            if k < len(self._passages):
                self._passages[k].times = drive
            else:
                self._passages.append(Passage(drive))
                self._stood.append([])
