"""What a page and the run share: orders of people one way, what they are shown the other.

The page is served in a thread of its own, which never touches the run: it puts orders into a queue and reads
what was shown last, which never changes once it is shown.

Execution by drivers that somebody stands beside: who sees how far it is, gives orders and is asked.
"""

from __future__ import annotations

import queue
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import simpy

from planning.tasks.task import BROUGHT, LEFT_OUT
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import complete_tasks
from twin.drivers.driver import Mode
from twin.durations.model import NANOSECONDS
from twin.follow.state import FollowedRun
from twin.live.live_execution import LiveExecution
from twin.live.session import Session
from twin.operate.committed import Version
from twin.operate.person import Question
from twin.recorders.observers import Observers
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


class UnansweredError(Exception):
    """Nobody has answered a question yet; it is no failure.

    Attributes:
        question: that is open.
    """

    def __init__(self, question: Question) -> None:
        self.question = question
        super().__init__(question.words)


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

    def execution(self, *about: Any, **more: Any) -> Callable[..., LiveExecution]:
        """Return what makes the state of the run; see Session."""
        made = super().execution(*about, **more)
        assert isinstance(made, partial)
        return partial(AttendedExecution, panel=self.panel, **made.keywords)


class AttendedExecution(LiveExecution):
    """State of one run that drivers execute, with somebody beside the cell.

    A question that is open lets time go on: what is planned is not settled, and everybody works on as far as
    the plan goes that is executed.

    Args:
        rest, options: as of an execution by drivers.
        panel: what is shared with the page.
    """

    attended = True

    def __init__(
        self,
        *rest: Any,
        panel: Panel,
        observers: Observers | None = None,
        **options: Any,
    ) -> None:
        self._panel = panel
        self._notices: deque[Notice] = deque(maxlen=_MOST_NOTICES)
        self._question: Question | None = None
        self._asked, self._held = 0, set[str]()
        self._disturbed: set[tuple[int, int]] = set()
        self._show_s = self._progress_s = 0.0
        both = Observers((*([] if observers is None else [observers]), self))
        super().__init__(*rest, observers=both, **options)
        self._answered = self.env.event()

    def execute(self) -> Outcome:
        """Run until everything is done; see LiveExecution."""
        outcome = ""
        try:
            outcome = super().execute()
            return outcome
        finally:
            self._question = None
            self._panel.show(replace(self._shown(), outcome=outcome or "broken off"))

    # Notices: this execution is a recorder of its own events

    def record(self, event: Event) -> None:
        """Keep what people are to know."""
        if event.kind not in _QUIET:
            label = self.tpg.tasks[event.task].label if event.task >= 0 else ""
            new = "" if event.detail.startswith(label) else label
            words = ": ".join(filter(None, (new, event.detail)))
            at_s = event.t_ns / NANOSECONDS
            if event.robot in self.tpg.chain_index:
                k = self.tpg.chain_index[event.robot]
                self._disturbed.add((k, _done(self.end[k])))
            self._notices.appendleft(Notice(at_s, event.robot, event.kind, words))

    def close(self) -> None:
        """Finish; there is nothing to do."""

    # Orders

    def _look_at_links(self, now_s: float) -> None:
        while True:
            try:
                order = self._panel.orders.get_nowait()
            except queue.Empty:
                break
            self._now(self._obey, order)
        super()._look_at_links(now_s)
        for name, link in self._links.items():
            state = self._states.get(name)
            stands = link.held and state is not None and state.mode == "held"
            if stands != (name in self._held):
                (self._held.add if stands else self._held.discard)(name)
                self._now(self._tell_of_driver, name, "held" if stands else "")
        if now_s >= self._show_s:
            self._show(now_s)

    def _obey(self, order: Order) -> None:
        """Do what somebody has ordered, once that is on the disk."""
        question = self._question
        if order.action in ("yes", "no"):
            if question is None or order.question != self._asked:
                return
            self._log_order(f"{order.action}: {question}")
            self._question = None
            self._panel.answers[question] = order.action == "yes"
            answered, self._answered = self._answered, self.env.event()
            answered.succeed()
        elif order.action == "out":
            if order.robot not in self._links or order.robot in self._out:
                return
            self._log_order("out", order.robot)
            self.outage(order.robot, self.now_ns)
        else:
            held = order.action == "hold"
            names = [order.robot] if order.robot else list(self._links)
            changed = [n for n in names if n in self._links]
            if not any(self._links[n].held != held for n in changed):
                return
            self._log_order(order.action, order.robot)
            for name in changed:
                self._links[name].hold(held)

    def _log_order(self, words: str, robot: str = "") -> None:
        chain = self.tpg.chain_index.get(robot, -1)
        if robot and chain < 0:
            words = f"{words}: {robot}"
        assert self.narrator is not None
        self.narrator.emit("ordered", chain, detail=words)
        self._written()

    # Questions

    def _version(self) -> Generator[simpy.Event, Any, Version]:
        """Plan what is left; as often as somebody has to be asked for that, once it is answered."""
        while True:
            self._show(self._wall_s())
            try:
                return (yield from super()._version())
            except UnansweredError as error:
                self._question = error.question
            self._asked += 1
            assert self.narrator is not None
            self.narrator.emit("asked", detail=self._question.words)
            yield self._answered
            self._again = False

    # What is shown

    def _show(self, now_s: float) -> None:
        self._show_s = now_s + _SHOW_S
        self._panel.show(self._shown())
        if now_s >= self._progress_s:
            self._progress_s = now_s + _PROGRESS_S
            start, end = map(tuple, self.start), map(tuple, self.end)
            marked = [(k, n) for k, n in self._disturbed if n < len(self.end[k])]
            self._panel.so_far = NodesSoFar(
                self.tpg, self._passed_ns(), tuple(start), tuple(end), frozenset(marked)
            )

    def _shown(self) -> Shown:
        return Shown(
            self._passed_ns() / NANOSECONDS,
            tuple(self._shown_robot(name) for name in self._links),
            self._steps_done(),
            self._panel.steps,
            dict(self._planner.given_up),
            tuple(self._notices),
            "" if self._question is None else self._question.words,
            self._asked,
            self._planning,
        )

    def _steps_done(self) -> int:
        complete = complete_tasks(self.tpg, [_done(own) for own in self.end])
        steps: dict[int, bool] = {}
        for task in self.tpg.tasks:
            if task.kind not in (LEFT_OUT, BROUGHT):
                before = steps.get(task.step, True)
                steps[task.step] = before and task.index in complete
        return sum(steps.values()) - sum(
            steps.get(k, False) for k in self._planner.given_up
        )

    def _shown_robot(self, name: str) -> ShownRobot:
        state, held = self._states.get(name), self._links[name].held
        k, out = self.tpg.chain_index.get(name, -1), name in self._out
        nodes = len(self.tpg.chains[k]) if k >= 0 else 0
        done = min(0 if state is None else state.done, nodes)
        mode: ShownMode = "silent" if state is None else state.mode
        stands = mode == "standing"
        if name in self._silent:
            mode = "silent"
        elif out and stands:
            mode = "out"
        elif stands and done == nodes and not self._planning:
            mode = "finished"
        task = ""
        if done < nodes and mode != "out":
            task = self.tpg.tasks[self.task[k][done]].label
        waits = self._waits(k) if mode == "standing" and done < nodes else ""
        return ShownRobot(name, mode, task, waits, done, nodes, held, out)

    def _waits(self, chain: int) -> str:
        """Return what a robot that stands waits for, in words."""
        node = self.released[chain]
        if node < self._limit[chain]:
            return self._cause(chain, node)
        if self._question:
            return "waits for an answer"
        return "waits for what is planned anew" if self._planning else ""


def _done(end_ns: Sequence[int]) -> int:
    """Return how many nodes of a chain are complete, by when each of them was."""
    return next((n for n, t in enumerate(end_ns) if t < 0), len(end_ns))
