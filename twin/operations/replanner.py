"""Replanning during an execution: the graph is cut and extended while robots execute it.

A run continues after all attempts at a skill have failed, or after an outage of a robot. The nodes that are still
executed as planned are the committed prefix. During their execution, the rest is planned from the world state at the
end of the prefix. Then the extended graph replaces the old one. ``Planner.recover`` (planner.py) makes each
``PlanRevision``; ``Recovery.extend`` (recovery.py) plans it for bricks, goals and parts.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping
from functools import partial
from typing import Any

import numpy as np
import simpy
from simpy.events import EventPriority

from scheduling.graph.plan_files import plan_sha256
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.windows import window_opening_times
from scheduling.rolling.forecast import Clock
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution import Execution
from twin.engine.ports import Replanner, Steps
from twin.operations.commitment import Failure, PlanRevision, ReplanTrigger
from twin.operations.continued_times import continued_times
from twin.operations.person import UnansweredError
from twin.operations.planner import Planner
from twin.operations.supply import LateSupply
from twin.runs.events import EventCode

_AFTER_ALL = EventPriority(10)
"""Priority of events that happen after all others at the same time."""

_AHEAD_NS = NANOSECONDS // 2
"""Time before the end of a robot's released nodes at which its next task is released: more than its braking time."""

Keep = Callable[[int, TemporalPlanGraph], None]
"""Stores a revision of the plan, given its number from 1, before any event of it is recorded."""

Hold = Callable[[TemporalPlanGraph], TemporalPlanGraph]
"""Returns a graph with edges that hold back tasks that open time windows."""


