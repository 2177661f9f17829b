"""Simulated robots with acceleration limits, which do not stop between the pieces (nodes) of their planned motion."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace
from typing import Any

import numpy as np
import simpy
from simpy.events import EventPriority

from planning.timing.braking import StoppedPath
from planning.transforms import Array
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution import Execution
from twin.engine.passage import Passage, drive_times
from twin.engine.ports import RobotPort, Steps
from twin.engine.simulated_robots import SimulatedRobots
from twin.runs.events import EventKind
from twin.uncertainty.node_times import NodeTimes, Standstill
from twin.uncertainty.stopped_skills import stopped_skill

_AFTER_MESSAGES = EventPriority(8)
"""Priority of decisions at borders of nodes: messages that arrive at the same time are processed first."""


class DrivenRobots(RobotPort):
    """Robots that move from node to node without stopping.

    At each border a robot enters the next node as fast as it can while still able to stop at the end of
    the last cleared node. Execution is ``lag`` behind the command, so a node is reported complete that
    much later.

    Args:
        execution: the run; see ``with_full_speed_times`` for the durations of its graph.
    """

    driven = True

    def __init__(self, execution: Execution) -> None:
        self._execution = execution
        self.upcoming = execution.next_event_ns
        self._at_rest = SimulatedRobots(execution, self._motion_time)
        self._passages: list[Passage] = []
        self._stood: list[list[Standstill]] = []
        self._stopped: dict[tuple[int, int], StoppedPath | None] = {}
        self.extended()

    def extended(self) -> None:
        """Take over the drive times of the extended graph."""
        tpg, times = self._execution.tpg, self._execution.times
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
        for passage, drive in zip(self._passages, self._drives, strict=False):
            passage.times = drive
        for drive in self._drives[len(self._passages) :]:
            self._passages.append(Passage(drive))
            self._stood.append([])

    def skip(self, chain: int, node: int) -> None:
        """Forget the drawn standstills of a skill that is not attempted."""
        self._given[chain].pop(node, None)

    def node_times(self) -> NodeTimes:
        """Return node durations and standstills, which may be some nodes after braking began."""
        execution = self._execution
        motions, stalls, stands = [], [], []
        for k, own in enumerate(self._given):
            length = self._drives[k].length
            stood = [x for node in own if length[node] <= 0.0 for x in own[node]]
            stood = sorted([*stood, *self._stood[k]], key=lambda item: item.node)
            waited = np.zeros(len(length), dtype=np.int64)
            for item in stood:
                waited[item.node] += item.duration_ns
            start, end = np.array(execution.start[k]), np.array(execution.end[k])
            took = end - start - waited
            if execution.stops is not None:
                # Stops apply to commands, which execution lags behind.
                lag = self._drives[k].lag
                opens = [self.rests_before(k, node) for node in range(len(length))]
                begun = np.where(opens, start, start - lag)
                took -= execution.stops[k].stopped_between(begun, end - lag)
            moved = length > 0.0
            moved[[n for (c, n), x in self._stopped.items() if c == k and x]] = True
            moved &= end >= 0
            motions.append(np.where(moved, took, execution.times.motion[k]))
            stalls.append(waited)
            stands.append(tuple(stood))
        return replace(
            execution.times,
            motion=tuple(motions),
            stood=tuple(stalls),
            standstills=tuple(stands),
        )

    def commands(self) -> tuple[Array, ...]:
        """Return the commands of each robot, see ``ExecutionRecord``."""
        found = []
        for k, passage in enumerate(self._passages):
            rows = np.array(passage.commands, float).reshape(-1, 5)
            if override := self._execution.times.speed_override:
                # Path parameters and speeds assume the planned full speed; stops within skills have none.
                node = rows[:, 1].astype(np.int64)
                moved = self._drives[k].length[node] > 0.0
                rows[moved, 2:] *= override[k][node[moved]][:, None]
            found.append(rows)
        return tuple(found)

    def execute(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a node once it is released; return whether its task failed for good."""
        execution = self._execution
        if self._passages[chain].speed > 0.0:
            if execution.planned is None:
                execution.queue[chain].popleft()
        elif execution.planned is None or self.rests_before(chain, node):
            yield from self._at_rest.until_released(chain, node)
        # An extension of the graph may have replaced this node by one that begins at rest.
        opens = self.rests_before(chain, node)
        if (
            opens
            and node
            and (lag := execution.end[chain][node - 1] - execution.now_ns) > 0
        ):
            yield execution.env.timeout(lag)
        if self._lengths[chain][node] <= 0.0:
            return (yield from self._at_rest.perform(chain, node))
        yield from self._drive(chain, node, opens=opens)
        return False

    def rests_before(self, chain: int, node: int) -> bool:
        """Return whether a robot is at rest before a node, however far it is cleared."""
        last = self._lasts[chain]
        still = self._lengths[chain][node] <= 0.0
        return still or node == 0 or last[node - 1] != last[node]

    def _drive(self, chain: int, node: int, *, opens: bool) -> Steps:
        """Pass a node of a stretch."""
        execution, passage = self._execution, self._passages[chain]
        lag = int(self._drives[chain].lag[node])
        stops = None if execution.stops is None else execution.stops[chain]
        yield execution.end_of_instant(_AFTER_MESSAGES)
        now = execution.now_ns
        if passage.speed <= 0.0:
            passage.rest(now if stops is None else stops.after(now))
        start = execution.start[chain][node] = passage.now_ns + (0 if opens else lag)
        if execution.impatient:
            execution.count_patience(chain, node, start - now)
        self._record(start - now, "started", chain, node)
        given = self._given[chain].get(node, ())
        stood = passage.go(node, self._cleared(chain, node), given, stops)
        self._stood[chain] += [item for _, item in stood]
        for begin, item in stood:
            self._record(begin + lag - now, item, chain, node)
        if (wait := passage.now_ns - now) > 0:
            yield execution.env.timeout(wait)
        execution.complete(chain, node, lag)
        self._record(lag, "completed", chain, node)
        if node == self._lasts[chain][node]:
            passage.speed = 0.0
            if lag:
                yield execution.env.timeout(lag)

    def _motion_time(self, chain: int, node: int, begin_ns: int, offset_ns: int) -> int:
        """Return when a skill's motion has lasted for a duration, braking for stops included [ns]."""
        execution = self._execution
        if execution.stops is None:
            return begin_ns + offset_ns
        if (chain, node) not in self._stopped:
            motion, stops = (
                execution.motion[chain][node],
                execution.stops[chain].stop_after,
            )
            found = stopped_skill(execution.tpg, (chain, node), motion, begin_ns, stops)
            self._stopped[chain, node] = found
            if found is not None:
                self._passages[chain].commands.append(
                    (begin_ns, node, motion, 0.0, 0.0)
                )
        stopped = self._stopped[chain, node]
        if stopped is None:
            return self._at_rest.motion_time(chain, node, begin_ns, offset_ns)
        return round(stopped.stopped_times(offset_ns / NANOSECONDS) * NANOSECONDS)

    def _cleared(self, chain: int, node: int) -> int:
        """Return the last node that a robot is cleared for, by its messages so far."""
        if self._execution.planned is not None:
            return int(self._drives[chain].last[node])
        return node + len(self._execution.queue[chain])

    def _record(
        self, delay_ns: int, what: EventKind | Standstill, chain: int, node: int
    ) -> None:
        """Record an event of a node, or a standstill in it, at its execution time."""
        execution, narrator = self._execution, self._execution.narrator
        if narrator is None:
            return
        if not isinstance(what, Standstill):
            execution.after(delay_ns, narrator.emit, what, chain, node)
            return

        def stands() -> None:
            narrator.stands(chain, node, what)
            over = execution.env.timeout(what.duration_ns)
            over.callbacks.append(
                lambda _: narrator.end_standstill(chain, node, what, 0)
            )

        execution.after(delay_ns, stands)
