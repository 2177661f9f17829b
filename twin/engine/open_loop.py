"""Open-loop execution: every robot follows the planned clock, and nobody waits for anybody."""

from __future__ import annotations

import numpy as np

from scheduling.graph.rollout import durations_ns, earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import Nanoseconds
from twin.uncertainty.node_times import NodeTimes


def planned_starts(tpg: TemporalPlanGraph) -> tuple[Nanoseconds, ...]:
    """Return the planned clock: when every node starts if all take their planned time [ns].

    Nodes wait for what the graph says, in the plan. In execution, nobody waits for anybody.
    """
    return tuple(earliest_times(tpg, durations_ns(tpg)).start)


def open_loop_starts(
    planned: tuple[Nanoseconds, ...], times: NodeTimes
) -> tuple[Nanoseconds, ...]:
    """Return the start of every node when every robot follows the planned clock [ns].

    A node starts at its planned start, or when the robot is done with the one before.
    """
    starts = []
    for clock, busy in zip(planned, times.busy, strict=True):
        before = np.cumsum(busy) - busy
        starts.append(before + np.maximum.accumulate(clock - before))
    return tuple(starts)
