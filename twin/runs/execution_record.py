"""Execution record of a run: outcome, start and end times of nodes, and waits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from planning.errors import TwinError
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.uncertainty.node_times import Standstill
from twin.uncertainty.stop import StopCode
from twin.uncertainty.stop_times import StoppedClock

Outcome = Literal["completed", "failed", "aborted"]
Policy = str
"""How nodes are released: a name of ``twin.registry.POLICIES``."""


class RobotWait(NamedTuple):
    """Wait of a robot whose next node may not start yet, from its begin to its end [ns]."""

    chain: int
    node: int
    start_ns: int
    end_ns: int


class Measured(NamedTuple):
    """Measured configurations of a robot.

    Attributes:
        t_ns: shape (rows,), non-decreasing [ns].
        q: joint positions, shape (rows, n) [rad or m].
        node: node that each row belongs to, shape (rows,); -1 before the first.
    """

    t_ns: Nanoseconds
    q: Array
    node: Nanoseconds


@dataclass(frozen=True)
class ExecutionRecord:
    """One execution of a TPG.

    The arrays hold one entry a chain of the TPG, each of shape (nodes,). A time of -1 marks what has
    not happened; it only occurs when the outcome is not ``"completed"``.

    Attributes:
        outcome: how it ended.
        policy: how nodes were released.
        seed, replication: key of its random draws.
        duration_ns: motion of each node, without stalls [ns].
        stood_ns: standstills of each node, after it started and before it moves [ns].
        start_ns: when each node started [ns].
        end_ns: when each node was complete [ns].
        makespan_ns: end of the last node, or when the run was broken off [ns].
        standstills: what ``stood_ns`` is made of, one entry a chain.
        stops_ns: when each robot was stopped by the clock, also in the middle of a node:
            start and end, without overlaps, one entry a chain [ns]. Node times include this.
        stopped_by_code_ns: how long each robot was stopped by the clock, by code of ``twin.uncertainty.stop`` [ns];
            empty without stops.
        failed_nodes: the node at which each robot failed for good, -1 for none.
        failure: the failed task, for people; empty without a failure.
        raised_skills: number of skills that were drawn shorter than their joints' speed limits
            allow, and took what these allow.
        commands: commands of each robot where robots have acceleration limits, one entry
            a chain; empty otherwise. Pieces of constant acceleration, each of which lasts until the
            next one begins, shape (pieces, 5): when it begins [ns], in which node, how far into it [ns],
            the speed at that moment as a share of full speed, and its change [1/ns].
        speed_override: share of planned speed at which nodes of stretches were executed, shape (nodes,)
            each; empty where it is 1 for all.
        measured: where robots were that others move, by name; those of a simulation are where their nodes
            say.
    """

    outcome: Outcome
    policy: Policy
    seed: int
    replication: int
    duration_ns: tuple[Nanoseconds, ...]
    stood_ns: tuple[Nanoseconds, ...]
    start_ns: tuple[Nanoseconds, ...]
    end_ns: tuple[Nanoseconds, ...]
    makespan_ns: int
    standstills: tuple[tuple[Standstill, ...], ...]
    stops_ns: tuple[tuple[tuple[int, int], ...], ...]
    failed_nodes: tuple[int, ...]
    failure: str
    raised_skills: int = 0
    stopped_by_code_ns: tuple[Mapping[StopCode, int], ...] = ()
    commands: tuple[Array, ...] = ()
    speed_override: tuple[Array, ...] = ()
    measured: Mapping[str, Measured] = field(default_factory=dict)

    @property
    def makespan_s(self) -> float:
        """End of the last node [s]."""
        return self.makespan_ns / NANOSECONDS

    def wait_ns(self, chain: int) -> int:
        """Return the waiting time of a robot before the end of its last node [ns].

        That is the end of its last node minus the durations and stalls of its nodes, and
        minus the time for which the clock had stopped it.
        """
        done = self.end_ns[chain] >= 0
        if not np.any(done):
            return 0
        busy = self.duration_ns[chain][done].sum() + self.stood_ns[chain][done].sum()
        end = int(self.end_ns[chain][done][-1])
        return end - int(busy) - self.stopped_ns(chain, end)

    def standing_ns(self, chain: int) -> int:
        """Return the standstill time of a robot in its completed nodes [ns]."""
        return int(self.stood_ns[chain][self.end_ns[chain] >= 0].sum())

    def stopped_ns(self, chain: int, until_ns: int) -> int:
        """Return the total time of stops of a robot before a time [ns]."""
        stops = self.stops_ns[chain]
        return sum(min(b, until_ns) - a for a, b in stops if a < until_ns)

    def pace(self, chain: int) -> StoppedClock:
        """Return the clock of a robot, which halts during stops at clock times."""
        return StoppedClock(self.stops_ns[chain])

    def waits(self) -> tuple[RobotWait, ...]:
        """Return every wait that ended, by chain and time."""
        found = []
        for k, (start, end) in enumerate(zip(self.start_ns, self.end_ns, strict=True)):
            before = np.concatenate([[0], end[:-1]])
            for node in np.flatnonzero((start > before) & (start >= 0)).tolist():
                found.append(RobotWait(k, node, int(before[node]), int(start[node])))
        return tuple(found)


class DeadlockError(TwinError):
    """No robot can continue although work is left.

    Attributes:
        run: record until then.
    """

    def __init__(self, message: str, run: ExecutionRecord) -> None:
        """Keep the run."""
        super().__init__(message)
        self.run = run


def waypoint_offsets_ns(chain: NodeChain, duration_ns: Nanoseconds) -> Nanoseconds:
    """Return the time at which a chain passes each waypoint, relative to the first motion of its node.

    Args:
        chain: p waypoints in its nodes.
        duration_ns: motion of each node, shape (nodes,) [ns].

    Returns:
        Shape (p,) [ns]; the last waypoint of a node has the node's duration.
    """
    per_waypoint = np.repeat(duration_ns, np.diff(chain.first))
    return np.rint(chain.fraction * per_waypoint).astype(np.int64)
