"""Execution of a plan by robots that speed up and slow down within their limits."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import simpy
from simpy.events import EventPriority

from planning.timing.braking import StoppedPath
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations.model import NANOSECONDS
from twin.engine.passage import Passage, drive_times
from twin.engine.processes import Execution, Steps
from twin.run.events import EventKind
from twin.uncertainty.node_times import NodeTimes, Standstill
from twin.uncertainty.stops import stopped_skill

_AFTER_MESSAGES = EventPriority(8)
"""Priority of decisions at borders: what arrives at the same time counts."""


class DrivenExecution(Execution):
    """State of one run in progress, in which robots pass borders of nodes at speed.

    At each border a robot takes the next node as fast as it can while it is still able to stop at
    the end of the last node that it is cleared for. What is executed is ``lag`` behind what is
    commanded, so a node counts as left, and is reported complete, that much later.
    """

    driven = True

    def __init__(
        self, tpg: TemporalPlanGraph, times: NodeTimes, *rest: Any, **options: Any
    ) -> None:
        """Set the cell up at time 0; see Execution, and ``at_full_speed`` for the durations."""
        super().__init__(tpg, times, *rest, **options)
        self._take_drives(tpg, times)
        self._passages = [Passage(drive) for drive in self._drives]
        self._stood: list[list[Standstill]] = [[] for _ in tpg.chains]
        self._stopped: dict[tuple[int, int], StoppedPath | None] = {}

    def _take_drives(self, tpg: TemporalPlanGraph, times: NodeTimes) -> None:
        overrides = map(times.override, range(len(tpg.chains)))
        self._drives = list(map(drive_times, tpg.chains, times.motion, overrides))
        self._lengths = [drive.length.tolist() for drive in self._drives]
        self._lasts = [drive.last.tolist() for drive in self._drives]
        self._given: list[dict[int, list[Standstill]]] = []
        for own in times.standstills:
            by_node: dict[int, list[Standstill]] = {}
            for item in own:
                by_node.setdefault(item.node, []).append(item)
            self._given.append(by_node)

    def node_times(self) -> NodeTimes:
        """Return how long nodes took, and where robots stood: some nodes after they began to brake."""
        motions, stalls, stands = [], [], []
        for k, own in enumerate(self._given):
            length = self._drives[k].length
            stood = [x for node in own if length[node] <= 0.0 for x in own[node]]
            stood = sorted([*stood, *self._stood[k]], key=lambda item: item.node)
            waited = np.zeros(len(length), dtype=np.int64)
            for item in stood:
                waited[item.node] += item.duration_ns
            start, end = np.array(self.start[k]), np.array(self.end[k])
            took = end - start - waited
            if self.stops is not None:
                # Stops are commands, which what is executed is behind.
                lag = self._drives[k].lag
                opens = [self._opens(k, node) for node in range(len(length))]
                told = np.where(opens, start, start - lag), end - lag
                spans = zip(*(times.tolist() for times in told), strict=True)
                took -= [self.stops[k].stopped_between(a, b) for a, b in spans]
            moved = length > 0.0
            moved[[n for (c, n), x in self._stopped.items() if c == k and x]] = True
            moved &= end >= 0
            motions.append(np.where(moved, took, self.times.motion[k]))
            stalls.append(waited)
            stands.append(tuple(stood))
        return replace(
            self.times,
            motion=tuple(motions),
            stood=tuple(stalls),
            standstills=tuple(stands),
        )

    def commands(self) -> tuple[Array, ...]:
        """Return what each robot was told, see ``ExecutionRecord``."""
        found = []
        for k, passage in enumerate(self._passages):
            rows = np.array(passage.commands, float).reshape(-1, 5)
            if self.times.speed_override:
                # Ways and speeds count from full speed as planned; stops of skills have no speed.
                node = rows[:, 1].astype(np.int64)
                moved = self._drives[k].length[node] > 0.0
                rows[moved, 2:] *= self.times.speed_override[k][node[moved]][:, None]
            found.append(rows)
        return tuple(found)

    def _pass(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        if self._passages[chain].speed > 0.0:
            if self.planned is None:
                self.queue[chain].popleft()
        elif self.planned is None or self._opens(chain, node):
            yield from self._until_released(chain, node)
        # A graph that has been extended meanwhile may have another node there, after a rest.
        opens = self._opens(chain, node)
        if opens and node and (lag := self.end[chain][node - 1] - self.now_ns) > 0:
            yield self.env.timeout(lag)
        if self._lengths[chain][node] <= 0.0:
            return (yield from self._fails(chain, node))
        yield from self._drive(chain, node, opens=opens)
        return False

    def _opens(self, chain: int, node: int) -> bool:
        """Tell whether a robot is at rest before a node, whatever it is cleared for."""
        last = self._lasts[chain]
        still = self._lengths[chain][node] <= 0.0
        return still or node == 0 or last[node - 1] != last[node]

    def _drive(self, chain: int, node: int, *, opens: bool) -> Steps:
        """Pass a node of a stretch, which opens with it or goes on."""
        env, passage = self.env, self._passages[chain]
        lag = int(self._drives[chain].lag[node])
        stops = None if self.stops is None else self.stops[chain]
        yield self._at_the_end_of_now(_AFTER_MESSAGES)
        if passage.speed <= 0.0:
            passage.rest(self.now_ns if stops is None else stops.after(self.now_ns))
        late = 0 if opens else lag
        self.start[chain][node] = passage.now_ns + late
        self._count_patience(chain, node, late + passage.now_ns - self.now_ns)
        self._tell(late + passage.now_ns - self.now_ns, "started", chain, node)
        given = self._given[chain].get(node, ())
        stood = passage.go(node, self._cleared(chain, node), given, stops)
        self._stood[chain] += [item for _, item in stood]
        for begin, item in stood:
            self._tell(begin + lag - self.now_ns, item, chain, node)
        if (wait := passage.now_ns - self.now_ns) > 0:
            yield env.timeout(wait)
        self._complete(chain, node, lag)
        self._tell(lag, "completed", chain, node)
        if node == self._lasts[chain][node]:
            passage.speed = 0.0
            if lag:
                yield env.timeout(lag)

    def _moved(self, chain: int, node: int, begin_ns: int, offset_ns: int) -> int:
        """Return when the motion of a skill has gone on for a while: it brakes for stops."""
        if self.stops is None:
            return super()._moved(chain, node, begin_ns, offset_ns)
        if (chain, node) not in self._stopped:
            motion, stops = self.motion[chain][node], self.stops[chain].stop_after
            found = stopped_skill(self.tpg, (chain, node), motion, begin_ns, stops)
            self._stopped[chain, node] = found
            if found is not None:
                self._passages[chain].commands.append(
                    (begin_ns, node, motion, 0.0, 0.0)
                )
        stopped = self._stopped[chain, node]
        if stopped is None:
            return super()._moved(chain, node, begin_ns, offset_ns)
        return round(stopped.when(offset_ns / NANOSECONDS) * NANOSECONDS)

    def _cleared(self, chain: int, node: int) -> int:
        """Return the last node that a robot may enter as far as it knows."""
        if self.planned is not None:
            return int(self._drives[chain].last[node])
        return node + len(self.queue[chain])

    def _tell(
        self, delay_ns: int, what: EventKind | Standstill, chain: int, node: int
    ) -> None:
        """Tell of an event of a node, or of a standstill in it, when it is executed."""
        narrator = self.narrator
        if narrator is None:
            return
        if not isinstance(what, Standstill):
            self._after(delay_ns, narrator.emit, what, chain, node)
            return

        def stands() -> None:
            narrator.stands(chain, node, what)
            over = self.env.timeout(what.duration_ns)
            over.callbacks.append(lambda _: narrator.goes_on(chain, node, what, 0))

        self._after(delay_ns, stands)
