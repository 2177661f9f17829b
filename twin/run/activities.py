"""Activities of robots over time, told by the events of a run: the lanes of charts.

The states that a lane can have come with their colours, the causes of edges in words.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, groupby

from planning.tasks.task import ARRIVE, HOLD, LEAVE, PRESENT, STRAIGHT, TRANSIT
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.run.events import Event

WAITING = "waiting"
HOLDING = "holding"
STALLED = "stalled"
STOPPED = "stopped"
RETRYING = "retrying"
FAILED = "failed"
IDLE = "idle"

LANE_COLOURS: dict[str, str] = {
    TRANSIT: "#97a6ba",
    STRAIGHT: "#7688a2",
    "pick": "#eeaa33",
    "place-down": "#2e8b57",
    "place-up": "#6fbe6e",
    "handover": "#b254a0",
    "support-bottom": "#2f6fb2",
    "support-top": "#69aade",
    HOLD: "#4b8fc8",
    ARRIVE: "#c9b88f",
    PRESENT: "#a5885a",
    LEAVE: "#8f6f9c",
    HOLDING: "#b3d3ee",
    WAITING: "#e2e5e9",
    STALLED: "#ce3630",
    STOPPED: "#78161e",
    RETRYING: "#e87648",
    FAILED: "#1c1c20",
    IDLE: "#f2f3f5",
}
"""Colours of the states of a lane that are there in any run, and of skills, #rrggbb."""

CAUSES = {TASK_DEPENDENCY: "task dependency", MOTION_CONFLICT: "motion conflict"}
"""Causes of type-2 edges in words."""

_OTHER_COLOURS = (
    "#8c7864",
    "#c0648c",
    "#4c8f96",
    "#a08c2e",
    "#7d6fb8",
    "#b5703f",
    "#5f8a5a",
    "#94596a",
)


def lane_colours(kinds: Iterable[str]) -> dict[str, str]:
    """Return the colours of all states of lanes, those of other kinds of tasks in their order."""
    others = dict.fromkeys(kind for kind in kinds if kind not in LANE_COLOURS)
    return {**LANE_COLOURS, **dict(zip(others, cycle(_OTHER_COLOURS), strict=False))}


def plan_colours(tpg: TemporalPlanGraph) -> dict[str, str]:
    """Return the colours of the states of the lanes of a plan."""
    return lane_colours(task.kind for task in tpg.tasks)


STANDING = frozenset({WAITING, HOLDING, STALLED, STOPPED, RETRYING, FAILED})
"""States in which a robot stands. Holding is what it is there for: it supports something, or keeps hold
of what it placed, until others are done."""

_SUPPORTS = ("support-bottom", "support-top", HOLD)
_PLACES = ("place-down", "place-up")

_STANDS = {"stalled": STALLED, "stopped": STOPPED}


@dataclass(frozen=True)
class Activity:
    """A stretch of time of one robot in one state.

    Attributes:
        state: kind of the task, or one of STANDING.
        start_ns, end_ns: when [ns].
        task: the task under way, waited for, or at the end of which it holds something; -1 for a
            robot that will never go on.
        first, last: nodes of the robot that it belongs to, or that are waited for; -1 as above.
    """

    state: str
    start_ns: int
    end_ns: int
    task: int
    first: int
    last: int

    @property
    def duration_ns(self) -> int:
        """Duration of the activity [ns]."""
        return self.end_ns - self.start_ns


def part_names(tpg: TemporalPlanGraph) -> list[str]:
    """Return what each task is about: its part, else that of its step, else the step's number."""
    of_step: dict[int, str] = {}
    for task in tpg.tasks:
        if task.object is not None:
            of_step.setdefault(task.step, task.object)
    return [t.object or of_step.get(t.step, str(t.step)) for t in tpg.tasks]


def robot_activities(
    tpg: TemporalPlanGraph, events: Sequence[Event], *, nodes: bool = False
) -> dict[str, tuple[Activity, ...]]:
    """Return the activities of each robot with work, without gaps, until its last node ends.

    Args:
        tpg: the graph that was executed.
        events: of the run.
        nodes: one entry a node at least; otherwise those of a task that follow each other in the
            same state are one.
    """
    end_ns = events[-1].t_ns if events else 0
    return {
        chain.robot: tuple(
            _joined(_RobotLog(tpg, k).activities(events, end_ns), nodes=nodes)
        )
        for k, chain in enumerate(tpg.chains)
    }


class _RobotLog:
    """Follows one robot through the events."""

    def __init__(self, tpg: TemporalPlanGraph, chain: int) -> None:
        self._tasks = tpg.tasks
        self._chain = tpg.chains[chain]
        self._node = -1
        self._next = 0
        self._failed = False
        self._stands: list[str] = []
        self._clock = 0
        self._out: list[Activity] = []

    def activities(self, events: Iterable[Event], end_ns: int) -> list[Activity]:
        """Return all stretches of the robot, none of them empty."""
        mine = [event for event in events if event.robot == self._chain.robot]
        for event in mine:
            self._take(event)
        if self._next < len(self._chain):
            self._until(end_ns, FAILED if self._failed else self._state())
        return self._out

    def _take(self, event: Event) -> None:
        t = event.t_ns
        if event.kind in ("retried", "failed") and self._node >= 0:
            self._until(t, RETRYING)
            self._mark_failed_attempt()
            self._failed = event.kind == "failed"
            return
        self._until(t, self._state())
        if event.kind == "started":
            self._node = event.node
        elif event.kind == "completed":
            self._node, self._next = -1, event.node + 1
            self._stands.clear()
        elif event.kind in _STANDS:
            self._stands.append(_STANDS[event.kind])
        elif event.kind == "resumed" and self._stands:
            self._stands.pop()

    def _mark_failed_attempt(self) -> None:
        """Tell the motion of the node under way as a failed attempt: motion comes last."""
        for k in range(len(self._out) - 1, -1, -1):
            if self._out[k].first != self._node:
                break
            if self._out[k].state not in STANDING:
                self._out[k] = replace(self._out[k], state=RETRYING)

    def _state(self) -> str:
        if self._stands:
            return self._stands[-1]
        if self._node < 0:
            return HOLDING if self._holds() else WAITING
        return self._tasks[int(self._chain.task[self._node])].kind

    def _holds(self) -> bool:
        """Tell whether the robot stands at the end of a task in which it came to hold something."""
        if not 0 < self._next < len(self._chain):
            return False
        last, now = self._chain.task[self._next - 1 : self._next + 1].tolist()
        done, then = self._tasks[last], self._tasks[now]
        lets_go = then.kind == STRAIGHT and then.object == done.object is not None
        kept = done.kind in _PLACES and lets_go
        return last != now and (kept or done.kind in _SUPPORTS)

    def _until(self, t_ns: int, state: str) -> None:
        if t_ns > self._clock:
            node = self._node if self._node >= 0 else self._next
            node -= state == HOLDING
            there = node < len(self._chain)
            task = int(self._chain.task[node]) if there else -1
            node = node if there else -1
            self._out.append(Activity(state, self._clock, t_ns, task, node, node))
            self._clock = t_ns


def _joined(stretches: Iterable[Activity], *, nodes: bool) -> Iterator[Activity]:
    """Join stretches, each of one node, that follow each other in the same state and task."""

    def alike(item: Activity) -> tuple[str, int, int]:
        return item.state, item.task, item.first if nodes else 0

    for _, group in groupby(stretches, key=alike):
        first, *others = group
        last = others[-1] if others else first
        yield replace(first, end_ns=last.end_ns, last=last.last)
