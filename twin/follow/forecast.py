"""Monte-Carlo forecasts of the end of a run in progress.

Completed nodes have known times. Remaining durations of current nodes are drawn conditional on their elapsed times, and
durations of later nodes as in a simulation. The times of all nodes then follow from the temporal plan graph. Each
simulated continuation of the run is called a *future*.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.activities.progress import RobotProgress
from twin.bulk.max_plus import Past, end_times, policy_graph
from twin.durations.bounded import Fixed
from twin.durations.measured import MeasuredTimes
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.engine.execution_model import ExecutionModel
from twin.engine.model_holds import with_model_holds
from twin.follow.drift import FEWEST, Drift, DriftWatch
from twin.follow.state import FollowedRun
from twin.uncertainty.draws import stable_hash, uniforms
from twin.uncertainty.least_durations import least_ns
from twin.uncertainty.node_times import NodeTimeSampler
from twin.uncertainty.skill_durations import drawn_nodes

SAMPLES = 200
"""Number of sampled futures; fewer for plans with too many nodes for the memory."""

SEED = stable_hash("forecast") >> 2
"""Seed of the sampled futures: a hash, so that no run has it by chance."""

_FEWEST = 50
"""Minimum number of sampled futures, however large the graph."""

_MOST_VALUES = 8_000_000
"""Maximum number of node times in all samples, beyond that minimum; it bounds the memory."""


@dataclass(frozen=True)
class Forecast:
    """Forecast of the end of a run in progress.

    Attributes:
        t_ns: time of the run at which the forecast was made [ns].
        makespan_s: end of the run in every sampled future in which no task fails for good,
            ascending, shape (n,) [s].
        failing: share of sampled futures in which a task fails for good.
        nodes_done, nodes: number of completed nodes, and of all nodes.
    """

    t_ns: int
    makespan_s: Array
    failing: float
    nodes_done: int
    nodes: int

    @property
    def t_s(self) -> float:
        """Time of the forecast in the run [s]."""
        return self.t_ns / NANOSECONDS

    def quantile(self, p: float) -> float:
        """Return a quantile of the makespan [s]; NaN without one."""
        if len(self.makespan_s) == 0:
            return float("nan")
        return float(np.quantile(self.makespan_s, p))


class Forecaster:
    """Makes repeated forecasts of one run.

    The same futures are drawn every time, so that a forecast changes because of events and not by
    chance. Emergency stops and breakdowns at times of the run's clock are included only once they have begun.
    """

    def __init__(
        self, tpg: TemporalPlanGraph, model: ExecutionModel, *, samples: int = SAMPLES
    ) -> None:
        """Sample the futures.

        Args:
            tpg: the executed plan.
            model: execution model, with disturbances.
            samples: number of futures.
        """
        self._tpg = tpg
        self._graph = policy_graph(with_model_holds(tpg, model), model.policy)
        self._messages = model.messages.under(model.policy)
        self._disturbances = model.disturbances
        self._least = least_ns(tpg)
        nodes = len(self._graph.order)
        fits = max(_FEWEST, _MOST_VALUES // max(nodes, 1))
        self._samples = max(1, min(samples, fits))
        sampler = NodeTimeSampler(tpg, model.durations, model.disturbances)
        self._futures = [
            sampler.sample(seed=SEED, replication=r) for r in range(self._samples)
        ]
        self._motion = np.stack(
            [_concatenated(f.motion) for f in self._futures], axis=1
        )
        self._stall = np.stack([_concatenated(f.stood) for f in self._futures], axis=1)
        self._drawn = drawn_nodes(model.durations.bind(tpg))
        self._model, self._max_samples = model, samples

    def of(self, tpg: TemporalPlanGraph) -> Forecaster:
        """Return a forecaster of the current plan; this one if it is unchanged."""
        if tpg is self._tpg:
            return self
        return Forecaster(tpg, self._model, samples=self._max_samples)

    def drifts(self, run: FollowedRun) -> tuple[Drift, ...]:
        """Return the current drifts of a run, the largest first."""
        # Creating the drift watch takes long, so it waits until enough nodes are done.
        return self._drift_watch.current_drifts(run) if run.nodes_done >= FEWEST else ()

    @cached_property
    def _drift_watch(self) -> DriftWatch:
        return DriftWatch(self._tpg, self._model, SEED)

    def forecast(self, run: FollowedRun, now_ns: int | None = None) -> Forecast:
        """Forecast the end of a run from a time.

        Args:
            run: its state.
            now_ns: the time, by default that of its last event [ns].
        """
        now = run.now_ns if now_ns is None else max(now_ns, run.now_ns)
        first = self._graph.first
        busy = self._motion + self._stall
        not_before = np.full((len(run.robots), self._samples), now, dtype=np.int64)
        fails = np.zeros(self._samples, dtype=bool)
        for k, robot in enumerate(run.robots):
            node = robot.completed
            if node < len(robot.start_ns):
                self._adapt_task(k, robot, busy)
            if robot.under_way >= 0:
                busy[first[k] + node] = self._remaining_ns(k, robot, now)
            if robot.standing:
                not_before[k] += self._standstill(robot, now)
            fails |= self._failing_futures(k, robot)
        past = Past(
            now,
            _concatenated([robot.start_ns for robot in run.robots]),
            _concatenated([robot.end_ns for robot in run.robots]),
            not_before,
        )
        end = end_times(self._graph, busy, self._messages, past)
        makespan = end.max(axis=0, initial=0) / NANOSECONDS
        return Forecast(
            now,
            np.sort(makespan[~fails]),
            float(fails.mean()),
            run.nodes_done,
            len(self._graph.order),
        )

    def _adapt_task(self, k: int, robot: RobotProgress, busy: Nanoseconds) -> None:
        """Scale the remaining motions of a task by the pace of its completed ones."""
        pace = self._task_pace(k, robot)
        if pace is None:
            return
        chain, node = self._tpg.chains[k], robot.completed
        high = int(np.searchsorted(chain.task, chain.task[node], side="right"))
        rest = np.arange(node, high)[~chain.skill[node:high]]
        moving = to_nanoseconds(chain.duration[rest] * pace)
        rows = self._graph.first[k] + rest
        busy[rows] = moving[:, None] + self._stall[rows]

    def _remaining_ns(self, k: int, robot: RobotProgress, now: int) -> Nanoseconds:
        """Return the remaining time of the current node in every future [ns]."""
        chain, node = self._tpg.chains[k], robot.under_way
        worked = robot.worked_ns(now)
        row = int(self._graph.first[k]) + node
        rest = np.maximum(self._motion[row] - worked, 0)
        if chain.skill[node]:
            total = self._skill_total(k, node, worked)
            if total is not None:
                rest = np.maximum(total - worked, 0)
        else:
            pace = self._task_pace(k, robot)
            if pace is not None:
                planned = int(to_nanoseconds(chain.duration[node] * pace))
                rest = np.full(self._samples, max(planned - worked, 0))
        return np.asarray(rest + self._retries(k, robot, node), dtype=np.int64)

    def _task_pace(self, k: int, robot: RobotProgress) -> float | None:
        """Return the ratio of observed to planned time of a task's completed motions, None without any."""
        chain, node = self._tpg.chains[k], robot.completed
        low = int(np.searchsorted(chain.task, chain.task[node]))
        done = np.arange(low, node)[~chain.skill[low:node]]
        planned = float(chain.duration[done].sum())
        if planned <= 0:
            return None
        took = robot.end_ns[done] - robot.start_ns[done] - robot.stood_ns[done]
        return float(took.sum()) / NANOSECONDS / planned

    def _skill_total(self, k: int, node: int, worked: int) -> Nanoseconds | None:
        """Draw the duration of a started skill node [ns]."""
        chain = self._tpg.chains[k]
        what, model, share = self._drawn.get((k, node), ("", None, 0.0))
        if model is None or share <= 0:
            return None
        u = self._uniforms(chain.robot, int(chain.task[node]), what, "duration")
        seconds = conditional_quantiles(model, worked / NANOSECONDS / share, u)
        least = int(self._least[k][node])
        return np.asarray(np.maximum(to_nanoseconds(seconds * share), least))

    def _retries(self, k: int, robot: RobotProgress, node: int) -> Nanoseconds:
        """Return the time of further attempts at the current skill [ns]."""
        task = self._tpg.tasks[int(self._tpg.chains[k].task[node])]
        if task.kind not in self._disturbances.failures:
            return np.zeros(self._samples, dtype=np.int64)
        costs = (
            [
                e.duration_ns
                for e in f.standstills[k]
                if (e.node, e.cause) == (node, "retry")
            ]
            for f in self._futures
        )
        return np.array([sum(own[robot.attempts :]) for own in costs], dtype=np.int64)

    def _standstill(self, robot: RobotProgress, now: int) -> Nanoseconds:
        """Draw the remaining standstill of a robot [ns]."""
        stood_s = max(now - robot.since_ns, 0) / NANOSECONDS
        u = self._uniforms(robot.name, -1, robot.standing, "standstill")
        model = self._standing_model(robot)
        return to_nanoseconds(
            np.maximum(conditional_quantiles(model, stood_s, u) - stood_s, 0)
        )

    def _uniforms(self, robot: str, task: int, kind: str, purpose: str) -> Array:
        """Return a draw for every future, shape (samples,)."""
        futures = np.arange(self._samples)
        drawn = uniforms(SEED, futures, [robot], [task], [kind], purpose)
        return np.asarray(drawn[0])

    def _standing_model(self, robot: RobotProgress) -> DurationModel:
        found = self._disturbances
        if self._tpg.cell.is_machine(robot.name):
            found = found.of_machine(robot.name)
        if robot.standing == "stalled":
            if found.stalls.happen:
                return found.stalls.model
        elif found.breakdowns is not None:
            return found.breakdowns.repair
        elif found.emergency_stops or found.planned_stops:
            stops = tuple(stop.duration_s for stop in found.emergency_stops)
            stops += tuple(stop.duration_s for stop in found.planned_stops)
            return MeasuredTimes(values=stops)
        return Fixed(value_s=0.0)

    def _failing_futures(self, k: int, robot: RobotProgress) -> Array:
        """Return the futures in which a remaining task of a robot fails for good."""
        if robot.failed:
            return np.ones(self._samples, dtype=bool)
        return np.array([f.failed[k] >= robot.completed for f in self._futures])


def _concatenated(rows: Sequence[Nanoseconds]) -> Nanoseconds:
    return np.concatenate([*rows, np.empty(0, dtype=np.int64)]).astype(np.int64)


def conditional_quantiles(model: DurationModel, least_s: float, u: Array) -> Array:
    """Return the quantiles of a duration conditional on a lower bound.

    Args:
        model: distribution of the duration.
        least_s: lower bound [s].
        u: probabilities in (0, 1).

    Returns:
        Same shape as ``u`` [s]; ``least_s`` if the model has no longer duration.
    """
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if float(model.ppf(np.array([middle]))[0]) > least_s:
            high = middle
        else:
            low = middle
    if high >= 1.0:
        return np.full(np.shape(u), least_s)
    conditional = np.clip(high + (1.0 - high) * u, None, np.nextafter(1.0, 0.0))
    return np.maximum(model.ppf(conditional), least_s)
