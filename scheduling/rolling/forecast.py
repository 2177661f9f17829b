"""Forecast of the completion time of a temporal plan graph during its execution."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph


@dataclass(frozen=True)
class Clock:
    """Execution state of a graph.

    Attributes:
        now_s: how late it is [s].
        begun_s: when the first nodes of each chain began [s].
        ended_s: when the first nodes of each chain ended, those at work left out [s].
    """

    now_s: float
    begun_s: tuple[Array, ...]
    ended_s: tuple[Array, ...]

    def left_s(self, chain: NodeChain, k: int, count: int) -> float:
        """Return the remaining working time of a robot up to a number of its nodes, without waits [s].

        Args:
            chain: of the robot.
            k: its index.
            count: the number of nodes.
        """
        done = len(self.ended_s[k])
        left = float(chain.duration[done:count].sum())
        if done < min(count, len(self.begun_s[k])):
            left -= min(self.now_s - self.begun_s[k][done], chain.duration[done])
        return left


def forecast_s(
    tpg: TemporalPlanGraph,
    counts: Sequence[int],
    clock: Clock | None,
    planning_s: float,
) -> float:
    """Return the completion time of a graph at planned durations from now on [s].

    Args:
        tpg: the graph.
        counts: how many nodes of each chain were there before it was replanned.
        clock: what has been executed of them; None if nothing has.
        planning_s: how long it takes from now on until new nodes may begin [s].
    """
    durations = [chain.duration.copy() for chain in tpg.chains]
    now = 0.0 if clock is None else clock.now_s
    earliest = [np.full(len(chain), now + planning_s) for chain in tpg.chains]
    for own, count in zip(earliest, counts, strict=True):
        own[:count] = now
    if clock is not None:
        for k, (begun, ended) in enumerate(
            zip(clock.begun_s, clock.ended_s, strict=True)
        ):
            begins, ends = begun[: counts[k]], ended[: counts[k]]
            done, own = len(ends), durations[k]
            earliest[k][: len(begins)] = begins
            own[:done] = ends - begins[:done]
            own[done : len(begins)] = np.maximum(
                own[done : len(begins)], now - begins[done:]
            )
    return float(earliest_times(tpg, durations, earliest=earliest).makespan)
