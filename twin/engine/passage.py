"""Motion of one robot through consecutive nodes (pieces of its path) within acceleration limits, without stops.

The speed at the end of each node depends on how many later nodes are released by then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from planning.timing.stretch import brake_within_piece, exit_bound, passage_seconds
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.uncertainty.node_times import Standstill
from twin.uncertainty.stop_times import Stops

_ROUNDING_NS = 1.0
"""Drawn durations are whole nanoseconds; this near to full speed is full speed."""


class DriveTimes(NamedTuple):
    """Drive times of one or more chains in nanoseconds, with the speeds of one replication.

    Attributes:
        length: time of each node at full speed; 0 outside stretches [ns].
        top: greatest speed in each node, at most 1.
        ramp: time from rest to full speed [ns].
        lag: delay of the execution behind the command [ns].
        last: last node of each node's stretch.
    """

    length: Array
    top: Array
    ramp: Array
    lag: Nanoseconds
    last: Nanoseconds


def drive_times(
    chain: NodeChain, motion: Nanoseconds, override: Array | float = 1.0
) -> DriveTimes:
    """Return the drive times of a chain in nanoseconds.

    A speed override f replaces time t of the planned motion by t / f: speed, acceleration and jerk are
    f, f^2 and f^3 times those of the plan.

    Args:
        chain: its nodes.
        motion: durations that were drawn of them, at full speed, shape (nodes,) [ns].
        override: share of planned speed at which they are executed, shape (nodes,).
    """
    drive = chain.drive
    count = len(chain)
    if drive is None:
        none = np.zeros(count)
        whole = np.zeros(count, dtype=np.int64)
        return DriveTimes(none, np.ones(count), none, whole, np.arange(count))
    ramp = drive.ramp * NANOSECONDS / override
    length = np.where(ramp > 0.0, drive.cruise * NANOSECONDS / override, 0.0)
    lag = np.ceil(np.ceil(drive.lag * NANOSECONDS) / override).astype(np.int64)
    slower = motion > length + _ROUNDING_NS
    top = np.where(slower, length / np.maximum(motion, 1), 1.0)
    ends = np.flatnonzero(drive.rests)
    last = ends[np.searchsorted(ends, np.arange(count))] if count else ends
    return DriveTimes(length, top, ramp, lag, last)


@dataclass
class Passage:
    """Commanded motion of a robot along its chain.

    Attributes:
        times: of its chain.
        speed: at the border it is at, 0 at rest.
        base_ns: a whole time from which ``passed`` counts [ns].
        passed: commanded time since then [ns].
        pending: standstills that it has begun to brake for.
        commands: its commands so far, see ``ExecutionRecord``.
    """

    times: DriveTimes
    speed: float = 0.0
    base_ns: int = 0
    passed: float = 0.0
    pending: list[Standstill] = field(default_factory=list)
    commands: list[tuple[float, int, float, float, float]] = field(default_factory=list)

    @property
    def now_ns(self) -> int:
        """Commanded time [ns]."""
        return self.base_ns + round(self.passed)

    def rest(self, now_ns: int) -> None:
        """Begin from rest."""
        self.base_ns, self.passed, self.speed = now_ns, 0.0, 0.0

    def go(
        self,
        node: int,
        last: int,
        standstills: Sequence[Standstill] = (),
        stops: Stops | None = None,
    ) -> list[tuple[int, Standstill]]:
        """Pass a node up to its end.

        Args:
            node: the node that begins.
            last: the last node that the robot is cleared for.
            standstills: that begin with it.
            stops: stops by the clock.

        Returns:
            Standstills within the node, and when each begins [ns].
        """
        times = self.times
        length, ramp = float(times.length[node]), float(times.ramp[node])
        top = float(times.top[node])
        end = min(last, int(times.last[node]))
        bound = exit_bound(times.length, times.top, node, end, times.ramp)
        self.pending += standstills
        gone = 0.0
        stood: list[tuple[int, Standstill]] = []
        while True:
            held = stops is not None and stops.after(self.now_ns) > self.now_ns
            if self.pending or held:
                took, leave, way = brake_within_piece(length - gone, self.speed, ramp)
                if took > 0.0:
                    begin = self.base_ns + self.passed
                    known = (begin, node, gone, self.speed, -1.0 / ramp)
                    self.commands.append(known)
                self.passed += took
                self.speed = leave
                gone += way
                if self.speed > 0.0:
                    return stood
                stood += self._stand(node, gone, stops)
            # Where it came to rest at the border, rounding may say that it went beyond.
            left = max(length - gone, 0.0)
            took, leave, peak = passage_seconds(left, top, self.speed, bound, ramp)
            if stops is not None:
                stop = stops.next_edge(self.now_ns)
                if self.base_ns + self.passed + took > stop:
                    gone = self._until(
                        stop, node, gone, (length - gone, leave, peak, ramp)
                    )
                    continue
            self._follow(node, gone, took, (leave, peak, ramp, length - gone))
            return stood

    def _follow(
        self, node: int, gone: float, took: float, shape: tuple[float, ...]
    ) -> None:
        """Pass the rest of a node at the computed speeds."""
        leave, peak, ramp, left = shape
        speeding, slowing = (peak - self.speed) * ramp, (peak - leave) * ramp
        covered = 0.5 * speeding * (peak + self.speed)
        begin = self.base_ns + self.passed
        tell = self.commands.append
        if speeding > 0.0:
            tell((begin, node, gone, self.speed, 1.0 / ramp))
        if (steady := took - speeding - slowing) > 0.0:
            tell((begin + speeding, node, gone + covered, peak, 0.0))
        if slowing > 0.0:
            before = gone + left - 0.5 * slowing * (peak + leave)
            tell((begin + speeding + max(steady, 0.0), node, before, peak, -1.0 / ramp))
        self.passed += took
        self.speed = leave
        if leave <= 0.0:
            tell((self.base_ns + self.passed, node, gone + left, 0.0, 0.0))

    def _stand(
        self, node: int, gone: float, stops: Stops | None
    ) -> list[tuple[int, Standstill]]:
        """Stand for all pending standstills and stops."""
        now = self.now_ns
        self.commands.append((float(now), node, gone, 0.0, 0.0))
        stood = []
        for item in self.pending:
            stood.append((now, Standstill(node, item.cause, item.duration_ns)))
            if stops is None:
                now += item.duration_ns
            else:
                now = stops.advance(stops.after(now), item.duration_ns)
        self.pending.clear()
        self.rest(now if stops is None else stops.after(now))
        return stood

    def _until(
        self, stop: int, node: int, gone: float, shape: tuple[float, ...]
    ) -> float:
        """Follow the rest of a node until a stop; return the progress."""
        left, leave, peak, ramp = shape
        time = stop - (self.base_ns + self.passed)
        speeding, slowing = (peak - self.speed) * ramp, (peak - leave) * ramp
        covered = 0.5 * speeding * (peak + self.speed)
        steady = max(0.0, left - covered - 0.5 * slowing * (peak + leave)) / peak
        tell, begin, entry = (
            self.commands.append,
            self.base_ns + self.passed,
            self.speed,
        )
        tell((begin, node, gone, entry, 1.0 / ramp if speeding > 0.0 else 0.0))
        if time <= speeding:
            gone += entry * time + 0.5 * time * time / ramp
            self.speed = entry + time / ramp
        else:
            tell((begin + speeding, node, gone + covered, peak, 0.0))
            braking_for = max(0.0, time - speeding - steady)
            at = min(time - speeding, steady)
            if braking_for > 0.0:
                done = gone + covered + peak * steady
                tell((begin + speeding + steady, node, done, peak, -1.0 / ramp))
            gone += covered + peak * at
            gone += peak * braking_for - 0.5 * braking_for * braking_for / ramp
            self.speed = max(0.0, peak - braking_for / ramp)
        self.base_ns, self.passed = stop, 0.0
        return gone
