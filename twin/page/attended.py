"""Execution of a run by drivers, with people who watch the progress, give orders to robots and answer questions."""

from __future__ import annotations

import queue
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import NodeHandling
from scheduling.rolling.cut import complete_tasks
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution import Execution, Ports
from twin.engine.ports import Audience, Steps
from twin.live.remote_robots import RemoteRobots
from twin.live.session import Session
from twin.operations.person import Question
from twin.operations.replanner import RollingReplanner
from twin.page.panel import (
    NodesSoFar,
    Notice,
    Order,
    Panel,
    Shown,
    ShownMode,
    ShownRobot,
)
from twin.runs.events import Event
from twin.runs.execution_record import Outcome
from twin.runs.trajectory import Placement

_SHOW_S, _PROGRESS_S = 0.25, 2.0
"""Periods of display updates, and of forecast inputs [s]."""

_MOST_NOTICES = 60

_QUIET = ("released", "started", "completed", "waiting", "attached", "detached")
"""Events not shown to people."""


@dataclass(frozen=True)
class AttendedSession(Session):
    """Drivers of the robots of an attended cell, for one run.

    Attributes:
        panel: state shared with the page.
    """

    panel: Panel = field(kw_only=True)

    def execution(self, *about: Any, **more: Any) -> Ports:
        """Return the ports of the run; see Session."""
        ports = super().execution(*about, **more)
        return replace(ports, audience=partial(Attendance, panel=self.panel))


