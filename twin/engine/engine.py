"""The twin: a discrete-event simulation of robots that execute a TPG (APEX-MR IV-D, Fig. 4).

Every robot is a SimPy process that takes nodes from its action queue, executes them and reports
completion. One dispatcher process owns the state of the TPG and releases what has become safe.
Time is in integer nanoseconds. Events happen in the total order (time, priority, counter).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.errors import TwinError
from scheduling.graph.barriers import with_barriers
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import Nanoseconds
from twin.engine.messages import Messages
from twin.engine.narrator import failure_text
from twin.engine.open_loop import (
    busy_times,
    cut_failed,
    open_loop_times,
    planned_starts,
)
from twin.engine.processes import Execution
from twin.recorders.observers import Observers, Recorder
from twin.run.run_record import (
    POLICIES,
    DeadlockError,
    Outcome,
    Policy,
    Run,
)
from twin.uncertainty.contraction import Contraction, contract
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.halts import Halts, sample_halts
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler
from twin.uncertainty.skill_durations import SkillDurations

_Times = tuple[Nanoseconds, ...]


@dataclass(frozen=True)
class _Course:
    """How a run went, node by node."""

    outcome: Outcome
    start: _Times
    end: _Times
    now_ns: int
    deadlock: str = ""


class Simulator:
    """Executes one TPG as often as asked; see simulate for the arguments."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        durations: SkillDurations,
        *,
        policy: Policy = "asynchronous",
        queue_depth: int = 1,
        latency_s: float = 0.0,
        report_latency_s: float | None = None,
        release_latency_s: float | None = None,
        disturbances: Disturbances | None = None,
    ) -> None:
        """Keep what all runs share."""
        if policy not in POLICIES:
            raise TwinError(f"no policy {policy!r}", choices=POLICIES)
        self.tpg = tpg = with_barriers(tpg) if policy == "synchronous" else tpg
        self.policy: Policy = policy
        self.messages = Messages.of_seconds(
            queue_depth, latency_s, report_latency_s, release_latency_s
        )
        self.disturbances = disturbances
        self._sampler = NodeTimeSampler(tpg, durations, disturbances)
        self._dispatcher = Dispatcher(tpg)
        self._contraction: Contraction | None = None
        self._planned: _Times | None = None
        if policy == "open-loop":
            self._planned = planned_starts(tpg)
        elif self.messages.instant:
            self._contraction = contract(tpg)
            self._contracted_dispatcher = Dispatcher(self._contraction.tpg)

    def sample(self, *, seed: int, replication: int = 0) -> NodeTimes:
        """Return what every node takes in one replication; see sample_node_times."""
        return self._sampler.sample(seed=seed, replication=replication)

    def run(
        self,
        *,
        seed: int,
        replication: int = 0,
        recorders: Sequence[Recorder] = (),
    ) -> Run:
        """Execute the TPG once."""
        times = self.sample(seed=seed, replication=replication)
        halts = sample_halts(
            self.tpg, self.disturbances, seed=seed, replication=replication
        )
        if recorders:
            course = self._node_by_node(times, halts, recorders)
        elif self._contraction is not None:
            course = self._segment_by_segment(self._contraction, times, halts)
        elif self._planned is not None and halts is None:
            start, end = open_loop_times(self._planned, times)
            fails = max(times.failed, default=-1) >= 0
            course = _Course("failed" if fails else "completed", start, end, 0)
        else:
            course = self._node_by_node(times, halts, ())
        run = self._run_of(course, times, halts, seed, replication)
        if course.deadlock:
            raise DeadlockError(course.deadlock, run)
        return run

    def _node_by_node(
        self,
        times: NodeTimes,
        halts: tuple[Halts, ...] | None,
        recorders: Sequence[Recorder],
    ) -> _Course:
        execution = Execution(
            self.tpg,
            times,
            policy=self.policy,
            messages=self.messages,
            dispatcher=self._dispatcher.copy(),
            halts=halts,
            planned=None
            if self._planned is None
            else [start.tolist() for start in self._planned],
            observers=Observers(recorders),
        )
        outcome = execution.execute()
        return _Course(
            outcome,
            _arrays(execution.start),
            _arrays(execution.end),
            execution.now_ns,
            _deadlock(execution, outcome),
        )

    def _segment_by_segment(
        self,
        contraction: Contraction,
        times: NodeTimes,
        halts: tuple[Halts, ...] | None,
    ) -> _Course:
        """Execute whole segments, and work out the times of their nodes afterwards."""
        busy = busy_times(times)
        sums = contraction.sums(busy)
        failed = tuple(
            -1 if node < 0 else int(np.searchsorted(first, node, side="right")) - 1
            for node, first in zip(times.failed, contraction.first, strict=True)
        )
        nothing = tuple(np.zeros_like(total) for total in sums)
        execution = Execution(
            contraction.tpg,
            NodeTimes(nothing, sums, (), failed),
            policy=self.policy,
            messages=self.messages,
            dispatcher=self._contracted_dispatcher.copy(),
            halts=halts,
        )
        outcome = execution.execute()
        start, end = contraction.expand(
            _arrays(execution.start), busy, execution.now_ns, halts
        )
        cut_failed(times, start, end)
        deadlock = _deadlock(execution, outcome)
        return _Course(outcome, start, end, execution.now_ns, deadlock)

    def _run_of(
        self,
        course: _Course,
        times: NodeTimes,
        halts: tuple[Halts, ...] | None,
        seed: int,
        replication: int,
    ) -> Run:
        failed = [
            k
            for k, node in enumerate(times.failed)
            if course.outcome != "aborted" and node >= 0 and course.start[k][node] >= 0
        ]
        makespan = course.now_ns
        if course.outcome != "aborted":
            # The last report may still be on its way when the last node is complete.
            makespan = max((int(e.max()) for e in course.end if len(e)), default=0)
            for k in failed:
                node = times.failed[k]
                begun, stall = int(course.start[k][node]), int(times.stall[k][node])
                stood = begun + stall
                if halts is not None:
                    stood = halts[k].advance(begun, stall)
                makespan = max(makespan, stood)
        return Run(
            outcome=course.outcome,
            policy=self.policy,
            seed=seed,
            replication=replication,
            duration_ns=times.motion,
            stall_ns=times.stall,
            start_ns=course.start,
            end_ns=course.end,
            makespan_ns=max(makespan, 0),
            standstills=times.standstills,
            halts_ns=()
            if halts is None
            else tuple(own.intervals(max(makespan, 0)) for own in halts),
            failed_nodes=tuple(
                times.failed[k] if k in failed else -1
                for k in range(len(self.tpg.chains))
            ),
            failure="; ".join(failure_text(self.tpg, times, k) for k in failed),
        )


