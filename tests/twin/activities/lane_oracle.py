"""What each robot was doing when, worked out from the times of a run, not from its events."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.activities import FAILED, IDLE, RETRYING, WAITING
from twin.activities.progress import STALLED, STOPPED
from twin.runs.execution_record import ExecutionRecord


@dataclass(frozen=True)
class Span:
    """A stretch of time in one state.

    Attributes:
        state: kind of the task, WAITING, STALLED, STOPPED, RETRYING, FAILED or IDLE.
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


def robot_lanes(tpg: TemporalPlanGraph, run: ExecutionRecord) -> tuple[Lane, ...]:
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


_STANDS = {"stall": STALLED, "breakdown": STOPPED, "retry": RETRYING}


def _spans(tpg: TemporalPlanGraph, run: ExecutionRecord, k: int) -> list[Span]:
    chain, pace = tpg.chains[k], run.pace(k)
    start, stall, end = run.start_ns[k], run.stood_ns[k], run.end_ns[k]
    reasons: dict[int, list[tuple[str, int]]] = {}
    for entry in run.standstills[k]:
        reason = (_STANDS[entry.cause], entry.duration_ns)
        reasons.setdefault(entry.node, []).append(reason)
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
        own = pace.own(start[node : node + 1])
        for state, stands in reasons.get(node, [(STALLED, int(stall[node]))]):
            own = own + stands
            extend(state, min(int(pace.real(own)[0]), done), task)
        failed = node == run.failed_nodes[k]
        extend(FAILED if failed else tpg.tasks[task].kind, done, task)
    over = len(end) == 0 or end[-1] >= 0
    extend(IDLE if over else WAITING, run.makespan_ns, -1)
    return _stopped(spans, run.stops_ns[k])


def _stopped(spans: list[Span], stops: Sequence[tuple[int, int]]) -> list[Span]:
    """Return spans in which a robot at work shows as stopped while the clock stops it."""
    for low, high in stops:
        cut: list[Span] = []
        for span in spans:
            start, end = max(span.start_ns, low), min(span.end_ns, high)
            if start >= end or span.state in (IDLE, FAILED):
                cut.append(span)
                continue
            if span.start_ns < start:
                cut.append(replace(span, end_ns=start))
            cut.append(Span(STOPPED, start, end, span.task))
            if end < span.end_ns:
                cut.append(replace(span, start_ns=end))
        spans = cut
    return spans
