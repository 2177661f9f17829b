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
from typing import Any, Literal, NamedTuple

import simpy

from planning.errors import RequestError
from twin.drivers.driver import DriverState
from twin.durations.model import NANOSECONDS
from twin.engine.ending import Ending, EndingCode, PendingNode
from twin.live.driver_end import Wire
from twin.live.inbox import Inbox
from twin.live.link import Link
from twin.live.measured import History, MeasuredLog
from twin.live.reported_execution import ReportedExecution
from twin.live.wire_format import Report
from twin.operate.committed import Version
from twin.run.events import EventCode, EventKind, Outcome

_TICK_S = 0.02
"""How long messages are waited for at most, before links are looked at again [s]."""

_MOST_SLOWER = 10.0
"""A node may take so many times as long as planned, and as a driver may be silent, until it counts as stuck."""


class _Trouble(NamedTuple):
    """Reason not to rely on a driver: its kind, and the words for it."""

    kind: Literal["fault", "unheard", "report", "silent"]
    words: str


class LiveExecution(ReportedExecution):
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
        clock: returns the time, counted from anywhere [s].
        inbox: reports that have arrived.
    """

    attended = False
    """Whether a person may give orders."""

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
        clock: Callable[[], float] = time.monotonic,
        inbox: Inbox | None = None,
        **options: Any,
    ) -> None:
        super().__init__(
            *rest,
            links=links,
            pace=pace,
            log=MeasuredLog(measured),
            history=history,
            clock=clock,
            **options,
        )
        self._wires, self._inbox = wires, inbox or Inbox()
        self._written, self._out_s = written, out_s
        self._tolerance = tolerance
        self._told: dict[str, _Trouble | None] = {}
        self._silent = set(links)
        self._settled = True
        self._believed_s: dict[str, float] = {}
        self._progress, self._progress_s, self._idle_s = -1, 0.0, 0.0

    def execute(self) -> Outcome:
        """Run until everything is done, nothing can go on, or the user interrupts.

        Raises:
            RequestError: a driver is not there at the beginning.
            OutputError: the log cannot be written any more.
        """
        try:
            for wire in self._wires.values():
                wire.open(self._inbox.put)
            if self._history is not None:
                self.env.run(until=max(self._history.since_ns, 1))
                if self.narrator is not None:
                    code = EventCode.DISPATCHER_RESTARTED
                    self.narrator.emit("resumed", detail=code.value)
                self._written()  # numbers of commands depend on how often this is in the log
                for k, node in self.impatient:
                    if (begun := self.start[k][node]) >= 0:
                        self._count_patience(k, node, begun - self.now_ns)
            self._gather()
            for name, state in self._states.items():
                self._stop_off_path(name, state)
            return super().execute()
        finally:
            # Whatever goes wrong on the way, all drivers are told to stand, and nobody waits for them.
            self._correct_times()
            with ExitStack() as stack:
                stack.callback(self._log.close)
                for name, wire in self._wires.items():
                    stack.callback(wire.close)
                    stack.callback(self._let_go, name)

    def _let_go(self, name: str) -> None:
        self._links[name].say_leave()
        last = self._links[name].command(self._wall_s())
        if last is not None:
            self._wires[name].send(replace(last, nodes=()))

    def _gather(self) -> None:
        """Wait until all drivers have been heard of; the run's time begins then.

        Those of a run that was over by its log may have left.
        """
        begin_s = self._wall_s()
        if self._history and len(self._history.finished) == len(self.tpg.chains):
            self._silent.clear()
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
        self._silent.clear()
        if self._history is None:
            self._begin_s = self._wall_s()
            self._log.begin(self._begin_s)

    def _meet(self, report: Report) -> None:
        """Take note of a report that comes before the run's time begins."""
        if (state := self._heard(report)) is not None:
            self._states[report.robot] = state
            if self._history is not None:
                self._note(report, state)

    def _heard(self, report: Report) -> DriverState | None:
        """Return what a report says, None where it is to be left aside."""
        link = self._links.get(report.robot)
        return None if link is None else link.receive(report, self._wall_s())

    # Time

    def _upcoming(self) -> float:
        """Wait until something happens next, and return when that is [ns]; infinity at the end of the run."""
        while True:
            if self.ended is not None:
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
            self._look_at_links(self._wall_s())
            self._end_if_nothing_comes(due, self._wall_s())
            wait = min((due - now) / NANOSECONDS / self._pace, _TICK_S)
            with suppress(queue.Empty):
                self._take(self._inbox.get(timeout=max(wait, 0.0)))

    def deadlock(self) -> str:
        """Return why the run ends before all is done."""
        return super().deadlock() if self.ended is None else self.ended.words

    def _end(self, code: EndingCode, robot: str, words: str) -> None:
        """End the session with its first cause, and with what all robots wait for where none has caused it."""
        if self.ended is None:
            pending = self._pending()
            waits = "; ".join(node.words() for node in pending)
            words = words if robot else f"{words}: {waits}"
            self.ended = Ending(code, robot, words, pending)

    def _end_if_nothing_comes(self, due_ns: float, now_s: float) -> None:
        """End a session in which no event is due and nobody is to act, or no robot makes progress for very long."""
        links = self._links
        acting = {name for name in links if self._may_act(name, now_s)}
        person = self.attended and any(links[name].held for name in acting - self._out)
        progress = sum(
            own.begun + own.done + len(own.cleared) - len(own.awaited)
            for own in links.values()
        )
        active = due_ns < math.inf or self._planning or person
        if active or progress != self._progress:
            self._progress, self._progress_s, self._idle_s = progress, now_s, now_s
        elif acting:
            self._idle_s = now_s
        planned_ns = max((own.max(initial=0) for own in self.times.motion), default=0)
        most_s = self._out_s + float(planned_ns) / NANOSECONDS / self._pace
        if now_s - self._idle_s > self._out_s:
            self._end("nothing-to-come", "", "nothing can go on")
        elif (stuck_s := now_s - self._progress_s) > _MOST_SLOWER * most_s:
            self._end("no-progress", "", f"no progress for {stuck_s:.4g} s")

    def _may_act(self, name: str, now_s: float) -> bool:
        """Return whether a driver, or a person at its robot, may still bring something about.

        A driver that stands between two nodes has reported all that it was cleared for, or does not go on.
        """
        if name in self._silent and name not in self._out:
            return True  # it is given up once it is silent for too long
        link, state = self._links[name], self._states.get(name)
        old = now_s - self._believed_s.get(name, -math.inf) > self._out_s
        if old or state is None or state.mode == "fault":
            return False
        if link.held or state.mode == "held":
            return self.attended or not link.held
        return state.mode == "moving" or state.begun > state.done or link.is_acting

    def _pending(self) -> tuple[PendingNode, ...]:
        """Return the next node of every robot and machine that has nodes left."""
        found = []
        for k, chain in enumerate(self.tpg.chains):
            node = next((n for n, end in enumerate(self.end[k]) if end < 0), None)
            if node is None:
                continue
            waits = self.dispatcher.waits_for(k, node)
            names = tuple((self.tpg.chains[other].robot, n) for other, n in waits)
            state, link = self._states.get(chain.robot), self._link(k)
            mode, held = state.mode if state else None, bool(link and link.held)
            about = chain.robot, node, self.task[k][node], node < self.released[k]
            found.append(PendingNode(*about, names, mode, held))
        return tuple(found)

    def _take(self, report: Report) -> None:
        """Take note of a report, as something that happens now in the simulation."""
        if (state := self._heard(report)) is None:
            return
        self._note(report, state)
        self._now(self._observe, report.robot, state)

    def _now(self, act: Callable[..., None], *about: Any) -> None:
        """Let something happen in the simulation at the time that it is."""
        happens = self.env.timeout(max(self._passed_ns() - self.now_ns, 0))
        happens.callbacks.append(lambda _: act(*about))

    def _observe(self, name: str, state: DriverState) -> None:
        self._states[name], self._believed_s[name] = state, self._wall_s()
        if name in self._silent and self._told.pop(name, None):
            self._tell_of_driver(name, "")  # before all that it has done meanwhile
        self._stop_off_path(name, state)
        self._see_to_tools()
        news, self._news[name] = self._news[name], self.env.event()
        news.succeed()
        if name in self._silent:
            self._silent.discard(name)
            self._dispatch_again()

    def _stop_off_path(self, name: str, state: DriverState) -> None:
        """Stop all where a robot is too far off its path; one at fault is given up with its own cause."""
        if state.off <= self._tolerance or state.mode == "fault" or self.ended:
            return
        # What was planned to be free is not known to be so any more.
        words = (
            f"is {state.off:.4g} rad or m off its path, more than {self._tolerance:g}"
        )
        self._tell_of_driver(name, words)
        self._end("off-path", name, f"{name} {words}")
        for link in self._links.values():
            link.hold(True)

    def _look_at_links(self, now_s: float) -> None:
        """Tell drivers what they are to know, and see whether they are there."""
        for name, link in self._links.items():
            self._send(name)
            trouble = out = self._why_out(name, now_s)
            if not link.alive(now_s):
                self._silent.add(name)
                trouble = trouble or _Trouble("silent", "no sign of life")
            if trouble != self._told.get(name):
                self._told[name] = trouble
                self._now(self._tell_of_driver, name, trouble.words if trouble else "")
                if out:
                    self._now(self._give_up_driver, name, out.words)

    def _why_out(self, name: str, now_s: float) -> _Trouble | None:
        """Return why a driver is not to be relied on any more, None where it is."""
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

    def _tell_of_driver(self, name: str, words: str) -> None:
        if self.narrator is not None and name in self.tpg.chain_index:
            kind: EventKind = "stopped" if words else "resumed"
            self.narrator.emit(kind, self.tpg.chain_index[name], detail=words)

    def _give_up_driver(self, name: str, words: str) -> None:
        """Go on without a robot that stands at a border; where it stands elsewhere, end the run."""
        if name in self._out or self.ended is not None:
            return
        link, k = self._links[name], self.tpg.chain_index.get(name)
        if k is None or link.rests(self.released[k], self._tolerance):
            self.outage(name, self.now_ns)
        else:
            self._end("driver-lost", name, f"{name} {words}")

    def _send(self, name: str) -> None:
        command = self._links[name].command(self._wall_s())
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

    def _next_is_safe(self, chain: int) -> bool:
        link = self._link(chain)
        if not (self._settled and super()._next_is_safe(chain)):
            return False
        if link is None or link.alive(self._wall_s()):
            return True
        # Its next report has the dispatcher look again, also where reports wait that were not heard yet.
        self._silent.add(link.robot)
        return False