def _deadlock(execution: Execution, outcome: Outcome) -> str:
    if outcome == "failed" and not execution.failed:
        return execution.deadlock()
    return ""


def _arrays(rows: Sequence[Sequence[int]]) -> _Times:
    return tuple(np.array(row, dtype=np.int64) for row in rows)


def simulate(
    tpg: TemporalPlanGraph,
    durations: SkillDurations,
    *,
    seed: int,
    replication: int = 0,
    policy: Policy = "asynchronous",
    queue_depth: int = 1,
    latency_s: float = 0.0,
    report_latency_s: float | None = None,
    release_latency_s: float | None = None,
    disturbances: Disturbances | None = None,
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
            one before; in ``"open-loop"`` every robot follows the planned clock and waits for
            nobody, so that robots may collide.
        queue_depth: actions sent to a robot of which completion is not yet reported, at most.
        latency_s: time a message takes between robot and dispatcher, either way [s].
        report_latency_s, release_latency_s: the same from robot to dispatcher and from
            dispatcher to robot, where they differ [s].
        disturbances: what may go wrong.
        recorders: told of every event, then closed.

    Returns:
        The run. After a KeyboardInterrupt its outcome is ``"aborted"`` and it holds what
        happened until then. When a task fails for good its robot stops, the others go on as
        far as the TPG allows, and the outcome is ``"failed"``.

    Raises:
        DeadlockError: no robot can go on although none has failed, which no valid TPG brings
            about.
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
        TwinError: an argument is out of range.
    """
    simulator = Simulator(
        tpg,
        durations,
        policy=policy,
        queue_depth=queue_depth,
        latency_s=latency_s,
        report_latency_s=report_latency_s,
        release_latency_s=release_latency_s,
        disturbances=disturbances,
    )
    return simulator.run(seed=seed, replication=replication, recorders=recorders)
