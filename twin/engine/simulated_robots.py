"""Simulated robots that start and end every piece (node) of their planned motion at rest."""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any

import simpy
from simpy.events import EventPriority

from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution import Execution
from twin.engine.narrator import Narrator, describe_failure
from twin.engine.ports import RobotPort, Steps
from twin.uncertainty.node_times import NodeTimes

_LAST = EventPriority(9)
"""Priority of what happens after everything else at the same time."""

MotionTime = Callable[[int, int, int, int], int]
"""Returns when a motion has lasted for some time, see ``SimulatedRobots.motion_time``."""


class SimulatedRobots(RobotPort):
    """Robots that execute each node from rest to rest, in a randomly drawn duration.

    Args:
        execution: the run.
        motion_time: progress of motions, where robots brake for stops by the clock.
    """

    driven = False

    def __init__(
        self, execution: Execution, motion_time: MotionTime | None = None
    ) -> None:
        self._execution = execution
        self.upcoming = execution.next_event_ns
        self._motion_time = motion_time or self.motion_time

    def node_times(self) -> NodeTimes:
        """Return node durations and standstills."""
        return self._execution.times

    def execute(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a node once it is released; return whether its task failed for good."""
        queue = self._execution.queue[chain]
        if queue and self._execution.planned is None:
            queue.popleft()
        else:
            yield from self.until_released(chain, node)
        return (yield from self.perform(chain, node))

    def until_released(self, chain: int, node: int) -> Steps:
        """Wait until a node is released, or for its planned start."""
        execution = self._execution
        queue = execution.queue[chain]
        if execution.planned is not None:
            yield from self._until_planned(chain, node)
            return
        # What has arrived may be withdrawn at the same time.
        while not queue:
            arrival = execution.idle[chain] = execution.env.event()
            if execution.narrator is not None:
                check = execution.end_of_instant(_LAST)
                check.callbacks.append(lambda _: execution.report_wait(chain, node))
            yield arrival
        queue.popleft()

    def _until_planned(self, chain: int, node: int) -> Steps:
        """Wait until the planned start of a node, without regard to other robots."""
        execution = self._execution
        assert execution.planned is not None
        early = execution.planned[chain][node] - execution.now_ns
        if early > 0:
            if execution.narrator is not None:
                at = f"{execution.planned[chain][node] / NANOSECONDS:.3f} s"
                detail = f"waits for its planned start at {at}"
                execution.narrator.emit("waiting", chain, node, detail=detail)
            yield execution.env.timeout(early)

    def perform(self, chain: int, node: int) -> Generator[simpy.Event, Any, bool]:
        """Execute a released node and report it; return whether its task failed for good."""
        execution = self._execution
        if execution.stops is not None:
            now = execution.now_ns
            if (stop := execution.stops[chain].after(now) - now) > 0:
                yield execution.env.timeout(stop)
        if execution.supply is not None and execution.supply.miss(chain, node):
            return True
        failed = node == execution.times.failed[chain]
        now = execution.start[chain][node] = execution.now_ns
        if execution.impatient:
            execution.count_patience(chain, node)
        if execution.narrator is not None:
            yield from self._execute_watched(execution.narrator, chain, node)
        elif execution.stops is None:
            motion_ns = 0 if failed else execution.motion[chain][node]
            yield execution.env.timeout(execution.stood[chain][node] + motion_ns)
        else:
            end = self.motion_time(chain, node, now, execution.stood[chain][node])
            if not failed:
                end = self.motion_end(chain, node, end)
            yield execution.env.timeout(end - now)
        if not failed:
            execution.complete(chain, node)
        return failed

    def _work_end(self, chain: int, busy_ns: int) -> int:
        """Return the end of work that begins now, stops included [ns]."""
        return self.motion_time(chain, 0, self._execution.now_ns, busy_ns)

    def motion_time(self, chain: int, _node: int, begin_ns: int, offset_ns: int) -> int:
        """Return when a node's motion has lasted for a duration, stops not counted [ns].

        Args:
            chain, _node: of the motion.
            begin_ns: when it begins [ns].
            offset_ns: how long it has lasted [ns].
        """
        stops = self._execution.stops
        if stops is None:
            return begin_ns + offset_ns
        return stops[chain].advance(begin_ns, offset_ns)

    def motion_end(self, chain: int, node: int, begin_ns: int) -> int:
        """Return the end of a node's motion that begins at a time [ns]."""
        motion_ns = self._execution.motion[chain][node]
        return self._motion_time(chain, node, begin_ns, motion_ns)

    def _execute_watched(self, narrator: Narrator, chain: int, node: int) -> Steps:
        """Execute a node and record all events in it."""
        execution = self._execution
        narrator.emit("started", chain, node)
        failed = node == execution.times.failed[chain]
        stands = narrator.standstills.get((chain, node), ())
        attempt = 0
        for k, entry in enumerate(stands):
            narrator.stands(chain, node, entry)
            over = self._work_end(chain, entry.duration_ns)
            yield execution.env.timeout(over - execution.now_ns)
            attempt += entry.cause == "retry"
            if failed and k == len(stands) - 1:
                detail = describe_failure(execution.tpg, execution.times, chain)
                narrator.emit("failed", chain, node, detail=detail)
                return
            narrator.end_standstill(chain, node, entry, attempt)
        now = begin = execution.now_ns
        for offset, name, holder in narrator.handlings.get((chain, node), ()):
            passed = begin
            if offset:
                passed = self._motion_time(chain, node, begin, offset)
            if passed > now:
                yield execution.env.timeout(passed - now)
                now = passed
            narrator.handle(chain, node, name, holder)
        end = self.motion_end(chain, node, begin)
        if end > now:
            yield execution.env.timeout(end - now)
        narrator.emit("completed", chain, node)
