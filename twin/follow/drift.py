"""Detection of drift: systematic changes in the durations of a robot's skills and motions.

Measured durations are compared with simulated durations of the same plan. Each measured duration is replaced by the
normal score of its rank among the simulated ones, which limits the effect of outliers. The sum of the most recent
scores is compared with its standard deviation in the simulations; a large ratio indicates a drift. The number of scores
in the sum is the number with the largest ratio, which shows when the drift began.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import is_driven
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel
from twin.follow.state import FollowedRun
from twin.uncertainty.node_times import NodeTimeSampler

MOTIONS = "motions"
"""What all is called that takes the time of its path."""

FEWEST = 8
"""Of the last times that something was done: fewer say nothing."""

_STRANGE = 4.5
"""Spreads by which their sum is off its mean; sums are tried of many lengths, again and again."""

_SAME, _SAME_NS = 0.005, 30_000_000
"""Relative and absolute [ns] tolerance of times, for message latencies of real cells."""

_LEAST = 0.01
"""Least relative change that is reported."""

_MOST_FUTURES, _MOST_NODES = 200, 400_000
"""Futures, and their nodes together where robots keep to limits: these take a run each."""


@dataclass(frozen=True)
class Drift:
    """A change in durations of a robot.

    Attributes:
        what: the skill, the tool action (``close``, ``open``), or ``motions``.
        robot: whose.
        since_ns: when the first of those began that it is seen in [ns].
        count: how many there were since.
        ratio: total duration over its planned mean.
        low, high: interval that covers the true ratio with 95 %, by how much they differ among each other.
    """

    what: str
    robot: str
    since_ns: int
    count: int
    ratio: float
    low: float
    high: float

    @property
    def words(self) -> str:
        """Return a sentence about it."""
        more = "longer" if self.ratio > 1.0 else "less long"
        per_cent = sorted(abs(100.0 * (r - 1.0)) for r in (self.low, self.high))
        verb = "take" if self.what == MOTIONS else "takes"
        return (
            f"{self.what} of {self.robot} {verb} {abs(100.0 * (self.ratio - 1.0)):.0f} % {more} than planned"
            f" since {self.since_ns / NANOSECONDS:.0f} s ({per_cent[0]:.0f} to {per_cent[1]:.0f} %,"
            f" {self.count} times)"
        )


class _Series(NamedTuple):
    """Repeated work of a robot.

    Attributes:
        what: the kind of work.
        chain: of the robot.
        nodes: nodes of each repetition, in order.
        futures: duration of each in each future, shape (n, samples) [ns].
        scores: normal scores of these, same shape.
    """

    what: str
    chain: int
    nodes: tuple[Indices, ...]
    futures: Array
    scores: Array


class DriftWatch:
    """Detects drifts in a run in progress.

    Args:
        tpg: the executed plan.
        model: how it is executed.
        seed: names the futures.
    """

    def __init__(
        self, tpg: TemporalPlanGraph, model: ExecutionModel, seed: int = 0
    ) -> None:
        futures = list(_simulated_durations(tpg, model, seed))
        self._robots = [chain.robot for chain in tpg.chains]
        times: dict[tuple[str, int], list[Indices]] = {}
        draws = model.durations.bind(tpg)
        drawn = [np.zeros(len(chain), dtype=bool) for chain in tpg.chains]
        for what, (k, nodes, _) in zip(draws.skills, draws.nodes, strict=True):
            times.setdefault((what, k), []).append(nodes)
            drawn[k][nodes] = True
        for k, chain in enumerate(tpg.chains):
            rest = np.flatnonzero(~drawn[k] & (chain.duration > 0.0))
            changes = np.flatnonzero(np.diff(chain.task[rest])) + 1
            parts = np.split(rest, changes) if len(rest) else []
            times[MOTIONS, k] = list(parts)
        self._series = []
        for (what, k), own in times.items():
            took = [[f[k][nodes].sum() for f in futures] for nodes in own]
            if len(own) >= FEWEST:
                each = np.array(took, float)
                scores = _scores(each, each)
                self._series.append(_Series(what, k, tuple(own), each, scores))

    def current_drifts(self, run: FollowedRun) -> tuple[Drift, ...]:
        """Return the current drifts, the largest first.

        Args:
            run: its state.
        """
        found = [
            drift for series in self._series if (drift := self._drift(series, run))
        ]
        return tuple(sorted(found, key=lambda d: -abs(np.log(d.ratio))))

    def _drift(self, series: _Series, run: FollowedRun) -> Drift | None:
        robot = run.robots[series.chain]
        known = []
        for n, nodes in enumerate(series.nodes):
            if nodes[-1] >= robot.completed:
                break
            if np.all(robot.took_ns[nodes] >= 0):
                known.append(n)
        if len(known) < FEWEST:
            return None
        futures = series.futures[known]
        took = np.array([robot.took_ns[series.nodes[n]].sum() for n in known], float)
        # Sums over the last 1, 2, ... of them.
        sums = np.cumsum(_scores(took[:, None], futures)[::-1, 0])
        others = np.cumsum(series.scores[known][::-1], axis=0)
        counts = np.arange(1, len(known) + 1)
        spread = np.maximum(others.std(axis=1, ddof=1), np.sqrt(counts))
        off = np.abs(sums) / spread
        off[: FEWEST - 1] = 0.0
        last = int(np.argmax(off)) + 1
        mean = futures.mean(axis=1)
        ratio = float(took[-last:].sum() / mean[-last:].sum())
        if off[last - 1] < _STRANGE or abs(ratio - 1.0) < _LEAST:
            return None
        rest = took[-last:] - ratio * mean[-last:]
        error = np.sqrt(last / (last - 1) * (rest**2).sum()) / mean[-last:].sum()
        far = float(stdtrit(last - 1, 0.975) * error)
        begin = int(series.nodes[known[-last]][0])
        return Drift(
            series.what,
            self._robots[series.chain],
            int(robot.start_ns[begin]),
            last,
            ratio,
            ratio - far,
            ratio + far,
        )


def _simulated_durations(
    tpg: TemporalPlanGraph, model: ExecutionModel, seed: int
) -> Iterator[tuple[Nanoseconds, ...]]:
    """Yield node durations of each future, without standstills, one array per chain [ns].

    Where robots keep to limits, they brake for each other, which a run shows.
    """
    if not is_driven(tpg):
        sampler = NodeTimeSampler(tpg, model.durations, model.disturbances)
        for r in range(_MOST_FUTURES):
            yield sampler.sample(seed=seed, replication=r).motion
        return
    simulator = Simulator(tpg, model)
    nodes = sum(len(chain) for chain in tpg.chains)
    for r in range(max(10, min(_MOST_FUTURES, _MOST_NODES // max(nodes, 1)))):
        yield simulator.run(seed=seed, replication=r).duration_ns


def _scores(times: Array, futures: Array) -> Array:
    """Return the normal scores of times by their ranks among futures.

    Args:
        times: shape (n, m).
        futures: shape (n, samples).
    """
    ranked = np.sort(futures, axis=1)
    count = ranked.shape[1]
    share = np.empty(times.shape)
    for row, (own, among) in enumerate(zip(times, ranked, strict=True)):
        near = np.maximum(_SAME * own, _SAME_NS)
        less = np.searchsorted(among, own - near, side="left")
        not_more = np.searchsorted(among, own + near, side="right")
        share[row] = (0.5 * (less + not_more) + 0.5) / (count + 1)
    return np.asarray(ndtri(share))
