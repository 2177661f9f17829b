"""Event engine: a discrete-event simulation of robots that execute a TPG (APEX-MR IV-D, Fig. 4).

Every robot is a SimPy process that takes nodes from its action queue, executes them and reports
completion. One dispatcher process owns the state of the TPG and releases what has become safe.
Time is in integer nanoseconds. Events happen in the total order (time, priority, counter).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.errors import TwinError
from scheduling.graph.barriers import with_barriers
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import Nanoseconds
from twin.engine.execution_model import ExecutionModel
from twin.engine.messages import Messages
from twin.engine.narrator import failure_text
from twin.engine.open_loop import open_loop_starts, planned_starts
from twin.engine.processes import Execution
from twin.recorders.observers import Observers, Recorder
from twin.run.run_record import POLICIES, DeadlockError, Outcome, Policy, Run
from twin.uncertainty.contraction import Contraction, contract
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler
from twin.uncertainty.skill_durations import SkillDurations

_Times = tuple[Nanoseconds, ...]


@dataclass(frozen=True)
class _Course:
    """How a run went, node by node."""

    outcome: Outcome
    start: _Times
    end: _Times
    now_ns: int = 0
    deadlock: str = ""


class Simulator:
    """Executes one TPG as often as asked.

    Args:
        tpg: what to execute.
        durations: give skills their durations.
        policy: ``"asynchronous"`` releases whatever the TPG says is safe; ``"sequential"`` lets
            one robot work at a time, always on the first task in planned order that is safe;
            ``"synchronous"`` lets nobody enter a slot of the plan before everyone has left the
            one before; in ``"open-loop"`` every robot follows the planned clock and waits for
            nobody, so that robots may collide.
        messages: between robots and dispatcher.
        disturbances: what may go wrong.

    Raises:
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
        TwinError: there is no such policy.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        durations: SkillDurations,
        *,
        policy: Policy = "asynchronous",
        messages: Messages | None = None,
        disturbances: Disturbances | None = None,
    ) -> None:
        if policy not in POLICIES:
            raise TwinError(f"no policy {policy!r}", choices=POLICIES)
        self.tpg = tpg = with_barriers(tpg) if policy == "synchronous" else tpg
        self.policy: Policy = policy
        self.messages = messages or Messages()
        self.disturbances = disturbances or Disturbances()
        self._sampler = NodeTimeSampler(tpg, durations, self.disturbances)
        self._dispatcher = Dispatcher(tpg)
        self._contraction: Contraction | None = None
        self._planned: _Times | None = None
        if policy == "open-loop":
            self._planned = planned_starts(tpg)
        elif self.messages.instant:
            self._contraction = contract(tpg)
            self._contracted_dispatcher = Dispatcher(self._contraction.tpg)

    @classmethod
    def of_model(cls, tpg: TemporalPlanGraph, model: ExecutionModel) -> Simulator:
        """Return the simulator of a TPG under an execution model."""
        return cls(
            tpg,
            model.durations,
            policy=model.policy,
            messages=model.messages,
            disturbances=model.disturbances,
        )

    def run(
        self, *, seed: int, replication: int = 0, recorders: Sequence[Recorder] = ()
    ) -> Run:
        """Execute the TPG once.

        Args:
            seed, replication: name the random draws.
            recorders: told of every event, then closed.

        Returns:
            The run. After a KeyboardInterrupt its outcome is ``"aborted"`` and it holds what
            happened until then. When a task fails for good its robot stops, the others go on
            as far as the TPG allows, and the outcome is ``"failed"``.

        Raises:
            DeadlockError: no robot can go on although none has failed, which no valid TPG
                brings about.
        """
        times = self._sampler.sample(seed=seed, replication=replication)
        if recorders:
            course = self._node_by_node(times, recorders)
        elif self._contraction is not None:
            course = self._segment_by_segment(self._contraction, times)
        elif self._planned is not None and times.halts is None:
            start = open_loop_starts(self._planned, times)
            end = tuple(s + b for s, b in zip(start, times.busy, strict=True))
            times.cut_failed(start, end)
            fails = max(times.failed, default=-1) >= 0
            course = _Course("failed" if fails else "completed", start, end)
        else:
            course = self._node_by_node(times, ())
        run = self._run_of(course, times, (seed, replication))
        if course.deadlock:
            raise DeadlockError(course.deadlock, run)
        return run

    def _node_by_node(self, times: NodeTimes, recorders: Sequence[Recorder]) -> _Course:
        execution = Execution(
            self.tpg,
            times,
            self._dispatcher.copy(),
            self.messages,
            sequential=self.policy == "sequential",
            planned=self._planned,
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
        self, contraction: Contraction, times: NodeTimes
    ) -> _Course:
        """Execute whole segments, and work out the times of their nodes afterwards."""
        sums = contraction.sums(times.busy)
        failed = tuple(
            -1 if node < 0 else int(np.searchsorted(first, node, side="right")) - 1
            for node, first in zip(times.failed, contraction.first, strict=True)
        )
        execution = Execution(
            contraction.tpg,
            replace(
                times,
                motion=tuple(np.zeros_like(total) for total in sums),
                stall=sums,
                failed=failed,
            ),
            self._contracted_dispatcher.copy(),
            self.messages,
            sequential=self.policy == "sequential",
        )
        outcome = execution.execute()
        start, end = contraction.expand(
            _arrays(execution.start), times.busy, execution.now_ns, times.halts
        )
        times.cut_failed(start, end)
        deadlock = _deadlock(execution, outcome)
        return _Course(outcome, start, end, execution.now_ns, deadlock)

    def _run_of(self, course: _Course, times: NodeTimes, name: tuple[int, int]) -> Run:
        failed = [
            k
            for k, node in enumerate(times.failed)
            if course.outcome != "aborted" and node >= 0 and course.start[k][node] >= 0
        ]
        halts = times.halts or ()
        makespan = course.now_ns
        if course.outcome != "aborted":
            # The last report may still be on its way when the last node is complete.
            makespan = max((int(e.max()) for e in course.end if len(e)), default=0)
            for k in failed:
                node = times.failed[k]
                begun, stall = int(course.start[k][node]), int(times.stall[k][node])
                stood = halts[k].advance(begun, stall) if halts else begun + stall
                makespan = max(makespan, stood)
        makespan = max(makespan, 0)
        chains = range(len(self.tpg.chains))
        return Run(
            outcome=course.outcome,
            policy=self.policy,
            seed=name[0],
            replication=name[1],
            duration_ns=times.motion,
            stall_ns=times.stall,
            start_ns=course.start,
            end_ns=course.end,
            makespan_ns=makespan,
            standstills=times.standstills,
            halts_ns=tuple(
                halts[k].intervals(makespan) if halts else () for k in chains
            ),
            failed_nodes=tuple(times.failed[k] if k in failed else -1 for k in chains),
            failure="; ".join(failure_text(self.tpg, times, k) for k in failed),
        )


def _deadlock(execution: Execution, outcome: Outcome) -> str:
    if outcome == "failed" and not execution.failed:
        return execution.deadlock()
    return ""


def _arrays(rows: Sequence[Sequence[int]]) -> _Times:
    return tuple(np.array(row, dtype=np.int64) for row in rows)
