"""Activities of robots over time, derived from the events of a run, as charts show them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING

from planning.tasks.task import Actuation, TaskKind
from scheduling.graph.actuations import chain_actuations
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.activities.progress import STALLED, STOPPED, RobotProgress
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.events import Event

if TYPE_CHECKING:
    import pyarrow as pa

WAITING = "waiting"
HOLDING = "holding"
RETRYING = "retrying"
FAILED = "failed"
IDLE = "idle"

CAUSES = {TASK_DEPENDENCY: "task dependency", MOTION_CONFLICT: "motion conflict"}
"""Causes of type-2 edges in words."""

SAME_ROBOT = "same robot"
"""Cause of type-1 edges."""

STANDING = frozenset({WAITING, HOLDING, STALLED, STOPPED, RETRYING, FAILED})
"""States in which a robot stands. Holding is work: the robot supports an object, or holds its placed part, until others are done."""

TOLD = STANDING | {Actuation.CLOSE, Actuation.OPEN}
"""States reported in addition to their task."""

_SUPPORTS = ("support-bottom", "support-top", TaskKind.HOLD)
_PLACES = ("place-down", "place-up")


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


def activities_table(tpg: TemporalPlanGraph, events: Sequence[Event]) -> pa.Table:
    """Return a table of the activities of all robots: robot, state, start_s, end_s, task."""
    import pyarrow as pa

    entries = robot_activities(tpg, events)
    rows = [(robot, item) for robot, lane in entries.items() for item in lane]
    return pa.table(
        {
            "robot": pa.array([robot for robot, _ in rows], pa.string()),
            "state": pa.array([item.state for _, item in rows], pa.string()),
            "start_s": pa.array([i.start_ns / NANOSECONDS for _, i in rows]),
            "end_s": pa.array([i.end_ns / NANOSECONDS for _, i in rows]),
            "task": pa.array([item.task for _, item in rows], pa.int64()),
        }
    )


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
        lets_go = (
            then.kind == TaskKind.STRAIGHT and then.object == before.object is not None
        )
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
