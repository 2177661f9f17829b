"""Execution of nodes by drivers: start and end times and measured samples are taken from their reports."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import simpy

from scheduling.graph.actuations import actuation_nodes
from twin.drivers.driver import DriverState, Sample, cleared_node, tool_order_of_node
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution import Execution
from twin.engine.ports import Steps
from twin.engine.simulated_robots import SimulatedRobots
from twin.live.link import AwaitedActuation, Link, sync_tool_commands
from twin.live.lost_samples import samples_between
from twin.live.measured_log import MeasuredLog
from twin.live.measured_rows import MeasuredRows
from twin.live.messages import Report
from twin.live.run_history import History
from twin.runs.execution_record import Measured
from twin.uncertainty.node_times import NodeTimes

_CLOCK_TOLERANCE_S = 60.0
"""Largest difference of two estimates of the start of a run; at more the clock was reset [s]."""

_MISSING_S = 2.0
"""Longest wait for announced samples of a report [s]."""


class ReportedNodes:
    """Executes nodes of robots as their drivers report, and nodes of machines in simulation.

    Attributes:
        links: state of the protocol of each driver, by robot.
        states: the last report of each.
        updates: events triggered by the next report of each.
        log: file of samples.
        history: history of the log, where the dispatcher was restarted.
        wall_s: clock with any origin; returns the time [s].
        pace: seconds of the run per second of the clock.
        begin_s: start of the run, by that clock [s].

    Args:
        execution: the run.
        links, pace, log, history, clock: see the attributes.
    """

    def __init__(
        self,
        execution: Execution,
        links: Mapping[str, Link],
        pace: float,
        log: MeasuredLog,
        history: History | None,
        clock: Callable[[], float],
    ) -> None:
        self._execution = execution
        self._simulated = SimulatedRobots(execution)
        self.links, self.wall_s = links, clock
        since_s = history.since_ns / NANOSECONDS if history else 0.0
        self.begin_s, self.pace = clock() - since_s / pace, pace
        self.states: dict[str, DriverState] = {}
        self._missing_since_s: dict[str, float] = {}
        self.updates = {name: execution.env.event() for name in links}
        self._rows = {name: MeasuredRows() for name in links}
        self._acts = actuation_nodes(execution.tpg)
        self.log, self.history = log, history
        execution.release_hooks.append(self._released)
        if history is not None:
            self._restore(history)

    def _restore(self, history: History) -> None:
        """Restore the state of a log."""
        for k, chain in enumerate(self._execution.tpg.chains):
            cleared, done = history.cleared_ns[k], history.end_ns[k]
            self._execution.released[k] = len(cleared)
            self._execution.outstanding[k] = len(cleared) - len(done)
            if done:
                self._execution.dispatcher.observe(k, len(done) - 1)
            if k in history.finished:
                self._execution.finished[k] = len(chain)
            if (link := self.links.get(chain.robot)) is not None:
                for node in range(len(cleared)):
                    self._clear(link, k, node, passed=node < len(done))
                link.restore(history.starts, len(done))
                link.hold(chain.robot in history.held)
                self._rows[chain.robot].cleared_ns = list(cleared)
            else:
                self._execution.queue[k].extend(
                    range(len(history.start_ns[k]), len(cleared))
                )
        for source, targets in self._execution.impatient.items():
            for (k, node), _ in targets:
                if node < self._execution.released[k]:  # it had waited long enough
                    self._execution.dispatcher.lift(source, (k, node))
        begin_s = self.log.begin_s()
        if begin_s is not None and abs(begin_s - self.begin_s) < _CLOCK_TOLERANCE_S:
            self.begin_s = begin_s
        sizes = {
            chain.robot: (len(chain.start), len(history.cleared_ns[k]))
            for k, chain in enumerate(self._execution.tpg.chains)
            if chain.robot in self._rows
        }
        for robot, t_ns, sample in self.log.before(sizes):
            self._rows[robot].add(t_ns, sample)
        for k, chain in enumerate(self._execution.tpg.chains):
            begun, done = history.start_ns[k], history.end_ns[k]
            if (link := self.links.get(chain.robot)) is not None:
                known = len(self._rows[chain.robot].begin_ns)
                link.begun = max(link.begun, len(begun), known)
            (
                self._execution.start[k][: len(begun)],
                self._execution.end[k][: len(done)],
            ) = (
                begun,
                done,
            )
        if self._execution.narrator is not None:
            self._execution.narrator.held_by(history.holders)

    def correct_times(self) -> None:
        """Correct node times of the log by samples; the log has the times of the reports.

        Samples that were not on the disk are resent after a restart of the dispatcher.
        """
        for k, chain in enumerate(self._execution.tpg.chains):
            if (rows := self._rows.get(chain.robot)) is not None:
                for known_times, own in (
                    (self._execution.start[k], rows.begin_ns),
                    (self._execution.end[k], rows.end_ns),
                ):
                    known_times[: len(own)] = map(min, known_times, own)

    def node_times(self) -> NodeTimes:
        """Return node durations."""
        took = []
        for k, planned in enumerate(self._execution.times.motion):
            start, end = (
                np.array(self._execution.start[k]),
                np.array(self._execution.end[k]),
            )
            took.append(np.where(end >= 0, end - start, planned).astype(np.int64))
        stood = tuple(np.zeros_like(own) for own in took)
        return replace(self._execution.times, motion=tuple(took), stood=stood)

    def measured(self) -> dict[str, Measured]:
        """Return the positions of robots measured by their drivers."""
        return {n: rows.measured() for n, rows in self._rows.items() if rows.t_ns}

    # Time and samples

    def passed_ns(self) -> int:
        """Return the current time of the run [ns]."""
        return self._run_ns(self.wall_s())

    def _run_ns(self, at_s: float) -> int:
        """Convert a time of the clock to a time of the run [ns]."""
        return round((at_s - self.begin_s) * self.pace * NANOSECONDS)

    def note(self, report: Report, state: DriverState) -> None:
        """Store the samples and node times of a report."""
        name, now_s = report.robot, self.wall_s()
        link = self.links[name]
        if (samples := link.samples(report)) is not None:
            self._missing_since_s.pop(name, None)
        elif now_s - self._missing_since_s.setdefault(name, now_s) <= _MISSING_S:
            return
        self._store_samples(
            name, link.state_alone(report) if samples is None else samples
        )
        # Without samples, as after a restart of the driver, nodes are known to be done, but not since when.
        begun = max(state.begun, link.failed + 1)
        self._rows[name].note(self.passed_ns(), begun, state.done)

    def _store_samples(self, name: str, samples: Sequence[Sample]) -> None:
        """Store samples; lost ones in between are replaced by the corners of the path."""
        link, rows = self.links[name], self._rows[name]
        path = link.cleared, rows.cleared_ns, link.start
        for sample in samples:
            if not rows.is_new(sample):
                continue
            own = self._run_ns(link.when(sample.at_s)), sample
            lost = [] if rows.last is None else samples_between(rows.last, own, *path)
            for t_ns, one in (*lost, own):
                if rows.add(t_ns, one):
                    self.log.write(name, t_ns, one)

    # Robots

    def link(self, chain: int) -> Link | None:
        """Return the link of a chain's driver; None for a machine."""
        return self.links.get(self._execution.tpg.chains[chain].robot)

    def _released(self, chain: int, node: int) -> None:
        """Clear a released node to the driver of its robot."""
        if (link := self.link(chain)) is not None:
            self._rows[link.robot].cleared_ns[node:] = [self.passed_ns()]
            self._clear(link, chain, node)

    def _clear(
        self, link: Link, chain: int, node: int, *, passed: bool = False
    ) -> None:
        """Clear a node for a driver, and register the tool action of another robot within it."""
        about = self._execution.tpg, chain, node, self._acts[chain]
        if (other := tool_order_of_node(*about)) is not None and not passed:
            link.awaited.append(AwaitedActuation(node, *other))
        if other is not None and self.history is not None:
            self.links[other[0]].orders.add(other[1].name)
        link.clear([cleared_node(*about)])

    def sync_tool_commands(self) -> None:
        """Continue skills after the tool action of the other robot."""
        for name, node in sync_tool_commands(self.links):
            # The skill continues while another robot's tool acts, as planned.
            self._rows[name].note(self.passed_ns(), node + 1, 0)

    def execute(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Follow a node that a driver executes; return whether its task failed for good."""
        if self.link(chain) is None:
            if self._execution.start[chain][node] < 0:
                return (yield from self._simulated.execute(chain, node))
            yield from self._finish_undriven(chain, node)
            return False
        name = self._execution.tpg.chains[chain].robot
        while not self._reached(name, node):
            yield self.updates[name]
        rows = self._rows[name]
        if self._execution.start[chain][node] < 0:
            self._execution.start[chain][node] = rows.begin_ns[node]
            self._execution.count_patience(chain, node)
            if self._execution.narrator is not None:
                self._execution.narrator.emit("started", chain, node)
        while not self._reached(name, node, through=True):
            yield self.updates[name]
        if self.links[name].failed == node:
            if self._execution.narrator is not None:
                words = self.states[name].words
                self._execution.narrator.emit("failed", chain, node, detail=words)
            return True
        self._complete(chain, node)
        self._execution.end[chain][node] = rows.end_ns[node]
        return False

    def _finish_undriven(self, chain: int, node: int) -> Steps:
        """Execute the rest of a node without a driver that began before the dispatcher's restart."""
        end_ns = self._simulated.motion_end(
            chain, node, self._execution.start[chain][node]
        )
        yield self._execution.env.timeout(max(end_ns - self._execution.now_ns, 0))
        self._complete(chain, node)

    def _complete(self, chain: int, node: int) -> None:
        """Report a node complete, with its handlings that are not logged yet."""
        if self._execution.narrator is not None:
            known = self.history.handled[chain, node] if self.history else 0
            handled = self._execution.narrator.handlings.get((chain, node), ())
            for _, item, holder in handled[known:]:
                self._execution.narrator.handle(chain, node, item, holder)
            self._execution.narrator.emit("completed", chain, node)
        self._execution.complete(chain, node)

    def _reached(self, name: str, node: int, *, through: bool = False) -> bool:
        """Return whether a robot has begun, completed or failed a node."""
        rows, failed = self._rows[name], self.links[name].failed == node
        times = rows.end_ns if through else rows.begin_ns
        return len(times) > node or (failed and len(rows.begin_ns) > node)

    def extended(self) -> None:
        """Withdraw clearances of drivers beyond the committed prefix."""
        execution = self._execution
        self._acts = actuation_nodes(execution.tpg)
        for name, link in self.links.items():
            if (k := execution.tpg.chain_index.get(name)) is not None:
                link.swap(execution.revision, execution.released[k])
