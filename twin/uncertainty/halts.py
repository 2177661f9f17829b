"""Stops at times of the run's clock: emergency stops, and breakdowns by the clock.

When a robot stops does not depend on what happens in the run, so its stops are known as
intervals. A robot that is stopped stands wherever it is, also in the middle of a node, and goes
on where it stopped. At the instant a stop begins nothing else happens to the robot any more.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.uncertainty.disturbances import Breakdowns, Disturbances
from twin.uncertainty.draws import uniforms
from twin.uncertainty.pace import Pace

_NEVER = 2**62
_CHUNK = 16


@dataclass(frozen=True)
class Stop:
    """A robot stops, whatever it does.

    Attributes:
        start_ns, end_ns: when [ns]; at the end it goes on.
        reason: why, for people.
    """

    start_ns: int
    end_ns: int
    reason: str


class Halts:
    """All stops of one robot, in order of time."""

    def __init__(
        self,
        stops: list[Stop],
        breakdowns: Breakdowns | None = None,
        *,
        robot: str = "",
        seed: int = 0,
        replication: int = 0,
    ) -> None:
        """Keep stops at fixed times, and draw breakdowns by the clock as far as needed."""
        self._fixed = sorted(stops, key=lambda stop: stop.start_ns)
        self._breakdowns = breakdowns
        self._name = (seed, replication, robot)
        self._broken: list[Stop] = []
        self._horizon = _NEVER if breakdowns is None else 0
        self._merge()

    def after(self, t_ns: int) -> int:
        """Return the earliest time from ``t_ns`` on at which the robot is not stopped."""
        self._extend(t_ns)
        k = bisect_right(self._starts, t_ns) - 1
        return max(t_ns, self._ends[k]) if k >= 0 else t_ns

    def advance(self, t_ns: int, busy_ns: int) -> int:
        """Return when work that begins at a time is done.

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
        """Return advance for several pieces of work at once; all shapes are the same."""
        if len(t_ns) == 0:
            return t_ns
        while True:
            pace = Pace(list(zip(self._starts, self._ends, strict=True)))
            out = pace.real(pace.own(t_ns) + busy_ns)
            if int(out.max()) < self._horizon:
                return out
            self._extend(int(out.max()))

    def stops(self, until_ns: int) -> list[Stop]:
        """Return every stop that begins at a time or before; they may overlap."""
        self._extend(until_ns)
        found = [s for s in self._fixed + self._broken if s.start_ns <= until_ns]
        return sorted(found, key=lambda stop: stop.start_ns)

    def next_edge(self, t_ns: int) -> int:
        """Return when a stop next begins or ends after a time; never is far away."""
        self._extend(t_ns + 1)
        k = bisect_right(self._edges, t_ns)
        if k == len(self._edges) and self._breakdowns is not None:
            self._extend(self._horizon)
            k = bisect_right(self._edges, t_ns)
        return self._edges[k] if k < len(self._edges) else _NEVER

    def intervals(self, until_ns: int) -> tuple[tuple[int, int], ...]:
        """Return when the robot was stopped before a time: start and end, without overlaps."""
        self._extend(until_ns)
        return tuple(
            (start, min(end, until_ns))
            for start, end in zip(self._starts, self._ends, strict=True)
            if start < until_ns
        )

    def _extend(self, t_ns: int) -> None:
        """Draw breakdowns until all up to a time are known."""
        if t_ns < self._horizon or self._breakdowns is None:
            return
        seed, replication, robot = self._name
        while self._horizon <= t_ns:
            first = len(self._broken)
            index = np.arange(first, first + _CHUNK)
            names = (seed, [replication], [robot] * _CHUNK, -1, [""] * _CHUNK)
            gap = uniforms(*names, "breakdown-gap", index)[:, 0]
            repair = uniforms(*names, "breakdown-duration", index)[:, 0]
            up = to_nanoseconds(-self._breakdowns.mtbf_s * np.log(gap)).tolist()
            down = to_nanoseconds(-self._breakdowns.mttr_s * np.log(repair)).tolist()
            clock = self._broken[-1].end_ns if self._broken else 0
            for works, stands in zip(up, down, strict=True):
                start, clock = clock + works, clock + works + stands
                reason = f"breakdown, repaired after {stands / NANOSECONDS:.3f} s"
                self._broken.append(Stop(start, clock, reason))
            self._horizon = clock
        self._merge()

    def _merge(self) -> None:
        """Join stops that overlap or touch into intervals; those of no length do not count."""
        self._starts: list[int] = []
        self._ends: list[int] = []
        self._edges = sorted(
            {
                t
                for s in self._fixed + self._broken
                for t in (s.start_ns, s.end_ns)
                if s.end_ns > s.start_ns
            }
        )
        for stop in sorted(self._fixed + self._broken, key=lambda s: s.start_ns):
            if stop.end_ns == stop.start_ns:
                continue
            if self._ends and stop.start_ns <= self._ends[-1]:
                self._ends[-1] = max(self._ends[-1], stop.end_ns)
            else:
                self._starts.append(stop.start_ns)
                self._ends.append(stop.end_ns)


def sample_halts(
    tpg: TemporalPlanGraph,
    disturbances: Disturbances | None,
    *,
    seed: int,
    replication: int = 0,
) -> tuple[Halts, ...] | None:
    """Return the stops of every robot that has work, None when nobody can ever stop."""
    if disturbances is None or not disturbances.at_absolute_times:
        return None
    found = []
    for chain in tpg.chains:
        stops = []
        for stop in disturbances.emergency_stops:
            if stop.robot in (None, chain.robot):
                start = int(to_nanoseconds(stop.at_s))
                end = start + int(to_nanoseconds(stop.duration_s))
                reason = f"emergency stop for {stop.duration_s:.3f} s"
                stops.append(Stop(start, end, reason))
        breaks = disturbances.breakdowns
        by_clock = breaks and breaks.affects(chain.robot, "run")
        found.append(
            Halts(
                stops,
                breaks if by_clock else None,
                robot=chain.robot,
                seed=seed,
                replication=replication,
            )
        )
    return tuple(found)
