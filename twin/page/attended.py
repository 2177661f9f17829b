"""What a page and the run share: orders of people one way, what they are shown the other.

The page is served in a thread of its own, which never touches the run: it puts orders into a queue and reads
what was shown last, which never changes once it is shown.

People beside a cell that drivers move: they see how far the run is, give orders and are asked.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

from planning.tasks.task import BROUGHT, LEFT_OUT
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import complete_tasks
from twin.drivers.driver import Mode
from twin.durations.model import NANOSECONDS
from twin.engine.execution import Execution, Ports
from twin.engine.ports import Audience, Steps
from twin.follow.state import FollowedRun
from twin.live.remote_robots import RemoteRobots
from twin.live.session import Session
from twin.operate.person import Question, UnansweredError
from twin.operate.replanner import RollingReplanner
from twin.run.events import Event, Outcome

Action = Literal["hold", "go on", "out", "yes", "no"]
"""What somebody may order: of a robot or all, or as the answer to a question."""

ShownMode = Mode | Literal["silent", "out", "finished"]


@dataclass(frozen=True)
class Order:
    """What somebody has ordered.

    Attributes:
        action: what.
        robot: of which one, empty for all.
        question: which one is answered, from 1; 0 for none.
    """

    action: Action
    robot: str = ""
    question: int = 0


@dataclass(frozen=True)
class Notice:
    """Something that has happened that people should know.

    Attributes:
        at_s: time of the run [s].
        robot: whom it happened to, empty for the whole cell.
        kind: of the event.
        words: what.
    """

    at_s: float
    robot: str
    kind: str
    words: str


@dataclass(frozen=True)
class ShownRobot:
    """A robot as it is shown.

    Attributes:
        name: of it.
        mode: what it does.
        task: label of the task that it is at, or comes to next; empty where there is none.
        waits: what it waits for, empty for nothing.
        done, nodes: how many nodes it is through with, of all.
        held: whether it is told to stand.
        out: whether it is out for good.
    """

    name: str
    mode: ShownMode
    task: str
    waits: str
    done: int
    nodes: int
    held: bool
    out: bool


@dataclass(frozen=True)
class Shown:
    """What people see of a run.

    Attributes:
        t_s: how late it is in the run [s].
        robots: all that are driven.
        steps_done, steps: of the assembly.
        given_up: steps that are not done any more, by number, with the reason.
        notices: the last ones, newest first.
        question: that is open, empty for none.
        asked: how many questions there were, with that one.
        planning: whether something is being planned anew.
        outcome: how the run has ended, empty while it goes on.
    """

    t_s: float
    robots: tuple[ShownRobot, ...]
    steps_done: int
    steps: int
    given_up: Mapping[int, str]
    notices: tuple[Notice, ...]
    question: str = ""
    asked: int = 0
    planning: bool = False
    outcome: str = ""


@dataclass(frozen=True)
class NodesSoFar:
    """What has been executed of a plan.

    Attributes:
        tpg: the plan.
        now_ns: time of the run [ns].
        start_ns, end_ns: of the nodes of each chain, -1 for what has not happened [ns].
        disturbed: chains and nodes in which a robot stood, or did something again: how long they took in
            themselves is not known.
    """

    tpg: TemporalPlanGraph
    now_ns: int
    start_ns: tuple[tuple[int, ...], ...]
    end_ns: tuple[tuple[int, ...], ...]
    disturbed: frozenset[tuple[int, int]] = frozenset()

    def followed(self) -> FollowedRun:
        """Return the run as who follows it knows it."""
        run = FollowedRun(self.tpg)
        run.now_ns = self.now_ns
        for own, start, end in zip(run.robots, self.start_ns, self.end_ns, strict=True):
            own.start_ns[:], own.end_ns[:] = start, end
            own.completed = next((k for k, t in enumerate(end) if t < 0), len(end))
            done = own.end_ns >= 0
            own.took_ns[done] = own.end_ns[done] - own.start_ns[done]
        for k, node in self.disturbed:
            run.robots[k].took_ns[node] = -1
        return run


@dataclass
class Panel:
    """What a page and a run share.

    Attributes:
        steps: of the assembly.
        orders: that have not been obeyed yet.
        shown: what people see; None before the run has begun.
        shown_s: when that was, by the clock of this machine [s].
        so_far: what a forecast needs; None likewise.
        answers: that have been given, and not been asked for since; only the run looks at them.
    """

    steps: int
    orders: queue.SimpleQueue[Order] = field(default_factory=queue.SimpleQueue)
    shown: Shown | None = None
    shown_s: float = 0.0
    so_far: NodesSoFar | None = None
    answers: dict[Question, bool] = field(default_factory=dict)

    def show(self, shown: Shown) -> None:
        """Let people see something; called by the run."""
        self.shown, self.shown_s = shown, time.monotonic()

    def says(self, question: Question) -> bool:
        """Return what somebody has answered; see Person.

        Raises:
            UnansweredError: nobody has.
        """
        if question not in self.answers:
            raise UnansweredError(question)
        return self.answers.pop(question)


_SHOW_S, _PROGRESS_S = 0.25, 2.0
"""Time between what is shown, and between what forecasts are made of [s]."""

_MOST_NOTICES = 60

_QUIET = ("released", "started", "completed", "waiting", "attached", "detached")
"""Events that people are not told of."""


@dataclass(frozen=True)
class AttendedSession(Session):
    """Drivers of the robots of a cell that somebody stands beside, for one run.

    Attributes:
        panel: what is shared with the page.
    """

    panel: Panel = field(kw_only=True)

    def execution(self, *about: Any, **more: Any) -> Ports:
        """Return the ports of the run; see Session."""
        ports = super().execution(*about, **more)
        return replace(ports, audience=partial(Attendance, panel=self.panel))


class Attendance(Audience):
    """People who stand beside a cell that drivers move, by way of a panel.

    While a question is open time passes: what is planned is not settled, and all robots work as far as the
    plan goes that is executed.

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
        """Keep what people are to know."""
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

    def look(self, now_s: float) -> None:
        """Show how far the run is, some times a second, by the clock of the robots [s]."""
        robots = self._robots
        for name, link in robots.nodes.links.items():
            state = robots.nodes.states.get(name)
            stands = link.held and state is not None and state.mode == "held"
            if stands != (name in self._held):
                (self._held.add if stands else self._held.discard)(name)
                robots.now(robots.record_driver, name, "held" if stands else "")
        if now_s >= self._show_s:
            self._show(now_s)

    def _obey(self, order: Order) -> None:
        """Execute an order once it is on the disk."""
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
        """Wait until somebody has answered a question."""
        self._question = question
        self._asked += 1
        assert self._cell.narrator is not None
        self._cell.narrator.emit("asked", detail=question.words)
        yield self._answered

    # What is shown

    def show_planning(self) -> None:
        """Show that a revision of the plan is being made."""
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
            if task.kind not in (LEFT_OUT, BROUGHT):
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
        """Return what a robot that stands waits for, in words."""
        node = self._cell.released[chain]
        if node < self._replanner.limit(chain):
            return self._cell.wait_cause(chain, node)
        if self._question:
            return "waits for an answer"
        return "waits for what is planned anew" if self._replanner.planning else ""


def _done(end_ns: Sequence[int]) -> int:
    """Return how many nodes of a chain are complete, by when each of them was."""
    return next((n for n, t in enumerate(end_ns) if t < 0), len(end_ns))
