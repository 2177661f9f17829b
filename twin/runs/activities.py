"""Progress and activities of robots, derived from the events of a run; activities are lanes of charts.

Lane states have colours, causes of edges have texts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, groupby

import numpy as np

from planning.tasks.task import (
    ARRIVE,
    BROUGHT,
    CLOSE,
    HOLD,
    LEAVE,
    OPEN,
    PRESENT,
    STRAIGHT,
    TRANSIT,
)
from scheduling.graph.actuations import chain_actuations
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.durations.nanoseconds import Nanoseconds
from twin.runs.events import Event

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
    CLOSE: "#c27c0e",
    OPEN: "#c9b458",
    ARRIVE: "#c9b88f",
    PRESENT: "#a5885a",
    BROUGHT: "#b89a3c",
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

SAME_ROBOT = "same robot"
"""Cause of type-1 edges."""

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

STANDING = frozenset({WAITING, HOLDING, STALLED, STOPPED, RETRYING, FAILED})
"""States in which a robot stands. Holding is work: the robot supports an object, or holds its placed part, until others are done."""

TOLD = STANDING | {CLOSE, OPEN}
"""States reported in addition to their task."""

_SUPPORTS = ("support-bottom", "support-top", HOLD)
_PLACES = ("place-down", "place-up")


def lane_colours(kinds: Iterable[str]) -> dict[str, str]:
    """Return the colours of all states of lanes, those of other kinds of tasks in their order."""
    others = dict.fromkeys(kind for kind in kinds if kind not in LANE_COLOURS)
    return {**LANE_COLOURS, **dict(zip(others, cycle(_OTHER_COLOURS), strict=False))}


def plan_colours(tpg: TemporalPlanGraph) -> dict[str, str]:
    """Return the colours of the states that occur in a plan's lanes."""
    return lane_colours(task.kind for task in tpg.tasks)


@dataclass(frozen=True)
class Activity:
    """A time interval of one robot in one state.

    Attributes:
        state: kind of the task, ``"close"`` or ``"open"`` while a tool does that in it, or one of STANDING.
        start_ns, end_ns: when [ns].
        task: the task under way, waited for, or at the end of which it holds something; -1 for a
            robot that will never continue.
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
    """Return the part of each task, else that of its step, else the step's number.

    A part whose name is a bare number is named with its type.
    """
    of_step: dict[int, str] = {}
    for task in tpg.tasks:
        if task.object is not None:
            of_step.setdefault(task.step, task.object)
    numbers = {o.name: o.kind for o in tpg.cell.objects if o.name.isdecimal()}
    for name, kind in numbers.items():
        numbers[name] = f"{'part' if kind in ('', name) else kind} {name}"
    names = (t.object or of_step.get(t.step, f"step {t.step}") for t in tpg.tasks)
    return [numbers.get(name, name) for name in names]


def robot_activities(
    tpg: TemporalPlanGraph, events: Sequence[Event], *, nodes: bool = False
) -> dict[str, tuple[Activity, ...]]:
    """Return the activities of each robot that has tasks, without gaps, until its last node ends.

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


