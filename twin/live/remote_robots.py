"""Robots moved by drivers: the dispatcher clears nodes for execution, and drivers report their progress.

The simulation clock follows real time. Everything without a driver is simulated, such as a person who brings a part.
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
from typing import Any, Literal, NamedTuple, TypeVar

import simpy

from planning.errors import RequestError
from twin.drivers.driver import DriverState
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.ending import Ending, EndingCode, PendingNode
from twin.engine.execution import Execution
from twin.engine.ports import Replanner, RobotPort
from twin.live.driver_end import Wire
from twin.live.inbox import Inbox
from twin.live.link import Link
from twin.live.measured_log import MeasuredLog
from twin.live.messages import Report
from twin.live.reported_nodes import ReportedNodes
from twin.live.run_history import History
from twin.runs.events import EventCode, EventKind
from twin.runs.execution_record import Measured
from twin.uncertainty.node_times import NodeTimes

_T = TypeVar("_T")

_TICK_S = 0.02
"""How long messages are waited for at most, before links are looked at again [s]."""

_MOST_SLOWER = 10.0
"""Factor on the planned duration and on the allowed silence after which a node counts as stuck."""


class _Trouble(NamedTuple):
    """Reason to distrust a driver: its kind and text."""

    kind: Literal["fault", "unheard", "report", "silent"]
    words: str


class RemoteRobots(RobotPort):
    """Robots moved by drivers; the execution must have a replanner.

    Attributes:
        nodes: nodes reported by drivers.
        written: see the arguments.
        silent: robots whose drivers show no sign of life.

    Args:
        execution: the run.
        links: state of the protocol of each driver, by robot.
        wires: carries messages to it.
        written: flushes all events to the disk; called before further nodes are cleared.
        out_s: a robot whose driver has been silent for so long is out of service [s].
        tolerance: farthest that a joint may be from its path [rad or m]; beyond it all stop.
        pace: how many times as fast as the clock the run's time goes.
        measured: where samples are written; None for nowhere.
        history: history of the log, where the dispatcher was restarted.
        clock: returns the time, counted from anywhere [s].
        inbox: reports that have arrived.
    """

    driven = True

    def __init__(
        self,
        execution: Execution,
        *,
        links: Mapping[str, Link],
        wires: Mapping[str, Wire],
        written: Callable[[], None],
        out_s: float,
        tolerance: float = math.inf,
        pace: float = 1.0,
        measured: Path | None = None,
        history: History | None = None,
        clock: Callable[[], float] = time.monotonic,
        inbox: Inbox | None = None,
    ) -> None:
        self._execution = execution
        self.upcoming = self._wait
        log = MeasuredLog(measured)
        self.nodes = ReportedNodes(execution, links, pace, log, history, clock)
        self._links, self._states = links, self.nodes.states
        self._wall_s, self._pace = clock, pace
        self._wires, self._inbox = wires, inbox or Inbox()
        self.written, self._out_s = written, out_s
        self._tolerance = tolerance
        self._reported: dict[str, _Trouble | None] = {}
        self.silent = set(links)
        self._settled = True
        self._believed_s: dict[str, float] = {}
        self._progress, self._progress_s, self._idle_s = -1, 0.0, 0.0
        execution.gates.append(self._may_release)

    @property
    def _replanner(self) -> Replanner:
        replanner = self._execution.replanner
        assert replanner is not None
        return replanner

    def begin(self) -> None:
        """Wait until all drivers have connected.

        Raises:
            RequestError: a driver is not there at the beginning.
            OutputError: the log cannot be written any more.
        """
        execution, history = self._execution, self.nodes.history
        for wire in self._wires.values():
            wire.open(self._inbox.put)
        if history is not None:
            execution.env.run(until=max(history.since_ns, 1))
            if execution.narrator is not None:
                code = EventCode.DISPATCHER_RESTARTED
                execution.narrator.emit("resumed", detail=code.value)
            self.written()  # numbers of commands depend on how often this is in the log
            for k, node in execution.impatient:
                if (begun := execution.start[k][node]) >= 0:
                    execution.count_patience(k, node, begun - execution.now_ns)
        self._gather()
        for name, state in self._states.items():
            self._stop_off_path(name, state)

    def close(self) -> None:
        """Stop all drivers without waiting for them."""
        self.nodes.correct_times()
        with ExitStack() as stack:
            stack.callback(self.nodes.log.close)
            for name, wire in self._wires.items():
                stack.callback(wire.close)
                stack.callback(self._let_go, name)

    def execute(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Follow a node that a driver executes; return whether its task failed for good."""
        return self.nodes.execute(chain, node)

    def extended(self) -> None:
        """Withdraw clearances of drivers beyond the committed prefix."""
        self.nodes.extended()

    def node_times(self) -> NodeTimes:
        """Return node durations."""
        return self.nodes.node_times()

    def measured(self) -> dict[str, Measured]:
        """Return the measured positions of robots, by name."""
        return self.nodes.measured()

    def _let_go(self, name: str) -> None:
        self._links[name].say_leave()
        last = self._links[name].command(self._wall_s())
        if last is not None:
            self._wires[name].send(replace(last, nodes=()))

    def _gather(self) -> None:
        """Wait for a report of every driver; the run's time begins then.

        Those of a run that was over by its log may have left.
        """
        begin_s = self._wall_s()
        history = self.nodes.history
        if history and len(history.finished) == len(self._execution.tpg.chains):
            self.silent.clear()
            return
        while missing := sorted(self._links.keys() - self._states.keys()):
            if self._wall_s() - begin_s > self._out_s:
                raise RequestError(
                    f"no driver of {', '.join(missing)} has been heard of for {self._out_s:g} s, or none"
                    " that takes up the session"
                )
            for name, link in self._links.items():
                if link.problem is not None:
                    raise RequestError(f"{name}: {link.problem}")
                self._send(name)
            with suppress(queue.Empty):
                self._meet(self._inbox.get(timeout=_TICK_S))
            # Sending may take longer than reports take to come.
            while self._inbox.is_behind():
                self._meet(self._inbox.get(timeout=0.0))
        self.silent.clear()
        if history is None:
            self.nodes.begin_s = self._wall_s()
            self.nodes.log.begin(self.nodes.begin_s)

    def _meet(self, report: Report) -> None:
        """Handle a report before the start of the run's time."""
        if (state := self._heard(report)) is not None:
            self._states[report.robot] = state
            if self.nodes.history is not None:
                self.nodes.note(report, state)

    def _heard(self, report: Report) -> DriverState | None:
        """Validate a report; None if it is to be ignored."""
        link = self._links.get(report.robot)
        return None if link is None else link.receive(report, self._wall_s())

    # Time

    def _wait(self) -> float:
        """Wait for the next event and return its time [ns]; infinity at the end of the run."""
        while True:
            if self._execution.ended is not None:
                return math.inf
            due = self._execution.next_event_ns()
            now = self.nodes.passed_ns()
            over = self._execution.is_done() and not self._replanner.planning
            if due <= now or (due == math.inf and over):
                return due
            if self._inbox.is_behind():
                # All that has come while something was planned is heard before anybody counts as silent.
                self._take(self._inbox.get(timeout=0.0))
                continue
            self._service_links(self._wall_s())
            self._end_without_progress(due, self._wall_s())
            wait = min((due - now) / NANOSECONDS / self._pace, _TICK_S)
            with suppress(queue.Empty):
                self._take(self._inbox.get(timeout=max(wait, 0.0)))

    def _end(self, code: EndingCode, robot: str, words: str) -> None:
        """End the session with its first cause, or else with the waits of all robots."""
        if self._execution.ended is None:
            pending = self._pending()
            waits = "; ".join(node.words() for node in pending)
            words = words if robot else f"{words}: {waits}"
            self._execution.ended = Ending(code, robot, words, pending)

    def _end_without_progress(self, due_ns: float, now_s: float) -> None:
        """End a session without pending events or actors, or without progress for very long."""
        links = self._links
        attended = self._execution.audience is not None
        acting = {name for name in links if self._may_act(name, now_s)}
        person = attended and any(
            links[name].held for name in acting - self._replanner.out
        )
        progress = sum(
            own.begun + own.done + len(own.cleared) - len(own.awaited)
            for own in links.values()
        )
        active = due_ns < math.inf or self._replanner.planning or person
        if active or progress != self._progress:
            self._progress, self._progress_s, self._idle_s = progress, now_s, now_s
        elif acting:
            self._idle_s = now_s
        planned_ns = max(
            (own.max(initial=0) for own in self._execution.times.motion), default=0
        )
        most_s = self._out_s + float(planned_ns) / NANOSECONDS / self._pace
        if now_s - self._idle_s > self._out_s:
            self._end("nothing-to-come", "", "nothing can continue")
        elif (stuck_s := now_s - self._progress_s) > _MOST_SLOWER * most_s:
            self._end("no-progress", "", f"no progress for {stuck_s:.4g} s")

    def _may_act(self, name: str, now_s: float) -> bool:
        """Return whether a driver, or a person at its robot, may still cause an event.

        A driver that stands between two nodes has reported all cleared nodes, or does not continue.
        """
        if name in self.silent and name not in self._replanner.out:
            return True  # it is excluded after too long a silence
        link, state = self._links[name], self._states.get(name)
        old = now_s - self._believed_s.get(name, -math.inf) > self._out_s
        if old or state is None or state.mode == "fault":
            return False
        if link.held or state.mode == "held":
            return self._execution.audience is not None or not link.held
        return state.mode == "moving" or state.begun > state.done or link.is_acting

    def _pending(self) -> tuple[PendingNode, ...]:
        """Return the next node of every robot and machine that has nodes left."""
        found = []
        for k, chain in enumerate(self._execution.tpg.chains):
            node = next(
                (n for n, end in enumerate(self._execution.end[k]) if end < 0), None
            )
            if node is None:
                continue
            waits = self._execution.dispatcher.waits_for(k, node)
            names = tuple(
                (self._execution.tpg.chains[other].robot, n) for other, n in waits
            )
            state, link = self._states.get(chain.robot), self.nodes.link(k)
            mode, held = state.mode if state else None, bool(link and link.held)
            about = (
                chain.robot,
                node,
                self._execution.task[k][node],
                node < self._execution.released[k],
            )
            found.append(PendingNode(*about, names, mode, held))
        return tuple(found)

    def _take(self, report: Report) -> None:
        """Process a report as an event of the present simulation time."""
        if (state := self._heard(report)) is None:
            return
        self.nodes.note(report, state)
        self.now(self._observe, report.robot, state)

    def now(self, act: Callable[..., None], *about: Any) -> None:
        """Schedule a call in the simulation for the present time of the run."""
        happens = self._execution.env.timeout(
            max(self.nodes.passed_ns() - self._execution.now_ns, 0)
        )
        happens.callbacks.append(lambda _: act(*about))

    def _observe(self, name: str, state: DriverState) -> None:
        self._states[name], self._believed_s[name] = state, self._wall_s()
        if name in self.silent and self._reported.pop(name, None):
            self.record_driver(name, "")  # before all that it has done meanwhile
        self._stop_off_path(name, state)
        self.nodes.sync_tool_commands()
        news, self.nodes.updates[name] = (
            self.nodes.updates[name],
            self._execution.env.event(),
        )
        news.succeed()
        if name in self.silent:
            self.silent.discard(name)
            self._execution.redispatch()

    def _stop_off_path(self, name: str, state: DriverState) -> None:
        """Stop all robots if one is too far off its path; one at fault is excluded with its own cause."""
        if (
            state.off <= self._tolerance
            or state.mode == "fault"
            or self._execution.ended
        ):
            return
        # What was planned to be free is not known to be so any more.
        words = (
            f"is {state.off:.4g} rad or m off its path, more than {self._tolerance:g}"
        )
        self.record_driver(name, words)
        self._end("off-path", name, f"{name} {words}")
        for link in self._links.values():
            link.hold(True)

    def _service_links(self, now_s: float) -> None:
        """Execute orders of people, send commands to drivers, and check their heartbeats."""
        audience = self._execution.audience
        if audience is not None:
            audience.obey()
        for name, link in self._links.items():
            self._send(name)
            trouble = out = self._find_trouble(name, now_s)
            if not link.alive(now_s):
                self.silent.add(name)
                trouble = trouble or _Trouble("silent", "no sign of life")
            if trouble != self._reported.get(name):
                self._reported[name] = trouble
                self.now(self.record_driver, name, trouble.words if trouble else "")
                if out:
                    self.now(self._give_up_driver, name, out.words)
        if audience is not None:
            audience.show_progress(now_s)

    def _find_trouble(self, name: str, now_s: float) -> _Trouble | None:
        """Return why a driver cannot be relied on, None if it can."""
        link, state = self._links[name], self._states.get(name)
        if state is not None and state.mode == "fault":
            return _Trouble("fault", state.words or "is at fault")
        silent = link.silent_s(now_s)
        if silent is not None and silent > self._out_s:
            words = f"has not been heard of for {self._out_s:g} s"
            return _Trouble("unheard", words)
        return (
            _Trouble("report", str(link.problem)) if link.problem is not None else None
        )

    def record_driver(self, name: str, words: str) -> None:
        """Record that a robot has stopped, with the reason, or that it resumes, without one."""
        if (
            self._execution.narrator is not None
            and name in self._execution.tpg.chain_index
        ):
            kind: EventKind = "stopped" if words else "resumed"
            self._execution.narrator.emit(
                kind, self._execution.tpg.chain_index[name], detail=words
            )

    def _give_up_driver(self, name: str, words: str) -> None:
        """Continue without a robot that stands at a border; if it stands elsewhere, end the run."""
        if name in self._replanner.out or self._execution.ended is not None:
            return
        link, k = self._links[name], self._execution.tpg.chain_index.get(name)
        if k is None or link.rests(self._execution.released[k], self._tolerance):
            self._replanner.outage(name, self._execution.now_ns)
        else:
            self._end("driver-lost", name, f"{name} {words}")

    def _send(self, name: str) -> None:
        command = self._links[name].command(self._wall_s())
        if command is not None:
            self.nodes.log.flush()  # a driver drops acknowledged samples
            if command.nodes:
                self.written()
            self._wires[name].send(command)

    # Planning

    def compute(self, work: Callable[[], _T]) -> Generator[simpy.Event, Any, _T]:
        """Return the result of a computation in a thread; reports and orders are processed meanwhile.

        Meanwhile no further node is cleared, as replaced nodes are unknown.
        """
        self._settled = False
        made: Future[_T] = Future()

        def compute() -> None:
            try:
                made.set_result(work())
            except Exception as error:
                made.set_exception(error)

        threading.Thread(target=compute, daemon=True).start()
        while not made.done():
            yield self._execution.env.timeout(round(_TICK_S * self._pace * NANOSECONDS))
        self._settled = True
        # Robots whose plan depends on an open question continue to the end of their plan.
        self._execution.redispatch()
        return made.result()

    def _may_release(self, chain: int) -> bool:
        """Return whether a safe node may be cleared: no replanning in progress, driver alive."""
        link = self.nodes.link(chain)
        if not self._settled:
            return False
        if link is None or link.alive(self._wall_s()):
            return True
        # Its next report has the dispatcher look again, also where reports wait that were not heard yet.
        self.silent.add(link.robot)
        return False
