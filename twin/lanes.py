"""What each robot was doing when: the lanes of Gantt charts and recordings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.task_graph import TRANSIT
from scheduling.temporal_plan_graph import TemporalPlanGraph
from twin.run import Run

WAITING = "waiting"
STALLED = "stalled"
IDLE = "idle"

LANE_COLOURS: dict[str, tuple[int, int, int]] = {
    TRANSIT: (151, 166, 186),
    "pick": (238, 170, 51),
    "place-down": (46, 139, 87),
    "place-up": (111, 190, 110),
    "handover": (178, 84, 160),
    "support-bottom": (47, 111, 178),
    "support-top": (105, 170, 222),
    WAITING: (226, 229, 233),
    STALLED: (206, 54, 48),
    IDLE: (242, 243, 245),
}
"""Colour (r, g, b), 0 to 255, of every state of a lane."""

OTHER_COLOUR = (140, 120, 100)
"""Colour of a task kind without one of its own."""


@dataclass(frozen=True)
class Span:
    """A stretch of time in one state.

    Attributes:
        state: kind of the task, WAITING, STALLED or IDLE.
        start_ns, end_ns: when [ns].
        task: the task that is under way, or that is waited to go on with; -1 when idle.
    """

    state: str
    start_ns: int
    end_ns: int
    task: int


@dataclass(frozen=True)
class Lane:
    """All spans of a robot from 0 to the makespan, without gaps."""

    robot: str
    spans: tuple[Span, ...]


def robot_lanes(tpg: TemporalPlanGraph, run: Run) -> tuple[Lane, ...]:
    """Return the lane of every robot of the cell, in the cell's order."""
    chains = {chain.robot: k for k, chain in enumerate(tpg.chains)}
    return tuple(
        Lane(
            robot.name,
            tuple(_spans(tpg, run, chains[robot.name]))
            if robot.name in chains
            else (Span(IDLE, 0, run.makespan_ns, -1),),
        )
        for robot in tpg.cell.robots
    )


def _spans(tpg: TemporalPlanGraph, run: Run, k: int) -> list[Span]:
    chain = tpg.chains[k]
    start, stall, end = run.start_ns[k], run.stall_ns[k], run.end_ns[k]
    spans: list[Span] = []
    clock = 0

    def extend(state: str, until: int, task: int) -> None:
        nonlocal clock
        if until <= clock:
            return
        last = spans[-1] if spans else None
        if last is not None and (last.state, last.task) == (state, task):
            spans[-1] = Span(state, last.start_ns, until, task)
        else:
            spans.append(Span(state, clock, until, task))
        clock = until

    for node in np.flatnonzero(start >= 0).tolist():
        task = int(chain.task[node])
        done = int(end[node]) if end[node] >= 0 else run.makespan_ns
        extend(WAITING, int(start[node]), task)
        extend(STALLED, min(int(start[node] + stall[node]), done), task)
        extend(tpg.tasks[task].kind, done, task)
    over = len(end) == 0 or end[-1] >= 0
    extend(IDLE if over else WAITING, run.makespan_ns, -1)
    return spans
