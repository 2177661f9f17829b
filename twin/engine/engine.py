"""Event engine: discrete-event simulation of robots that execute a temporal plan graph (APEX-MR, section IV-D, Fig. 4).

Every robot is a SimPy process that takes nodes from its action queue, executes them and reports their completion. One
dispatcher process owns the state of the graph and releases nodes whose predecessors are complete. Time is in integer
nanoseconds. Events are processed in the order of time, then priority, then insertion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from planning.errors import TwinError
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import is_driven, with_full_speed_times
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.dispatch_policies import with_policy
from twin.engine.driven_robots import DrivenRobots
from twin.engine.execution import Execution, Ports
from twin.engine.execution_model import ExecutionModel, Messages
from twin.engine.narrator import describe_failure
from twin.engine.simulated_robots import SimulatedRobots
from twin.recorders.observers import Observers, Recorder
from twin.registry import POLICIES
from twin.runs.execution_record import DeadlockError, ExecutionRecord
from twin.uncertainty.contraction import Contraction, contract
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes, NodeTimeSampler
from twin.uncertainty.skill_durations import nominal_ns

_Times = tuple[Nanoseconds, ...]


class Simulator:
    """Executes one TPG as often as asked.

    Attributes:
        tpg: plan to execute, with edges added by the policy.
        contraction: of it, where whole segments give the same times; None where each node counts.

    Args:
        tpg: plan to execute, with the holds of the model, see ``with_model_holds``.
        model: execution model, with disturbances.
        names: of the draws of tasks that are not named by themselves, by index.

    Raises:
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
        TwinError: there is no such policy.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        model: ExecutionModel,
        names: Mapping[int, TaskName] = MappingProxyType({}),
    ) -> None:
        policy = model.policy
        if policy not in POLICIES:
            raise TwinError(f"no policy {policy!r}", choices=POLICIES.names())
        self.driven = is_driven(tpg)
        # Turns of robots that rest between nodes are the execution's.
        if policy == "synchronous" or (policy == "sequential" and self.driven):
            tpg = with_policy(tpg, policy)
        self.tpg = tpg
        self._model = model
        self._sampler = NodeTimeSampler(
            with_full_speed_times(tpg), model.durations, model.disturbances, names
        )
        self._dispatcher = Dispatcher(tpg)
        self.contraction: Contraction | None = None
        self._planned: _Times | None = None
        if policy == "open-loop":
            self._planned = tuple(earliest_times(tpg, nominal_ns(tpg)).start)
        elif model.messages.instant and not self.driven:
            self.contraction = contract(tpg)
            self._contracted_dispatcher = Dispatcher(self.contraction.tpg)

    def run(
        self, *, seed: int, replication: int = 0, recorders: Sequence[Recorder] = ()
    ) -> ExecutionRecord:
        """Execute the TPG once.

        Without recorders whole segments are executed, and the times of their nodes computed afterwards.

        Args:
            seed, replication: name the random draws.
            recorders: receive every event, then are closed.

        Returns:
            The run. After a KeyboardInterrupt its outcome is ``"aborted"`` and it ends there. When a
            task fails for good its robot stops, the others continue
            as far as the TPG allows, and the outcome is ``"failed"``.

        Raises:
            DeadlockError: no robot can continue although none has failed, which no valid TPG
                brings about.
        """
        times = self._sampler.sample(seed=seed, replication=replication)
        contraction = None if recorders else self.contraction
        execution = self._execution(
            times if contraction is None else _segment_times(contraction, times),
            self._model.messages,
            contracted=contraction is not None,
            observers=Observers(recorders),
        )
        outcome = execution.execute()
        start, end = _arrays(execution.start), _arrays(execution.end)
        if contraction is not None:
            start, end = contraction.expand(
                start, times.busy, execution.now_ns, times.stops
            )
            times.cut_failed(start, end)
        failed = tuple(
            node if outcome != "aborted" and node >= 0 and begun[node] >= 0 else -1
            for node, begun in zip(times.failed, start, strict=True)
        )
        makespan = execution.now_ns
        if outcome != "aborted":
            makespan = _makespan_ns(times, failed, start, end)
        if self.driven:  # whose times are those of the whole graph
            times = execution.robots.node_times()
        run = ExecutionRecord(
            outcome=outcome,
            policy=self._model.policy,
            seed=seed,
            replication=replication,
            duration_ns=times.motion,
            stood_ns=times.stood,
            start_ns=start,
            end_ns=end,
            makespan_ns=makespan,
            standstills=times.standstills,
            stops_ns=times.stopped_until(makespan),
            stopped_by_code_ns=times.stopped_by_code(makespan),
            failed_nodes=failed,
            failure="; ".join(
                describe_failure(self.tpg, times, k)
                for k, node in enumerate(failed)
                if node >= 0
            ),
            raised_skills=times.raised,
            commands=execution.robots.commands(),
            speed_override=times.speed_override,
        )
        if outcome == "failed" and not execution.failed:
            raise DeadlockError(execution.deadlock(), run)
        return run

    def execute(self, times: NodeTimes, messages: Messages) -> Execution:
        """Execute the TPG once, without recorders.

        Args:
            times: of each segment of the contraction, or of each node without one.
            messages: between robots and dispatcher.

        Returns:
            The execution when nothing can continue.
        """
        contracted = self.contraction is not None
        execution = self._execution(times, messages, contracted=contracted)
        execution.execute()
        return execution

    def _execution(
        self,
        times: NodeTimes,
        messages: Messages,
        *,
        contracted: bool,
        observers: Observers | None = None,
    ) -> Execution:
        """Return an execution at time 0."""
        tpg, dispatcher = self.tpg, self._dispatcher
        if contracted and self.contraction is not None:
            tpg, dispatcher = self.contraction.tpg, self._contracted_dispatcher
        return Execution(
            tpg,
            times,
            dispatcher.copy(),
            messages,
            Ports(DrivenRobots if self.driven else SimulatedRobots),
            sequential=self._model.policy == "sequential" and not self.driven,
            planned=self._planned,
            observers=observers,
        )


def _makespan_ns(
    times: NodeTimes, failed: Sequence[int], start: _Times, end: _Times
) -> int:
    """Return when the last node is complete or has failed [ns].

    The last report may then still be on its way.
    """
    ends = [int(own.max()) for own in end if len(own)]
    for k, node in enumerate(failed):
        if node >= 0:
            begun, stood = int(start[k][node]), int(times.stood[k][node])
            stops = times.stops
            ends.append(stops[k].advance(begun, stood) if stops else begun + stood)
    return max([0, *ends])


def _segment_times(contraction: Contraction, times: NodeTimes) -> NodeTimes:
    """Return the times of whole segments: standstills and motions of their nodes as one."""
    sums = contraction.sums(times.busy)
    return replace(
        times,
        motion=tuple(np.zeros_like(total) for total in sums),
        stood=sums,
        failed=tuple(
            -1 if node < 0 else int(np.searchsorted(first, node, side="right")) - 1
            for node, first in zip(times.failed, contraction.first, strict=True)
        ),
    )


def _arrays(rows: Sequence[Sequence[int]]) -> _Times:
    return tuple(np.array(row, dtype=np.int64) for row in rows)
