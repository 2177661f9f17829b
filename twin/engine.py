"""The twin: a discrete-event simulation of robots that execute a TPG (APEX-MR IV-D, Fig. 4).

Every robot is a SimPy process that takes nodes from its action queue, executes them and reports
completion. One dispatcher process owns the state of the TPG and releases what has become safe.
Time is in integer nanoseconds. Events happen in the total order (time, priority, counter).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.errors import TwinError
from scheduling.barriers import with_barriers
from scheduling.temporal_plan_graph import TemporalPlanGraph
from twin.contraction import contract
from twin.disturbances import RandomStalls
from twin.durations import Nanoseconds, NodeDurations, to_nanoseconds
from twin.execution import Execution
from twin.recorders.observers import Observers, Recorder
from twin.run import (
    POLICIES,
    DeadlockError,
    Policy,
    Run,
)


class Simulator:
    """Executes one TPG as often as asked; see simulate for the arguments."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        durations: NodeDurations,
        *,
        policy: Policy = "asynchronous",
        queue_depth: int = 1,
        latency_s: float = 0.0,
        stalls: RandomStalls | None = None,
    ) -> None:
        """Keep what all runs share."""
        if policy not in POLICIES:
            raise TwinError(f"no policy {policy!r}", choices=POLICIES)
        if queue_depth < 1:
            raise TwinError(f"queue_depth must be at least 1, not {queue_depth}")
        if not 0 <= latency_s < np.inf:
            raise TwinError(f"latency_s must be at least 0, not {latency_s}")
        self.tpg = tpg = with_barriers(tpg) if policy == "synchronous" else tpg
        self.durations = durations
        self.policy: Policy = policy
        self.queue_depth = queue_depth
        self.latency_ns = int(to_nanoseconds(latency_s))
        self.stalls = stalls
        self._contraction = contract(tpg) if self.latency_ns == 0 else None

    def run(
        self,
        *,
        seed: int,
        replication: int = 0,
        recorders: Sequence[Recorder] = (),
    ) -> Run:
        """Execute the TPG once."""
        tpg = self.tpg
        duration = self.durations.sample(tpg, seed=seed, replication=replication)
        stall = (
            self.stalls.sample(tpg, seed=seed, replication=replication)
            if self.stalls is not None
            else tuple(np.zeros(len(chain), dtype=np.int64) for chain in tpg.chains)
        )
        contraction = None if recorders else self._contraction
        if contraction is None:
            execution = self._execution(tpg, duration, stall, recorders)
            outcome = execution.execute()
            start, end = _arrays(execution.start), _arrays(execution.end)
        else:
            busy = tuple(d + s for d, s in zip(duration, stall, strict=True))
            segments = contraction.sums(busy)
            nothing = [np.zeros_like(s) for s in segments]
            execution = self._execution(contraction.tpg, segments, nothing, ())
            outcome = execution.execute()
            start, end = contraction.expand(
                _arrays(execution.start), busy, execution.now_ns
            )
        run = Run(
            outcome=outcome,
            policy=self.policy,
            seed=seed,
            replication=replication,
            duration_ns=duration,
            stall_ns=stall,
            start_ns=start,
            end_ns=end,
            # The last report may still be on its way when the last node is complete.
            makespan_ns=max((int(e[-1]) for e in end if len(e)), default=0)
            if outcome == "completed"
            else execution.now_ns,
        )
        if outcome == "failed":
            raise DeadlockError(execution.deadlock(), run)
        return run

    def _execution(
        self,
        tpg: TemporalPlanGraph,
        duration: Sequence[Nanoseconds],
        stall: Sequence[Nanoseconds],
        recorders: Sequence[Recorder],
    ) -> Execution:
        return Execution(
            tpg,
            duration,
            stall,
            policy=self.policy,
            queue_depth=self.queue_depth,
            latency_ns=self.latency_ns,
            observers=Observers(recorders),
        )


def _arrays(rows: Sequence[Sequence[int]]) -> tuple[Nanoseconds, ...]:
    return tuple(np.array(row, dtype=np.int64) for row in rows)


def simulate(
    tpg: TemporalPlanGraph,
    durations: NodeDurations,
    *,
    seed: int,
    replication: int = 0,
    policy: Policy = "asynchronous",
    queue_depth: int = 1,
    latency_s: float = 0.0,
    stalls: RandomStalls | None = None,
    recorders: Sequence[Recorder] = (),
) -> Run:
    """Execute a TPG once.

    Args:
        tpg: what to execute.
        durations: gives every node its duration.
        seed, replication: name the random draws.
        policy: ``"asynchronous"`` releases whatever the TPG says is safe; ``"sequential"`` lets
            one robot work at a time, always on the first task in planned order that is safe;
            ``"synchronous"`` lets nobody enter a slot of the plan before everyone has left the
            one before.
        queue_depth: actions sent to a robot of which completion is not yet reported, at most.
        latency_s: time a message takes between robot and dispatcher, either way [s].
        stalls: random stalls, None for none.
        recorders: told of every event, then closed.

    Returns:
        The run. After a KeyboardInterrupt its outcome is ``"aborted"`` and it holds what
        happened until then.

    Raises:
        DeadlockError: no robot can go on, which no valid TPG brings about.
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
        TwinError: an argument is out of range.
    """
    simulator = Simulator(
        tpg,
        durations,
        policy=policy,
        queue_depth=queue_depth,
        latency_s=latency_s,
        stalls=stalls,
    )
    return simulator.run(seed=seed, replication=replication, recorders=recorders)
