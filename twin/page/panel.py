"""State shared by the web page and the run: orders and answers from people, and the progress that the page displays."""

from __future__ import annotations

import queue
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from planning.cell.workcell import Workcell
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.drivers.driver import Mode
from twin.follow.state import FollowedRun
from twin.operations.person import Question, UnansweredError
from twin.runs.trajectory import Placement

Action = Literal["hold", "go on", "out", "yes", "no"]
"""Orders of people: to a robot or all, or as the answer to a question."""

ShownMode = Mode | Literal["silent", "out", "finished"]


@dataclass(frozen=True)
class Order:
    """Order of a person.

    Attributes:
        action: the action.
        robot: of which one, empty for all.
        question: which one is answered, from 1; 0 for none.
    """

    action: Action
    robot: str = ""
    question: int = 0


@dataclass(frozen=True)
class Notice:
    """Notice of an event for people.

    Attributes:
        at_s: time of the run [s].
        robot: robot that the event concerns, empty for the whole cell.
        kind: of the event.
        words: the text.
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
        mode: its current activity.
        task: label of the task that it is at, or comes to next; empty where there is none.
        waits: what it waits for, empty for nothing.
        done, nodes: how many nodes it is through with, of all.
        held: whether it is ordered to stop.
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
    """Displayed state of a run.

    Attributes:
        t_s: how late it is in the run [s].
        robots: all that are driven.
        steps_done, steps: of the assembly.
        given_up: steps that are not done any more, by number, with the reason.
        notices: the last ones, newest first.
        question: that is open, empty for none.
        asked: number of questions so far, the open one included.
        planning: whether replanning is in progress.
        outcome: outcome of the run, empty until its end.
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
    """Executed part of a plan.

    Attributes:
        tpg: the plan.
        now_ns: time of the run [ns].
        start_ns, end_ns: of the nodes of each chain, -1 if not yet [ns].
        disturbed: chains and nodes in which a robot stood, or did something again: how long they took in
            themselves is not known.
    """

    tpg: TemporalPlanGraph
    now_ns: int
    start_ns: tuple[tuple[int, ...], ...]
    end_ns: tuple[tuple[int, ...], ...]
    disturbed: frozenset[tuple[int, int]] = frozenset()

    def followed(self) -> FollowedRun:
        """Return the state for the forecast of a followed run."""
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
    """State shared by a page and a run.

    Attributes:
        steps: of the assembly.
        orders: that have not been obeyed yet.
        shown: displayed state; None before the run has begun.
        shown_s: when that was, by the clock of this machine [s].
        so_far: executed part for the forecast; None likewise.
        answers: given answers not yet used; read by the run only.
        bodies: the executed cell, configurations of robots by name, and placements of objects that have
            changed hands; None before the run has begun.
    """

    steps: int
    orders: queue.SimpleQueue[Order] = field(default_factory=queue.SimpleQueue)
    shown: Shown | None = None
    shown_s: float = 0.0
    so_far: NodesSoFar | None = None
    answers: dict[Question, bool] = field(default_factory=dict)
    bodies: tuple[Workcell, dict[str, Array], dict[str, Placement]] | None = None

    def show(self, shown: Shown) -> None:
        """Update the display; called by the run."""
        self.shown, self.shown_s = shown, time.monotonic()

    def answer(self, question: Question) -> bool:
        """Return the answer to a question; see Person.

        Raises:
            UnansweredError: it is not answered yet.
        """
        if question not in self.answers:
            raise UnansweredError(question)
        return self.answers.pop(question)