class RobotProgress:
    """Progress of a robot, updated event by event.

    Attributes:
        name: of the robot.
        start_ns, end_ns: of its nodes, -1 if not yet, shape (nodes,) [ns].
        stood_ns: standstills within each node so far, failed attempts left out, shape (nodes,) [ns].
        took_ns: of nodes that are complete, without standstills and attempts that failed, -1 for what
            has not happened or is not known, shape (nodes,) [ns].
        completed: nodes that it has completed.
        attempt_ns: when the node under way started, or its last attempt [ns].
        attempts: attempts at the node under way that have failed.
        failed: whether its task has failed for good.
    """

    def __init__(self, name: str, nodes: int) -> None:
        """Begin before the first node."""
        self.name = name
        self.start_ns: Nanoseconds = np.full(nodes, -1, dtype=np.int64)
        self.end_ns: Nanoseconds = np.full(nodes, -1, dtype=np.int64)
        self.stood_ns: Nanoseconds = np.zeros(nodes, dtype=np.int64)
        self.took_ns: Nanoseconds = np.full(nodes, -1, dtype=np.int64)
        self.completed = self.attempt_ns = self.attempts = 0
        self.failed = False
        self._stands: list[tuple[str, int, int]] = []

    def continued(self, nodes: int) -> RobotProgress:
        """Return the progress in an extended plan with the given number of nodes of the robot."""
        other = RobotProgress(self.name, nodes)
        kept = slice(min(self.completed + (self.under_way >= 0), nodes))
        other.start_ns[kept], other.end_ns[kept] = (
            self.start_ns[kept],
            self.end_ns[kept],
        )
        other.stood_ns[kept], other.took_ns[kept] = (
            self.stood_ns[kept],
            self.took_ns[kept],
        )
        other.completed = min(self.completed, nodes)
        other.attempt_ns, other.attempts = self.attempt_ns, self.attempts
        other.failed, other._stands = self.failed, self._stands
        return other

    @property
    def standing(self) -> str:
        """STALLED or STOPPED while it is, else empty; what began last, where one is within the other."""
        return self._stands[-1][0] if self._stands else ""

    @property
    def standing_in_node(self) -> str:
        """As standing, but empty once the node in which that began is complete: braking goes beyond it."""
        here = self._stands and self._stands[-1][2] == self.completed
        return self.standing if here else ""

    @property
    def since_ns(self) -> int:
        """Time since which it stands [ns]."""
        return self._stands[0][1] if self._stands else 0

    @property
    def under_way(self) -> int:
        """The current node, started and not complete; -1 for none."""
        node = self.completed
        begun = node < len(self.start_ns) and self.start_ns[node] >= 0
        return node if begun else -1

    @property
    def finished(self) -> bool:
        """True once all its nodes are complete."""
        return self.completed == len(self.start_ns)

    def worked_ns(self, now_ns: int) -> int:
        """Return the working time on the current node, without standstills [ns].

        Attempts that failed do not count.
        """
        node = self.under_way
        if node < 0:
            return 0
        begun = max(int(self.start_ns[node]), self.attempt_ns)
        stood = int(self.stood_ns[node])
        if self.standing:
            stood += max(now_ns - max(self.since_ns, begun), 0)
        return max(now_ns - begun - stood, 0)

    def take(self, event: Event) -> None:
        """Update the progress with an event."""
        node, t_ns = event.node, event.t_ns
        if event.kind == "started":
            self.start_ns[node] = self.attempt_ns = t_ns
            self.attempts = 0
        elif event.kind == "completed":
            if self.under_way == node:
                self.took_ns[node] = self.worked_ns(t_ns)
            # A skipped node counts as done immediately, as in a repeated run.
            left = slice(self.completed, node + 1)
            self.start_ns[left] = np.where(
                self.start_ns[left] < 0, t_ns, self.start_ns[left]
            )
            self.end_ns[left] = t_ns
            self.completed = max(self.completed, node + 1)
        elif event.kind in (STALLED, STOPPED):
            self._stands.append((event.kind, t_ns, self.completed))
        elif event.kind == "resumed" and self._stands:
            since_ns = max(self.since_ns, self.attempt_ns)
            self._stands.pop()
            if not self._stands and self.under_way >= 0:
                self.stood_ns[self.under_way] += max(t_ns - since_ns, 0)
        elif event.kind == "retried":
            # Work and standstills of the current node are counted from zero.
            self.attempts += 1
            self.attempt_ns = t_ns
            if self.under_way >= 0:
                self.stood_ns[self.under_way] = 0
        elif event.kind == "failed":
            self.failed = True
        elif event.kind == "recovered":
            # It has been attempted, and the plan continues from there.
            self.failed = False
            self.end_ns[node] = t_ns
            self.completed = max(self.completed, node + 1)


class _RobotLog:
    """Activities of one robot, built from its events."""

    def __init__(self, tpg: TemporalPlanGraph, chain: int) -> None:
        self._tasks = tpg.tasks
        self._chain = tpg.chains[chain]
        self._acts = chain_actuations(tpg, chain)
        self._now = RobotProgress(self._chain.robot, len(self._chain))
        self._clock = 0
        self._out: list[Activity] = []

    def activities(self, events: Iterable[Event], end_ns: int) -> list[Activity]:
        """Return all activities of the robot, none of them empty."""
        for event in events:
            if event.robot != self._chain.robot:
                continue
            if event.kind in ("retried", "failed") and self._now.under_way >= 0:
                self._until(event.t_ns, RETRYING)
                self._mark_failed_attempt()
            else:
                self._until(event.t_ns, self._state())
            self._now.take(event)
        if not self._now.finished:
            self._until(end_ns, FAILED if self._now.failed else self._state())
        return self._out

    def _mark_failed_attempt(self) -> None:
        """Mark the motion of the current node as a failed attempt: motion comes last."""
        for k in range(len(self._out) - 1, -1, -1):
            if self._out[k].first != self._now.under_way:
                break
            if self._out[k].state not in STANDING:
                self._out[k] = replace(self._out[k], state=RETRYING)

    def _state(self) -> str:
        if self._now.standing_in_node:
            return self._now.standing_in_node
        if self._now.under_way < 0:
            return HOLDING if self._holds() else WAITING
        node = self._now.under_way
        if node in self._acts:
            return self._acts[node].act
        return self._tasks[int(self._chain.task[node])].kind

    def _holds(self) -> bool:
        """Return whether the robot stands at the end of a task in which it grasped an object."""
        done = self._now.completed
        if not 0 < done < len(self._chain):
            return False
        last, now = self._chain.task[done - 1 : done + 1].tolist()
        before, then = self._tasks[last], self._tasks[now]
        lets_go = then.kind == STRAIGHT and then.object == before.object is not None
        kept = before.kind in _PLACES and lets_go
        return last != now and (kept or before.kind in _SUPPORTS)

    def _until(self, t_ns: int, state: str) -> None:
        if t_ns > self._clock:
            node = self._now.completed - (state == HOLDING)
            there = node < len(self._chain)
            task = int(self._chain.task[node]) if there else -1
            node = node if there else -1
            self._out.append(Activity(state, self._clock, t_ns, task, node, node))
            self._clock = t_ns


def _joined(stretches: Iterable[Activity], *, nodes: bool) -> Iterator[Activity]:
    """Merge consecutive activities of the same state and task."""

    def alike(item: Activity) -> tuple[str, int, int]:
        return item.state, item.task, item.first if nodes else 0

    for _, group in groupby(stretches, key=alike):
        first, *others = group
        last = others[-1] if others else first
        yield replace(first, end_ns=last.end_ns, last=last.last)
