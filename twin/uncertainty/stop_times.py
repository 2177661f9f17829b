"""Stops of robots and machines at given times of a run, whatever they do: emergency stops, breakdowns, shifts.

Stops do not depend on the events of a run, so they are given as time intervals. If a stop begins within a node, the
robot stands still and afterwards continues from the same point. An event of the robot that is due exactly when a stop
begins occurs when the stop ends.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from typing import Protocol

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.nanoseconds import (
    Nanoseconds,
    require_within_longest_run,
    to_nanoseconds,
)
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.repair_crew import CrewSource, RepairCrew
from twin.uncertainty.stop import STOP_CODES, Stop, StopCode
from twin.uncertainty.working_hours import WEEK_S

NEVER = 2**62
"""A time that no run comes to [ns]."""

_CHUNK = 16
"""Periods computed together."""


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


class StopSource(Protocol):
    """Source of an unlimited number of stops.

    Attributes:
        horizon: time before which all of its stops are known [ns].
    """

    @property
    def horizon(self) -> int:
        """See the class."""
        ...

    def more(self) -> list[Stop]:
        """Return further stops; the horizon moves on."""
        ...


class PeriodicSource:
    """Stops that are repeated for ever.

    Args:
        intervals: starts and ends within the first period [s].
        period: time after which they are repeated [s].
        why: code and reason of each stop.
        before: also that of the period before, as far as it lasts into the run.
    """

    def __init__(
        self,
        intervals: Sequence[tuple[float, float]],
        period: float,
        why: tuple[StopCode, str],
        *,
        before: bool = False,
    ) -> None:
        self._intervals = to_nanoseconds(np.array(intervals)).tolist()
        self._period = int(to_nanoseconds([period])[0])
        self._why = why
        self._next = -1 if before else 0
        self.horizon = 0

    def more(self) -> list[Stop]:
        """Return the stops of the next periods."""
        found = []
        for k in range(self._next, self._next + _CHUNK):
            offset = k * self._period
            for start, end in self._intervals:
                if end + offset > 0:
                    begin = max(0, start + offset)
                    found.append(Stop(begin, end + offset, *self._why))
        self._next += _CHUNK
        self.horizon = self._next * self._period
        return found


class Stops:
    """All stops of one robot, in order of time.

    Args:
        stops: at fixed times.
        sources: sources of further ones, extended as far as needed.
    """

    def __init__(self, stops: list[Stop], sources: Sequence[StopSource] = ()) -> None:
        self._stops = sorted(stops, key=lambda stop: stop.start_ns)
        self._sources = tuple(sources)
        self._merge()

    @property
    def _horizon(self) -> int:
        """Time before which all stops are known [ns]."""
        return min((source.horizon for source in self._sources), default=NEVER)

    def after(self, t_ns: int) -> int:
        """Return the earliest time from ``t_ns`` on at which the robot is not stopped."""
        while True:
            self._extend(t_ns)
            k = bisect_right(self._starts, t_ns) - 1
            if k < 0 or self._ends[k] <= t_ns:
                return t_ns
            # Stops that are not known yet may prolong this one.
            t_ns = self._ends[k]

    def advance(self, t_ns: int, busy_ns: int) -> int:
        """Return the end of work that begins at a time.

        Args:
            t_ns: when it begins; the robot is not stopped then.
            busy_ns: how long it takes without stops.
        """
        while True:
            self._extend(t_ns + busy_ns)
            # What became known may have prolonged the stop that ended then.
            t_ns = self.after(t_ns)
            k = bisect_right(self._starts, t_ns)
            if k == len(self._starts) or t_ns + busy_ns < self._starts[k]:
                return t_ns + busy_ns
            busy_ns -= self._starts[k] - t_ns
            t_ns = self.after(self._starts[k])

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
        while True:
            k = bisect_right(self._edges, t_ns)
            edge = self._edges[k] if k < len(self._edges) else NEVER
            if self._is_known(edge):
                return edge
            self._extend(self._horizon)

    def stop_after(self, t_ns: int) -> tuple[int, int]:
        """Return begin and end of the first stop that is not over at a time, NEVER without one."""
        self._extend(t_ns)
        while True:
            k = bisect_right(self._ends, t_ns)
            if k < len(self._ends):
                found = self._starts[k], self._ends[k]
            else:
                found = NEVER, NEVER
            if self._is_known(found[1]):
                return found
            self._extend(self._horizon)

    def _is_known(self, t_ns: int) -> bool:
        """Tell whether all stops up to a time are known."""
        return not self._sources or t_ns < self._horizon

    def intervals(self, until_ns: int) -> tuple[tuple[int, int], ...]:
        """Return the intervals of stops before a time: start and end, without overlaps."""
        self._extend(until_ns)
        return tuple(
            (start, min(end, until_ns))
            for start, end in zip(self._starts, self._ends, strict=True)
            if start < until_ns
        )

    def stopped_between(
        self, start_ns: Nanoseconds | int, end_ns: Nanoseconds | int
    ) -> Nanoseconds:
        """Return the total stop time between two times, or between any number of two [ns]."""
        start, end = np.asarray(start_ns), np.asarray(end_ns)
        self._extend(int(end.max(initial=0)))
        pace = StoppedClock(list(zip(self._starts, self._ends, strict=True)))
        worked = pace.own(end) - pace.own(start)
        return np.asarray(np.maximum(end - start - worked, 0))

    def times_by_code(self, until_ns: int) -> dict[StopCode, int]:
        """Return the stop time before a time by code, of overlapping stops by the first one in STOP_CODES [ns]."""
        known = self.until(until_ns)
        covered = [
            Stops([s for s in known if s.code in STOP_CODES[:count]])
            for count in range(len(STOP_CODES) + 1)
        ]
        totals = [own.stopped_between(0, until_ns) for own in covered]
        return dict(zip(STOP_CODES, np.diff(totals).tolist(), strict=True))

    def _extend(self, t_ns: int) -> None:
        """Get stops of the sources until all up to a time are known."""
        if t_ns < self._horizon:
            return
        require_within_longest_run(t_ns)
        for source in self._sources:
            while source.horizon <= t_ns:
                self._stops += source.more()
        self._stops.sort(key=lambda stop: stop.start_ns)
        self._merge()

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
    why: tuple[StopCode, str]
    machines = tpg.machine_chains()
    by_chain = [
        disturbances.of_machine(chain.robot) if k in machines else disturbances
        for k, chain in enumerate(tpg.chains)
    ]
    breaking = {
        chain.robot: own.breakdowns
        for chain, own in zip(tpg.chains, by_chain, strict=True)
        if own.breakdowns and own.breakdowns.affects(chain.robot, "run")
    }
    people = disturbances.repair_people or len(breaking)
    crew = RepairCrew(people, breaking, seed, replication) if breaking else None
    for chain, own in zip(tpg.chains, by_chain, strict=True):
        fixed = []
        for stop in own.emergency_stops:
            if stop.robot in (None, chain.robot):
                start, length = to_nanoseconds([stop.at_s, stop.duration_s]).tolist()
                reason = f"emergency stop for {stop.duration_s:.3f} s"
                fixed.append(Stop(start, start + length, "emergency", reason))
        name = chain.robot
        sources: list[StopSource] = []
        if crew is not None and name in breaking:
            sources.append(CrewSource(crew, name))
        for planned in disturbances.planned_stops:
            if planned.affects(name):
                why = "planned", f"planned stop for {planned.duration_s:.3f} s"
                interval = planned.at_s, planned.at_s + planned.duration_s
                if planned.every_s is not None:
                    sources.append(PeriodicSource([interval], planned.every_s, why))
                else:
                    start, end = to_nanoseconds(interval).tolist()
                    fixed.append(Stop(start, end, *why))
        if disturbances.calendar is not None:
            off = disturbances.calendar.off_shift(name)
            if off:
                why = "off-shift", "off shift"
                sources.append(PeriodicSource(off, WEEK_S, why, before=True))
        found.append(Stops(fixed, sources))
    return tuple(found)
