"""What follows from node times alone: busy times, failures, and runs by the planned clock."""

from __future__ import annotations

import numpy as np

from scheduling.graph.rollout import durations_ns, earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import Nanoseconds
from twin.uncertainty.node_times import NodeTimes

_Times = tuple[Nanoseconds, ...]


def planned_starts(tpg: TemporalPlanGraph) -> _Times:
    """Return the planned clock: when every node starts if all take their planned time [ns].

    Nodes wait for what the graph says, in the plan. In execution, nobody waits for anybody.
    """
    return tuple(earliest_times(tpg, durations_ns(tpg)).start)


def open_loop_times(planned: _Times, times: NodeTimes) -> tuple[_Times, _Times]:
    """Return start and end of every node when every robot follows the planned clock [ns].

    A node starts at its planned start, or when the robot is done with the one before.
    """
    starts, ends = [], []
    for clock, busy in zip(planned, busy_times(times), strict=True):
        before = np.cumsum(busy) - busy
        start = before + np.maximum.accumulate(clock - before)
        starts.append(start)
        ends.append(start + busy)
    cut_failed(times, tuple(starts), tuple(ends))
    return tuple(starts), tuple(ends)


def busy_times(times: NodeTimes) -> _Times:
    """Return stall and motion of every node together; what has failed does not move."""
    busy = []
    for motion, stall, failed in zip(
        times.motion, times.stall, times.failed, strict=True
    ):
        total = motion + stall
        if failed >= 0:
            total[failed] = stall[failed]
            total[failed + 1 :] = 0
        busy.append(total)
    return tuple(busy)


def cut_failed(times: NodeTimes, start: _Times, end: _Times) -> None:
    """Take back what comes after a task that failed for good."""
    for node, begun, done in zip(times.failed, start, end, strict=True):
        if node >= 0:
            begun[node + 1 :] = -1
            done[node:] = -1