class RollingReplanner(Replanner):
    """Extends the graph of an execution after failures, or when more steps are due.

    Attributes:
        versions: plan revisions that were executed, in order.
        planner, state: planner of revisions, and its state for the executed graph.

    Args:
        execution: the run; its supply, if any, is a ``LateSupply``.
        planner: planner of revisions.
        hold: adds edges that hold back tasks that open time windows; by default none.
        far: whether nodes are released as soon as they are safe; else tasks only shortly before they begin.
        halting: whether all robots stop after their present tasks during replanning.
        keep: stores each graph that takes over.
    """

    def __init__(
        self,
        execution: Execution,
        *,
        planner: Planner[Any],
        hold: Hold | None = None,
        far: bool = False,
        halting: bool = False,
        keep: Keep | None = None,
    ) -> None:
        self._execution = execution
        self._hold = hold or (lambda tpg: tpg)
        execution.dispatch_by(self._hold(execution.tpg))
        self.versions: list[PlanRevision] = []
        self.planner, self.state = planner, planner.initial
        self._halting, self._keep_version = halting, keep
        messages_ns = execution.messages.report_ns + execution.messages.release_ns
        self._ahead_ns = None if far else _AHEAD_NS + messages_ns
        self._limit = [len(chain) for chain in execution.tpg.chains]
        self._failures: list[Failure] = []
        self._out: set[str] = set()
        self._unwanted: set[int] = set()
        self._more = self._rushed = 0
        cell = execution.tpg.cell
        self._team = {r.name for r in (*cell.robots, *cell.machines)}
        self._to_come = 0
        self._again = False
        self._planning = False
        self._revised = execution.env.event()
        execution.gates.append(self._may_release)
        execution.release_hooks.append(self._released)

    @property
    def planning(self) -> bool:
        """Whether a plan revision is in progress or about to take over."""
        return self._planning

    @property
    def short(self) -> bool:
        """Whether the executed plan lacks wanted steps."""
        return self.planner.is_short(self.state)

    @property
    def out(self) -> frozenset[str]:
        """Robots that are out of service."""
        return frozenset(self._out)

    @property
    def given_up(self) -> Mapping[int, str]:
        """Abandoned steps of the executed plan, by number, with the reason."""
        given_up: Mapping[int, str] = self.state.ledger.given_up
        return given_up

    def limit(self, chain: int) -> int:
        """Return the number of committed nodes of a chain; all without a pending revision."""
        return self._limit[chain]

    def begin(self) -> None:
        """Handle the start of the run; replanning terminates, see ``termination``."""
        self.state = self.planner.with_measure(self.state, self._events())

    def outage(self, robot: str, at_ns: int) -> None:
        """Take a robot out of service at a time [ns]."""
        execution = self._execution

        def stop() -> Steps:
            yield execution.env.timeout(max(at_ns - execution.now_ns, 0))
            if robot not in self._out and not execution.is_done():
                self._out.add(robot)
                if robot in execution.tpg.chain_index:
                    k = execution.tpg.chain_index[robot]
                    self._limit[k] = min(self._limit[k], execution.released[k])
                    if execution.narrator is not None:
                        execution.narrator.emit(
                            "failed", k, detail=EventCode.OUT_OF_SERVICE.value
                        )
                self._replan()

        execution.env.process(stop())

    def order(self, drop: Collection[int], more: int, rush: int, at_ns: int) -> None:
        """Cancel steps, and order more products, last or in a rush order, at a time [ns]."""
        execution = self._execution
        self._to_come += 1

        def change() -> Steps:
            yield execution.env.timeout(at_ns)
            self._to_come -= 1
            self._unwanted.update(drop)
            self._more += more
            self._rushed += rush
            failed = {f.chain: f.node for f in self._failures}
            counts = [failed.get(k, n) for k, n in enumerate(execution.released)]
            fresh = self._unwanted - self.planner.begun(self.state, counts)
            if more or rush or fresh:
                self._replan()

        execution.env.process(change())

    def _events(self) -> int:
        """Return the number of external events that can still occur."""
        unknown, supply = 0, self._execution.supply
        if isinstance(supply, LateSupply):
            unknown = len({*supply.arriving.values()} - supply.missed)
        return len(self._team - self._out) + self._to_come + unknown

    # Robots

    def recover(self, chain: int, node: int) -> Steps:
        """Wait for a plan revision after the skill that begins with a node has failed for good."""
        execution = self._execution
        failed_ns = execution.now_ns
        missing = execution.supply is not None and bool(
            execution.supply.missing(chain, node)
        )
        if execution.messages.report_ns:
            # Until the message arrives, the robot counts as working.
            yield execution.env.timeout(execution.messages.report_ns)
        execution.end[chain][node] = failed_ns
        lost = not missing and chain in execution.times.lost
        self._failures.append(Failure(chain, node, lost, missing))
        self._limit[chain] = node
        execution.withdraw(chain, node + 1)
        self._replan()
        yield self._revised

    def revised(self) -> simpy.Event:
        """Return the event with which the next revision takes over."""
        return self._revised

    def _may_release(self, chain: int) -> bool:
        """Return whether the next node of a chain is committed and due.

        Released nodes are not withdrawn, which limits replanning, so no task is released long before
        it begins.
        """
        execution, count = self._execution, self._execution.outstanding[chain]
        node, task = execution.released[chain], execution.task[chain]
        if node >= self._limit[chain]:
            return False
        if self._ahead_ns is None or not count or task[node] == task[node - 1]:
            return True
        return int(sum(execution.motion[chain][node - count : node])) < self._ahead_ns

    def _released(self, chain: int, node: int) -> None:
        """Plan further steps when a released task makes them due."""
        task = self._execution.task[chain]
        if node == 0 or task[node] != task[node - 1]:
            self._plan_more()

    def _plan_more(self) -> None:
        released = self._execution.released
        if not self._planning and self.planner.due(self.state, released):
            self._plan_again()

    # Planning

    def _replan(self) -> None:
        """Replan after an event, restarting a replanning in progress."""
        if self._halting:
            self._halt()
        self._plan_again()

    def _plan_again(self) -> None:
        self._again = True
        if not self._planning:
            self._planning = True
            self._execution.env.process(self._plan())

    def _halt(self) -> None:
        """Withdraw all released nodes beyond the current tasks."""
        for k, own in enumerate(self._execution.start):
            count = sum(begun >= 0 for begun in own)
            while not self._rests_between_tasks(k, count):
                count += 1
            self._execution.withdraw(k, count)
            self._limit[k] = min(self._limit[k], count)

    def _rests_between_tasks(self, chain: int, count: int) -> bool:
        """Return whether a robot is at rest and in no task after a number of its nodes."""
        task = self._execution.task[chain]
        if count == len(task):
            return True
        between = count == 0 or task[count - 1] != task[count]
        return between and self._execution.robots.rests_before(chain, count)

    def _plan(self) -> Steps:
        execution = self._execution
        # After all that happens at this time.
        yield execution.end_of_instant(_AFTER_ALL)
        while self._again:
            self._again = False
            state, version = yield from self._version()
            self._limit = list(version.counts[: len(self._limit)])
            if version.planning_ns:
                yield execution.env.timeout(version.planning_ns)
        self._planning = False
        self.state = state
        if self._failures or plan_sha256(version.tpg) != plan_sha256(execution.tpg):
            self._take_over(version)
        else:
            # Replanning has changed nothing.
            self._set_limits()
        revised, self._revised = self._revised, execution.env.event()
        revised.succeed()
        execution.redispatch()
        self._plan_more()

    def _version(self) -> Generator[simpy.Event, Any, tuple[Any, PlanRevision]]:
        """Plan a revision from the current trigger, repeated for each question to a person."""
        execution, audience = self._execution, self._execution.audience
        while True:
            if audience is not None:
                audience.show_planning()
            plan = partial(self.planner.recover, self.state, self._trigger())
            try:
                return (yield from execution.robots.compute(plan))
            except UnansweredError as error:
                if audience is None:
                    raise
                question = error.question
            yield from audience.answered(question)
            self._again = False

    def _trigger(self) -> ReplanTrigger:
        """Return the replan trigger of now."""
        execution = self._execution
        coming = {} if execution.supply is None else execution.supply.arriving
        opened = window_opening_times(
            execution.tpg, np.array([t for own in execution.end for t in own])
        )
        return ReplanTrigger(
            tuple(self._failures),
            frozenset(self._out),
            frozenset(self._unwanted),
            # Pending deliveries are kept in every revision.
            tuple(max(n, int(k in coming)) for k, n in enumerate(execution.released)),
            {k: (execution.now_ns - t) / NANOSECONDS for k, t in opened.items()},
            self._clock(),
            due=not (self._failures or self._out or self._unwanted or self._more),
            more=self._more,
            rushed=self._rushed,
            events=self._events(),
        )

    def _clock(self) -> Clock:
        begun, ended = (
            tuple(np.array([t for t in own if t >= 0]) / NANOSECONDS for own in rows)
            for rows in (self._execution.start, self._execution.end)
        )
        return Clock(self._execution.now_ns / NANOSECONDS, begun, ended)

    def _take_over(self, version: PlanRevision) -> None:
        """Continue the execution with a plan revision."""
        execution, tpg = self._execution, version.tpg
        failures, self._failures = self._failures, []
        times = continued_times(execution.times, version, execution.end)
        failed = [(failure.chain, failure.node) for failure in failures]
        execution.extend(tpg, self._hold(tpg), times, version.counts, failed)
        self._set_limits()
        if self._keep_version is not None:
            self._keep_version(execution.revision, tpg)
        self._record(version, failures)
        self.versions.append(version)

    def _record(self, version: PlanRevision, failures: list[Failure]) -> None:
        """Record a revision, and the recovery from each failure."""
        narrator = self._execution.narrator
        if narrator is None:
            return
        cut = ", ".join(
            f"{chain.robot} {count}"
            for chain, count in zip(version.tpg.chains, version.counts, strict=True)
        )
        seconds = version.planning_ns / NANOSECONDS
        narrator.emit(
            "replanned",
            detail=f"version {self._execution.revision}, {plan_sha256(version.tpg)[:12]}:"
            f" {version.cause}; cut at {cut}; planned in {seconds:.3f} s",
        )
        for failure, words in zip(failures, version.recovered, strict=True):
            lost = failure.chain, failure.node
            for h in version.tpg.handlings:
                if (h.robot, h.node) == lost:
                    narrator.handle(*lost, h.object, h.holder)
            narrator.emit("recovered", *lost, detail=words)

    def _set_limits(self) -> None:
        """Allow robots in service to be released the whole graph."""
        self._limit = [
            self._execution.released[k] if chain.robot in self._out else len(chain)
            for k, chain in enumerate(self._execution.tpg.chains)
        ]
