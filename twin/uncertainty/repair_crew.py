"""Breakdowns of robots and machines by the clock of the run, and the people who repair them.

Failures and repairs do not depend on what is executed, so all of them are simulated beforehand, as a queue: repairs begin
in the order of the failures, as soon as one of the people is free.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping

from twin.durations.nanoseconds import NANOSECONDS
from twin.uncertainty.breakdown_draws import breakdown_times
from twin.uncertainty.disturbances import MachineBreakdowns
from twin.uncertainty.stop import Stop

_CHUNK = 16
"""Failures simulated together."""


class RepairCrew:
    """Breakdowns of several robots and machines that share repair people.

    Args:
        people: number of repair people.
        breakdowns: of each robot and machine, by its name.
        seed, replication: name the draws.

    Attributes:
        horizon: time before which all failures are known [ns].
        stops: breakdowns of each robot and machine so far, in order.
    """

    def __init__(
        self,
        people: int,
        breakdowns: Mapping[str, MachineBreakdowns],
        seed: int,
        replication: int,
    ) -> None:
        self.stops: dict[str, list[Stop]] = {name: [] for name in breakdowns}
        self._draws: dict[str, Iterator[tuple[int, int]]] = {
            name: breakdown_times(own, (seed, replication, name))
            for name, own in breakdowns.items()
        }
        self._free = [0] * people
        self._failures: list[tuple[int, str, int]] = []
        for name in breakdowns:
            self._plan_failure(name, 0)
        self.horizon = self._failures[0][0]

    def advance(self) -> None:
        """Simulate the next failures and their repairs."""
        for _ in range(_CHUNK):
            failed, name, repair = heapq.heappop(self._failures)
            begin = max(failed, heapq.heappop(self._free))
            end = begin + repair
            heapq.heappush(self._free, end)
            waited = (begin - failed) / NANOSECONDS
            queued = f", after {waited:.3f} s of waiting" if begin > failed else ""
            reason = f"breakdown, repaired after {repair / NANOSECONDS:.3f} s{queued}"
            self.stops[name].append(Stop(failed, end, "breakdown", reason))
            self._plan_failure(name, end)
        self.horizon = self._failures[0][0]

    def _plan_failure(self, name: str, after: int) -> None:
        works, repair = next(self._draws[name])
        heapq.heappush(self._failures, (after + works, name, repair))


class CrewSource:
    """Breakdowns of one robot or machine of a crew; a ``StopSource``."""

    def __init__(self, crew: RepairCrew, name: str) -> None:
        self._crew, self._name = crew, name
        self._given = 0

    @property
    def horizon(self) -> int:
        """Time before which all stops that were returned are all there are [ns]."""
        known = self._crew.stops[self._name]
        return (
            known[self._given].start_ns
            if self._given < len(known)
            else self._crew.horizon
        )

    def more(self) -> list[Stop]:
        """Return further stops."""
        known = self._crew.stops[self._name]
        if self._given == len(known):
            self._crew.advance()
        found = known[self._given :]
        self._given = len(known)
        return found
