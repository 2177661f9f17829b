"""Execution by drivers: the dispatcher clears nodes to them, and what happens when is what they report.

The simulation's own clock is kept in step with the time that passes. Whatever belongs to no driver, such as
a person who brings a part, takes the time that the twin says.
"""

from __future__ import annotations

import math
import queue
import threading
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import simpy

from planning.errors import RequestError
from scheduling.graph.task_edges import actuation_nodes
from twin.drivers.driver import DriverState, Sample, cleared_node, order_of
from twin.durations.model import NANOSECONDS
from twin.engine.processes import Steps
from twin.live.driver_end import Wire
from twin.live.inbox import Inbox
from twin.live.link import AwaitedAct, Link, see_to_tools
from twin.live.measured import ANEW, History, MeasuredLog, MeasuredRows, samples_between
from twin.live.wire_format import Report
from twin.operate.committed import Version
from twin.operate.rolling import RollingExecution
from twin.run.events import EventKind, Measured, Outcome
from twin.uncertainty.node_times import NodeTimes

_SAME_CLOCK_S = 60.0
"""The age of a log tells so well when its run began; further off, the machine's clock began anew [s]."""

_TICK_S = 0.02
"""How long messages are waited for at most, before links are looked at again [s]."""


class LiveExecution(RollingExecution):
    """State of one run that drivers execute.

    Args:
        rest, options: as of an execution that may be extended.
        links: what is known of each driver, by robot.
        wires: what carries messages to it.
        written: sees to it that all events so far are on the disk; called before a driver is cleared for more.
        out_s: a robot whose driver has been silent for so long is out [s].
        tolerance: farthest that a joint may be from its path [rad or m]; beyond it all stop.
        pace: how many times as fast as the clock the run's time goes.
        measured: where samples are written; None for nowhere.
        history: what has happened by the log, where the dispatcher was started anew.
    """

    driven = True

    def __init__(
        self,
        *rest: Any,
        links: Mapping[str, Link],
        wires: Mapping[str, Wire],
        written: Callable[[], None],
        out_s: float,
        tolerance: float = math.inf,
        pace: float = 1.0,
        measured: Path | None = None,
        history: History | None = None,
        **options: Any,
    ) -> None:
        super().__init__(*rest, **options)
        self._links, self._wires = links, wires
        self._written, self._out_s = written, out_s
        self._tolerance = tolerance
        self._inbox = Inbox()
        since_s = history.since_ns / NANOSECONDS if history else 0.0
        self._begin_s, self._pace = time.monotonic() - since_s / pace, pace
        self._states: dict[str, DriverState] = {}
        self._told: dict[str, str] = {}
        self._silent = set(links)
        self._broken, self._settled = "", True
        self._news = {name: self.env.event() for name in links}
        self._rows = {name: MeasuredRows() for name in links}
        self._acts = actuation_nodes(self.tpg)
        self._log, self._history = MeasuredLog(measured), history
        if history is not None:
            self._remember(history)

    def _remember(self, history: History) -> None:
        """Take up the state that a log tells of."""
        for k, chain in enumerate(self.tpg.chains):
            cleared, done = history.cleared_ns[k], history.end_ns[k]
            self.released[k] = len(cleared)
            self.outstanding[k] = len(cleared) - len(done)
            if done:
                self.dispatcher.observe(k, len(done) - 1)
            if k in history.finished:
                self._finished[k] = len(chain)
            if (link := self._links.get(chain.robot)) is not None:
                for node in range(len(cleared)):
                    self._clear(link, k, node, passed=node < len(done))
                link.go_on(history.starts, len(done))
                link.hold(chain.robot in history.held)
                self._rows[chain.robot].cleared_ns = list(cleared)
        begin_s = self._log.begin_s()
        if begin_s is not None and abs(begin_s - self._begin_s) < _SAME_CLOCK_S:
            self._begin_s = begin_s
        for robot, t_ns, sample in self._log.before():
            self._rows[robot].add(t_ns, sample)
        for k, chain in enumerate(self.tpg.chains):
            begun, done = history.start_ns[k], history.end_ns[k]
            if (rows := self._rows.get(chain.robot)) is not None:
                # The log tells when the dispatcher heard of it.
                rows.begin_ns += begun[len(rows.begin_ns) :]
                rows.end_ns += done[len(rows.end_ns) :]
                self._links[chain.robot].begun = len(rows.begin_ns)
                begun, done = rows.begin_ns[: len(begun)], rows.end_ns[: len(done)]
            self.start[k][: len(begun)], self.end[k][: len(done)] = begun, done
        if self.narrator is not None:
            self.narrator.held_by(history.holders)

    def _robot(self, chain: int, node: int = 0) -> Steps:
        done = len(self._history.end_ns[chain]) if self._history else 0
        return super()._robot(chain, max(node, done))

    def execute(self) -> Outcome:
        """Run until everything is done, nothing can go on, or the user interrupts.

        Raises:
            RequestError: a driver is not there at the beginning.
            OutputError: the log cannot be written any more.
        """
        try:
            for wire in self._wires.values():
                wire.open(self._inbox.put)
            self._gather()
            if self._history is not None:
                self.env.run(until=self._history.since_ns)
                if self.narrator is not None:
                    self.narrator.emit("resumed", detail=ANEW)
            for name, state in self._states.items():
                self._stop_off_path(name, state)
            return super().execute()
        finally:
            # Whatever goes wrong on the way, all drivers are told to stand, and nobody waits for them.
            with ExitStack() as stack:
                stack.callback(self._log.close)
                for name, wire in self._wires.items():
                    stack.callback(wire.close)
                    stack.callback(self._let_go, name)

    def _let_go(self, name: str) -> None:
        self._links[name].say_leave()
        last = self._links[name].command(time.monotonic())
        if last is not None:
            self._wires[name].send(replace(last, nodes=()))

    def _gather(self) -> None:
        """Wait until all drivers have been heard of; the run's time begins then.

        Those of a run that was over by its log may have left.
        """
        begin_s = time.monotonic()
        if self._history and len(self._history.finished) == len(self.tpg.chains):
            self._silent.clear()
            return
        while missing := sorted(self._links.keys() - self._states.keys()):
            if time.monotonic() - begin_s > self._out_s:
                raise RequestError(
                    f"no driver of {', '.join(missing)} has been heard of for {self._out_s:g} s"
                )
            for name, link in self._links.items():
                if link.problem is not None:
                    raise RequestError(f"{name}: {link.problem}")
                self._send(name)
            with suppress(queue.Empty):
                report = self._inbox.get(timeout=_TICK_S)
                if (state := self._heard(report)) is not None:
                    self._states[report.robot] = state
                    if self._history is not None:
                        self._note(report, state)
        self._silent.clear()
        if self._history is None:
            self._begin_s = time.monotonic()
            self._log.begin(self._begin_s)

    def _heard(self, report: Report) -> DriverState | None:
        """Return what a report says, None where it is to be left aside."""
        link = self._links.get(report.robot)
        return None if link is None else link.receive(report, time.monotonic())

    def node_times(self) -> NodeTimes:
        """Return how long nodes took."""
        took = []
        for k, planned in enumerate(self.times.motion):
            start, end = np.array(self.start[k]), np.array(self.end[k])
            took.append(np.where(end >= 0, end - start, planned).astype(np.int64))
        stood = tuple(np.zeros_like(own) for own in took)
        return replace(self.times, motion=tuple(took), stood=stood)

    def measured(self) -> dict[str, Measured]:
        """Return where robots were, as their drivers have measured it."""
        return {n: rows.measured() for n, rows in self._rows.items() if rows.t_ns}

    # Time

    def _passed_ns(self) -> int:
        """Return how late it is in the run [ns]."""
        passed_s = time.monotonic() - self._begin_s
        return round(passed_s * self._pace * NANOSECONDS)

    def _upcoming(self) -> float:
        """Wait until something happens next, and return when that is [ns]; infinity at the end of the run."""
        while True:
            if self._broken:
                return math.inf
            due = super()._upcoming()
            now = self._passed_ns()
            over = self._done() and not self._planning
            if due <= now or (due == math.inf and over):
                return due
            if self._inbox.is_behind():
                # All that has come while something was planned is heard before anybody counts as silent.
                self._take(self._inbox.get(timeout=0.0))
                continue
            self._look_at_links(time.monotonic())
            wait = min((due - now) / NANOSECONDS / self._pace, _TICK_S)
            with suppress(queue.Empty):
                self._take(self._inbox.get(timeout=max(wait, 0.0)))

    def deadlock(self) -> str:
        """Return why the run ends before all is done."""
        return self._broken or super().deadlock()

    def _take(self, report: Report) -> None:
        """Take note of a report, as something that happens now in the simulation."""
        if (state := self._heard(report)) is None:
            return
        self._note(report, state)
        self._now(self._observe, report.robot, state)

    def _note(self, report: Report, state: DriverState) -> None:
        """Keep the samples of a report."""
        name = report.robot
        link, rows = self._links[name], self._rows[name]
        if (samples := link.samples(report)) is None:
            return
        for sample in samples:
            own_s = link.when(sample.at_s) - self._begin_s
            own_ns = round(own_s * self._pace * NANOSECONDS)
            for t_ns, own in (*self._unseen(name, own_ns, sample), (own_ns, sample)):
                if rows.add(t_ns, own):
                    self._log.write(name, t_ns, own)
        # Of what no sample tells, as the driver was started anew, only that it has happened is known.
        now = self._passed_ns()
        begun = max(state.begun, link.failed + 1)
        rows.begin_ns += [now] * (begun - len(rows.begin_ns))
        rows.end_ns += [now] * (state.done - len(rows.end_ns))

    def _unseen(self, name: str, t_ns: int, sample: Sample) -> list[tuple[int, Sample]]:
        """Return what is taken to have been between a sample and the one before it, if that was lost."""
        link, rows = self._links[name], self._rows[name]
        if rows.last is None or not rows.is_new(sample):
            return []
        path = link.cleared, rows.cleared_ns, link.start
        return samples_between(rows.last, (t_ns, sample), *path)

    def _now(self, act: Callable[..., None], *about: Any) -> None:
        """Let something happen in the simulation at the time that it is."""
        happens = self.env.timeout(max(self._passed_ns() - self.now_ns, 0))
        happens.callbacks.append(lambda _: act(*about))

    def _observe(self, name: str, state: DriverState) -> None:
        self._states[name] = state
        self._stop_off_path(name, state)
        self._see_to_tools()
        news, self._news[name] = self._news[name], self.env.event()
        news.succeed()
        if name in self._silent:
            self._silent.discard(name)
            self._dispatch_again()

    def _stop_off_path(self, name: str, state: DriverState) -> None:
        """Stop all where a robot is too far off its path; one at fault is given up with its own cause."""
        if state.off <= self._tolerance or state.mode == "fault" or self._broken:
            return
        # What was planned to be free is not known to be so any more.
        words = (
            f"is {state.off:.4g} rad or m off its path, more than {self._tolerance:g}"
        )
        self._tell_of_driver(name, words)
        self._broken = f"{name} {words}"
        for link in self._links.values():
            link.hold(True)

    def _look_at_links(self, now_s: float) -> None:
        """Tell drivers what they are to know, and see whether they are there."""
        for name, link in self._links.items():
            self._send(name)
            words = why = self._why_out(name, now_s)
            if not link.alive(now_s):
                self._silent.add(name)
                words = words or "no sign of life"
            if words != self._told.get(name, ""):
                self._told[name] = words
                self._now(self._tell_of_driver, name, words)
                if why:
                    self._now(self._give_up_driver, name, why)

    def _why_out(self, name: str, now_s: float) -> str:
        """Return why a driver is not to be relied on any more, empty where it is."""
        link, state = self._links[name], self._states.get(name)
        if state is not None and state.mode == "fault":
            return state.words
        silent = link.silent_s(now_s)
        if silent is not None and silent > self._out_s:
            return f"has not been heard of for {self._out_s:g} s"
        return str(link.problem or "")

    def _tell_of_driver(self, name: str, words: str) -> None:
        if self.narrator is not None and name in self.tpg.chain_index:
            kind: EventKind = "stopped" if words else "resumed"
            self.narrator.emit(kind, self.tpg.chain_index[name], detail=words)

    def _give_up_driver(self, name: str, words: str) -> None:
        """Go on without a robot that stands at a border; where it stands elsewhere, end the run."""
        if name in self._out or self._broken:
            return
        link, k = self._links[name], self.tpg.chain_index.get(name)
        if k is None or link.rests(self.released[k], self._tolerance):
            self.outage(name, self.now_ns)
        else:
            self._broken = f"{name} {words}"

    def _send(self, name: str) -> None:
        command = self._links[name].command(time.monotonic())
        if command is not None:
            self._log.flush()  # what a driver is told to have been heard, it forgets
            if command.nodes:
                self._written()
            self._wires[name].send(command)

    # Planning

    def _version(self) -> Generator[simpy.Event, Any, Version]:
        """Plan what is left in a thread of its own: drivers are heard meanwhile, and what people order is done.

        Until there is a plan nothing more is cleared, as nobody knows yet from where on things will be different.
        """
        self._settled = False
        made: Future[Version] = Future()
        given = self.tpg, self._incident()

        def plan() -> None:
            try:
                made.set_result(self._planner.plan(*given))
            except Exception as error:
                made.set_exception(error)

        threading.Thread(target=plan, daemon=True).start()
        while not made.done():
            yield self.env.timeout(round(_TICK_S * self._pace * NANOSECONDS))
        self._settled = True
        # Who cannot be planned for before a question is answered goes on as far as the plan goes.
        self._dispatch_again()
        return made.result()

    # Robots

    def _link(self, chain: int) -> Link | None:
        return self._links.get(self.tpg.chains[chain].robot)

    def _release(self, chain: int) -> None:
        node, link = self.released[chain], self._link(chain)
        super()._release(chain)
        if link is not None:
            rows = self._rows[link.robot]
            rows.cleared_ns[node:] = [self._passed_ns()]
            self._clear(link, chain, node)

    def _clear(
        self, link: Link, chain: int, node: int, *, passed: bool = False
    ) -> None:
        """Let a robot pass a node, once the tool of another one has done what it does there."""
        about = self.tpg, chain, node, self._acts[chain]
        if (other := order_of(*about)) is not None and not passed:
            link.awaited.append(AwaitedAct(node, *other))
        if other is not None and self._history is not None:
            self._links[other[0]].orders.add(other[1].name)
        link.clear([cleared_node(*about)])

    def _see_to_tools(self) -> None:
        for name, node in see_to_tools(self._links):
            # The skill goes on while another robot's tool acts, as planned.
            begun = self._rows[name].begin_ns
            begun += [self._passed_ns()] * (node + 1 - len(begun))

    def _next_is_safe(self, chain: int) -> bool:
        link = self._link(chain)
        alive = link is None or link.alive(time.monotonic())
        return self._settled and alive and super()._next_is_safe(chain)

    def _pass(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Follow a node that a driver executes, and return whether its task failed for good."""
        if self._link(chain) is None:
            return (yield from super()._pass(chain, node))
        name = self.tpg.chains[chain].robot
        while not self._reached(name, node):
            yield self._news[name]
        rows = self._rows[name]
        if self.start[chain][node] < 0:
            self.start[chain][node] = rows.begin_ns[node]
            self._count_patience(chain, node)
            if self.narrator is not None:
                self.narrator.emit("started", chain, node)
        while not self._reached(name, node, through=True):
            yield self._news[name]
        if self._links[name].failed == node:
            self.failed.append(chain)
            if self.narrator is not None:
                words = self._states[name].words
                self.narrator.emit("failed", chain, node, detail=words)
            return True
        if self.narrator is not None:
            handled = self.narrator.handlings.get((chain, node), ())
            for _, item, holder in handled:
                self.narrator.handle(chain, node, item, holder)
            self.narrator.emit("completed", chain, node)
        self._complete(chain, node)
        self.end[chain][node] = rows.end_ns[node]
        return False

    def _reached(self, name: str, node: int, *, through: bool = False) -> bool:
        """Tell whether a robot has begun a node, or is through with it, or has failed there."""
        rows, failed = self._rows[name], self._links[name].failed == node
        times = rows.end_ns if through else rows.begin_ns
        return len(times) > node or (failed and len(rows.begin_ns) > node)

    def _swap(self, version: Version) -> None:
        super()._swap(version)
        self._acts = actuation_nodes(self.tpg)
        for name, link in self._links.items():
            if (k := self.tpg.chain_index.get(name)) is not None:
                link.swap(len(self.versions) + 1, self.released[k])
