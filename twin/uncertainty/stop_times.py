"""Stops of robots at given times of a run, whatever the robots do then: emergency stops and breakdowns.

Stops do not depend on the events of a run, so they are given as time intervals. If a stop begins within a node, the
robot stands still and afterwards continues from the same point. An event of the robot that is due exactly when a stop
begins occurs when the stop ends.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import (
    NANOSECONDS,
    Nanoseconds,
    require_within_longest_run,
    to_nanoseconds,
)
from twin.uncertainty.disturbances import Breakdowns, Disturbances
from twin.uncertainty.draws import uniforms

NEVER = 2**62
"""A time that no run comes to [ns]."""

_CHUNK = 16
"""Breakdowns drawn together."""


@dataclass(frozen=True)
class Stop:
    """An interval in which a robot stands, whatever its task.

    Attributes:
        start_ns, end_ns: interval [ns]; at its end the robot continues.
        reason: reason, for people.
    """

    start_ns: int
    end_ns: int
    reason: str


class StoppedClock:
    """Converts between the run's time and a robot's own time, which halts during stops.

    Args:
        intervals: start and end of every stop, in order and without overlaps [ns].
    """

    def __init__(self, intervals: Sequence[tuple[int, int]]) -> None:
        pairs = np.array(intervals, dtype=np.int64).reshape(-1, 2)
        self._starts = pairs[:, 0]
        self._stopped = np.concatenate([[0], np.cumsum(pairs[:, 1] - pairs[:, 0])])
        self.stops_at: Nanoseconds = self._starts - self._stopped[:-1]
        """Own time at every stop, shape (stops,) [ns]."""

    def own(self, t_ns: Nanoseconds) -> Nanoseconds:
        """Return the robot's own time at times of the run [ns]."""
        before = np.searchsorted(self._starts, t_ns, side="right")
        own = t_ns - self._stopped[before]
        # Within a stop, own time is what it was when the stop began.
        floor = np.concatenate([[np.iinfo(np.int64).min], self.stops_at])[before]
        return np.asarray(np.maximum(own, floor), dtype=np.int64)

    def real(self, own_ns: Nanoseconds) -> Nanoseconds:
        """Return the run's time at own times; the end of a stop that begins then [ns]."""
        passed = np.searchsorted(self.stops_at, own_ns, side="right")
        return np.asarray(own_ns + self._stopped[passed], dtype=np.int64)