class Attendance(Audience):
    """People next to a cell with drivers, connected by a panel.

    While a question is open, the new plan is undecided, and all robots continue the executed plan.

    Args:
        execution: the run, whose robots are ``RemoteRobots`` with a ``RollingReplanner``.
        panel: shared with the page.
    """

    def __init__(self, execution: Execution, panel: Panel) -> None:
        self._cell, self._panel = execution, panel
        self._notices: deque[Notice] = deque(maxlen=_MOST_NOTICES)
        self._question: Question | None = None
        self._asked, self._held = 0, set[str]()
        self._disturbed: set[tuple[int, int]] = set()
        self._show_s = self._progress_s = 0.0
        self._answered = execution.env.event()
        begun = filter(execution.tpg.holds_before, execution.tpg.handlings)
        self._placements = {own.object: _placement(own) for own in begun}

    @property
    def _robots(self) -> RemoteRobots:
        assert isinstance(self._cell.robots, RemoteRobots)
        return self._cell.robots

    @property
    def _replanner(self) -> RollingReplanner:
        assert isinstance(self._cell.replanner, RollingReplanner)
        return self._cell.replanner

    def finish(self, outcome: Outcome | None) -> None:
        """Show how the run has ended; None after an error."""
        self._question = None
        self._panel.show(replace(self._shown(), outcome=outcome or "broken off"))

    # Notices

    def record(self, event: Event) -> None:
        """Keep events that people should know."""
        if event.kind in ("attached", "detached"):
            key = event.object, self._cell.tpg.chain_index[event.robot], event.node
            for h in self._cell.tpg.handlings:
                if (h.object, h.robot, h.node) == key:
                    self._placements[h.object] = _placement(h)
        if event.kind not in _QUIET:
            label = self._cell.tpg.tasks[event.task].label if event.task >= 0 else ""
            new = "" if event.detail.startswith(label) else label
            words = ": ".join(filter(None, (new, event.detail)))
            at_s = event.t_ns / NANOSECONDS
            if event.robot in self._cell.tpg.chain_index:
                k = self._cell.tpg.chain_index[event.robot]
                self._disturbed.add((k, _done(self._cell.end[k])))
            self._notices.appendleft(Notice(at_s, event.robot, event.kind, words))

    def close(self) -> None:
        """Finish; there is nothing to do."""

    # Orders

    def obey(self) -> None:
        """Execute orders given since the last call."""
        while True:
            try:
                order = self._panel.orders.get_nowait()
            except queue.Empty:
                break
            self._robots.now(self._obey, order)

    def show_progress(self, now_s: float) -> None:
        """Show the progress at the robots' time [s]; called some times a second."""
        robots = self._robots
        q = {name: state.q for name, state in robots.nodes.states.items()}
        self._panel.bodies = self._cell.tpg.cell, q, dict(self._placements)
        for name, link in robots.nodes.links.items():
            state = robots.nodes.states.get(name)
            stands = link.held and state is not None and state.mode == "held"
            if stands != (name in self._held):
                (self._held.add if stands else self._held.discard)(name)
                robots.now(robots.record_driver, name, "held" if stands else "")
        if now_s >= self._show_s:
            self._show(now_s)

    def _obey(self, order: Order) -> None:
        """Execute an order after logging it to disk."""
        question, links = self._question, self._robots.nodes.links
        if order.action in ("yes", "no"):
            if question is None or order.question != self._asked:
                return
            self._log_order(f"{order.action}: {question}")
            self._question = None
            self._panel.answers[question] = order.action == "yes"
            answered, self._answered = self._answered, self._cell.env.event()
            answered.succeed()
        elif order.action == "out":
            if order.robot not in links or order.robot in self._replanner.out:
                return
            self._log_order("out", order.robot)
            self._replanner.outage(order.robot, self._cell.now_ns)
        else:
            held = order.action == "hold"
            names = [order.robot] if order.robot else list(links)
            changed = [n for n in names if n in links]
            if not any(links[n].held != held for n in changed):
                return
            self._log_order(order.action, order.robot)
            for name in changed:
                links[name].hold(held)

    def _log_order(self, words: str, robot: str = "") -> None:
        chain = self._cell.tpg.chain_index.get(robot, -1)
        if robot and chain < 0:
            words = f"{words}: {robot}"
        assert self._cell.narrator is not None
        self._cell.narrator.emit("ordered", chain, detail=words)
        self._robots.written()

    # Questions

    def answered(self, question: Question) -> Steps:
        """Wait until a question is answered."""
        self._question = question
        self._asked += 1
        assert self._cell.narrator is not None
        self._cell.narrator.emit("asked", detail=question.words)
        yield self._answered

    # What is shown

    def show_planning(self) -> None:
        """Show that replanning is in progress."""
        self._show(self._robots.nodes.wall_s())

    def _show(self, now_s: float) -> None:
        self._show_s = now_s + _SHOW_S
        self._panel.show(self._shown())
        if now_s >= self._progress_s:
            self._progress_s = now_s + _PROGRESS_S
            cell, now_ns = self._cell, self._robots.nodes.passed_ns()
            start, end = map(tuple, cell.start), map(tuple, cell.end)
            marked = [(k, n) for k, n in self._disturbed if n < len(cell.end[k])]
            self._panel.so_far = NodesSoFar(
                cell.tpg, now_ns, tuple(start), tuple(end), frozenset(marked)
            )

    def _shown(self) -> Shown:
        return Shown(
            self._robots.nodes.passed_ns() / NANOSECONDS,
            tuple(self._shown_robot(name) for name in self._robots.nodes.links),
            self._steps_done(),
            self._panel.steps,
            dict(self._replanner.given_up),
            tuple(self._notices),
            "" if self._question is None else self._question.words,
            self._asked,
            self._replanner.planning,
        )

    def _steps_done(self) -> int:
        complete = complete_tasks(
            self._cell.tpg, [_done(own) for own in self._cell.end]
        )
        steps: dict[int, bool] = {}
        for task in self._cell.tpg.tasks:
            if task.kind not in (TaskKind.LEFT_OUT, TaskKind.BROUGHT):
                before = steps.get(task.step, True)
                steps[task.step] = before and task.index in complete
        return sum(steps.values()) - sum(
            steps.get(k, False) for k in self._replanner.given_up
        )

    def _shown_robot(self, name: str) -> ShownRobot:
        nodes = self._robots.nodes
        state, held = nodes.states.get(name), nodes.links[name].held
        tpg = self._cell.tpg
        k, out = tpg.chain_index.get(name, -1), name in self._replanner.out
        count = len(tpg.chains[k]) if k >= 0 else 0
        done = min(0 if state is None else state.done, count)
        mode: ShownMode = "silent" if state is None else state.mode
        stands = mode == "standing"
        if name in self._robots.silent:
            mode = "silent"
        elif out and stands:
            mode = "out"
        elif stands and done == count and not self._replanner.planning:
            mode = "finished"
        task = ""
        if done < count and mode != "out":
            task = tpg.tasks[self._cell.task[k][done]].label
        waits = self._waits(k) if mode == "standing" and done < count else ""
        return ShownRobot(name, mode, task, waits, done, count, held, out)

    def _waits(self, chain: int) -> str:
        """Return what a waiting robot waits for, as text."""
        node = self._cell.released[chain]
        if node < self._replanner.limit(chain):
            return self._cell.wait_cause(chain, node)
        if self._question:
            return "waits for an answer"
        return "waits for the new plan" if self._replanner.planning else ""


def _placement(h: NodeHandling) -> Placement:
    return Placement(0, h.object, h.holder, h.pose)


def _done(end_ns: Sequence[int]) -> int:
    """Return the number of complete nodes of a chain from their end times."""
    return next((n for n, t in enumerate(end_ns) if t < 0), len(end_ns))