class Stops:
    """All stops of one robot, in order of time.

    Args:
        stops: at fixed times.
        breakdowns: by the clock, drawn as far as needed.
        name: seed, replication and robot, which name the draws.
    """

    def __init__(
        self,
        stops: list[Stop],
        breakdowns: Breakdowns | None = None,
        *,
        name: tuple[int, int, str] = (0, 0, ""),
    ) -> None:
        self._stops = sorted(stops, key=lambda stop: stop.start_ns)
        self._breakdowns = breakdowns
        self._name = name
        self._drawn = 0
        # Breakdowns that begin before the horizon are known.
        self._horizon = NEVER if breakdowns is None else 0
        self._merge()

    def after(self, t_ns: int) -> int:
        """Return the earliest time from ``t_ns`` on at which the robot is not stopped."""
        self._extend(t_ns)
        k = bisect_right(self._starts, t_ns) - 1
        return max(t_ns, self._ends[k]) if k >= 0 else t_ns

    def advance(self, t_ns: int, busy_ns: int) -> int:
        """Return the end of work that begins at a time.

        Args:
            t_ns: when it begins; the robot is not stopped then.
            busy_ns: how long it takes without stops.
        """
        while True:
            self._extend(t_ns + busy_ns)
            k = bisect_right(self._starts, t_ns)
            if k == len(self._starts) or t_ns + busy_ns < self._starts[k]:
                return t_ns + busy_ns
            busy_ns -= self._starts[k] - t_ns
            t_ns = self._ends[k]

    def expand(self, t_ns: Nanoseconds, busy_ns: Nanoseconds) -> Nanoseconds:
        """Return the ends of several pieces of work, see advance; all shapes are the same."""
        if len(t_ns) == 0:
            return t_ns
        while True:
            pace = StoppedClock(list(zip(self._starts, self._ends, strict=True)))
            out = pace.real(pace.own(t_ns) + busy_ns)
            if int(out.max()) < self._horizon:
                return out
            self._extend(int(out.max()))

    def until(self, until_ns: int) -> list[Stop]:
        """Return every stop that begins at a time or before; they may overlap."""
        self._extend(until_ns)
        return [stop for stop in self._stops if stop.start_ns <= until_ns]

    def next_edge(self, t_ns: int) -> int:
        """Return the next begin or end of a stop after a time, NEVER without one."""
        self._extend(t_ns + 1)
        k = bisect_right(self._edges, t_ns)
        if k == len(self._edges) and self._breakdowns is not None:
            self._extend(self._horizon)
            k = bisect_right(self._edges, t_ns)
        return self._edges[k] if k < len(self._edges) else NEVER

    def stop_after(self, t_ns: int) -> tuple[int, int]:
        """Return begin and end of the first stop that is not over at a time, NEVER without one."""
        self._extend(t_ns)
        k = bisect_right(self._ends, t_ns)
        if k == len(self._ends) and self._breakdowns is not None:
            self._extend(self._horizon)
            k = bisect_right(self._ends, t_ns)
        if k == len(self._ends):
            return NEVER, NEVER
        return self._starts[k], self._ends[k]

    def intervals(self, until_ns: int) -> tuple[tuple[int, int], ...]:
        """Return the intervals of stops before a time: start and end, without overlaps."""
        self._extend(until_ns)
        return tuple(
            (start, min(end, until_ns))
            for start, end in zip(self._starts, self._ends, strict=True)
            if start < until_ns
        )

    def stopped_between(self, start_ns: int, end_ns: int) -> int:
        """Return the total stop time between two times [ns]."""
        return sum(
            max(0, min(b, end_ns) - max(a, start_ns)) for a, b in self.intervals(end_ns)
        )

    def _extend(self, t_ns: int) -> None:
        """Draw breakdowns until all up to a time are known."""
        if t_ns < self._horizon or self._breakdowns is None:
            return
        require_within_longest_run(t_ns)
        while self._horizon <= t_ns:
            self._draw(self._breakdowns)
        self._stops.sort(key=lambda stop: stop.start_ns)
        self._merge()

    def _draw(self, breakdowns: Breakdowns) -> None:
        """Draw the next breakdowns."""
        seed, replication, robot = self._name
        names = (seed, [replication], [robot] * _CHUNK, -1, [""] * _CHUNK)
        index = np.arange(self._drawn, self._drawn + _CHUNK)
        gap = uniforms(*names, "breakdown-gap", index)[:, 0]
        repair = uniforms(*names, "breakdown-duration", index)[:, 0]
        up = to_nanoseconds(-breakdowns.mtbf_s * np.log(gap)).tolist()
        down = to_nanoseconds(-breakdowns.mttr_s * np.log(repair)).tolist()
        for works, stands in zip(up, down, strict=True):
            start = self._horizon + works
            self._horizon = start + stands
            reason = f"breakdown, repaired after {stands / NANOSECONDS:.3f} s"
            self._stops.append(Stop(start, self._horizon, reason))
        self._drawn += _CHUNK

    def _merge(self) -> None:
        """Merge overlapping or adjacent stops into intervals, without those of zero length."""
        lasting = [stop for stop in self._stops if stop.end_ns > stop.start_ns]
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._edges = sorted({t for s in lasting for t in (s.start_ns, s.end_ns)})
        for stop in lasting:
            if self._ends and stop.start_ns <= self._ends[-1]:
                self._ends[-1] = max(self._ends[-1], stop.end_ns)
            else:
                self._starts.append(stop.start_ns)
                self._ends.append(stop.end_ns)


def draw_stops(
    tpg: TemporalPlanGraph,
    disturbances: Disturbances,
    *,
    seed: int,
    replication: int = 0,
) -> tuple[Stops, ...] | None:
    """Return the stops of all robots and machines with tasks; None without any.

    Machines break down; emergency stops are of robots.
    """
    if not disturbances.at_absolute_times:
        return None
    found = []
    machines = tpg.machine_chains()
    for k, chain in enumerate(tpg.chains):
        fixed = []
        own = disturbances
        if k in machines:
            own = disturbances.of_machine(chain.robot)
        for stop in own.emergency_stops:
            if stop.robot in (None, chain.robot):
                start, length = to_nanoseconds([stop.at_s, stop.duration_s]).tolist()
                reason = f"emergency stop for {stop.duration_s:.3f} s"
                fixed.append(Stop(start, start + length, reason))
        breaks = own.breakdowns
        by_clock = breaks if breaks and breaks.affects(chain.robot, "run") else None
        name = (seed, replication, chain.robot)
        found.append(Stops(fixed, by_clock, name=name))
    return tuple(found)
