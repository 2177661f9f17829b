"""How long every node takes and stands still in one replication, drawn before the run begins.

Of the disturbances these are the ones that depend on nothing that happens in the run: speed of
motions, jitter, stalls, breakdowns by busy time, failed attempts at skills. The event engine and
the engine that computes many replications side by side take the same arrays. What happens at
times of the run's clock is in ``twin.halts``.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Literal

import numpy as np

from planning.transforms import Array
from scheduling.temporal_plan_graph import Indices, NodeChain, TemporalPlanGraph
from twin.disturbances import Disturbances, SkillFailure
from twin.draws import uniforms
from twin.durations import (
    NANOSECONDS,
    DurationModel,
    Exponential,
    Nanoseconds,
    NodeDurations,
    SkillDurations,
    to_nanoseconds,
)

Cause = Literal["stall", "breakdown", "retry"]

_HOUR_NS = 3600 * NANOSECONDS


@dataclass(frozen=True)
class Standstill:
    """A robot has started a node and stands before it moves.

    Where in a node it stands makes no difference to the others: they wait for whole nodes.

    Attributes:
        node: index of the robot's node.
        cause: ``stall``, ``breakdown``, or ``retry`` for an attempt that failed.
        duration_ns: for how long [ns].
    """

    node: int
    cause: Cause
    duration_ns: int


@dataclass(frozen=True)
class NodeTimes:
    """What one replication gives every node, one entry a chain.

    Attributes:
        motion: duration of each node without standstills, shape (nodes,) [ns].
        stall: all standstills of each node together, shape (nodes,) [ns].
        standstills: what ``stall`` is made of, by node and in the order in which they happen.
        failed: the first node whose task fails for good, -1 for none. It never moves and is
            never complete: it has failed when its standstills are over.
    """

    motion: tuple[Nanoseconds, ...]
    stall: tuple[Nanoseconds, ...]
    standstills: tuple[tuple[Standstill, ...], ...]
    failed: tuple[int, ...]


def sample_node_times(
    tpg: TemporalPlanGraph,
    durations: NodeDurations,
    disturbances: Disturbances | None = None,
    *,
    seed: int,
    replication: int = 0,
) -> NodeTimes:
    """Draw what every node of a graph takes in one replication.

    Args:
        tpg: the graph, not contracted.
        durations: gives the nodes their undisturbed durations.
        disturbances: what may go wrong; those at times of the run's clock play no part here.
        seed, replication: name the draws.
    """
    sampler = NodeTimeSampler(tpg, durations, disturbances)
    return sampler.sample(seed=seed, replication=replication)


class NodeTimeSampler:
    """Draws what the nodes of one graph take, as often as asked; see sample_node_times."""

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        durations: NodeDurations,
        disturbances: Disturbances | None = None,
    ) -> None:
        """Keep what all replications share."""
        self._tpg = tpg
        self._durations = durations
        self._bound = (
            durations.bind(tpg) if isinstance(durations, SkillDurations) else None
        )
        self._disturbances = disturbances or Disturbances()
        self._draws = [_ChainDraws(tpg, chain) for chain in tpg.chains]

    def sample(self, *, seed: int, replication: int = 0) -> NodeTimes:
        """Draw one replication."""
        tpg, disturbances = self._tpg, self._disturbances
        motion = self._motion(seed, replication)
        counted = None
        if disturbances.stalls is not None and disturbances.stalls.count_per_robot:
            counted = disturbances.stalls.sample(
                tpg, seed=seed, replication=replication
            )
        moves, stalls, stands, fails = [], [], [], []
        for k, shared in enumerate(self._draws):
            draws = shared.named_by(seed, replication)
            moving = _moving(draws, motion[k], disturbances)
            found: list[Standstill] = []
            if counted is not None:
                for node in np.flatnonzero(counted[k]).tolist():
                    found.append(Standstill(node, "stall", int(counted[k][node])))
            found += _interruptions(draws, moving, disturbances)
            retries, failed = _failed_attempts(draws, moving, disturbances)
            found = sorted(found + retries, key=lambda entry: entry.node)
            stall = np.zeros(len(moving), dtype=np.int64)
            for entry in found:
                stall[entry.node] += entry.duration_ns
            moves.append(moving)
            stalls.append(stall)
            stands.append(tuple(found))
            fails.append(failed)
        return NodeTimes(tuple(moves), tuple(stalls), tuple(stands), tuple(fails))

    def _motion(self, seed: int, replication: int) -> tuple[Nanoseconds, ...]:
        """Return the undisturbed durations."""
        if self._bound is None:
            return self._durations.sample(self._tpg, seed=seed, replication=replication)
        rows = self._bound.durations(seed=seed, replications=[replication])
        return tuple(np.ascontiguousarray(row[0]) for row in rows)


class _ChainDraws:
    """Draws of one robot, named by its tasks.

    Attributes:
        chain: the robot's nodes.
        tasks: its tasks in order, shape (tasks,).
        kinds: kind of each task.
        first: first node of each task and the number of nodes, shape (tasks + 1,).
    """

    def __init__(self, tpg: TemporalPlanGraph, chain: NodeChain) -> None:
        self.chain = chain
        self.seed, self.replication = 0, 0
        opens = np.flatnonzero(np.diff(chain.task, prepend=-1) != 0)
        self.tasks: Indices = chain.task[opens]
        self.kinds = [tpg.tasks[task].kind for task in self.tasks.tolist()]
        self.first: Indices = np.append(opens, len(chain)).astype(np.int64)

    def named_by(self, seed: int, replication: int) -> _ChainDraws:
        """Return the draws of one replication."""
        named = copy(self)
        named.seed, named.replication = seed, replication
        return named

    def draw(self, which: Indices, purpose: str, index: Indices | int = 0) -> Array:
        """Return one uniform for each of some of the tasks, given by their place in ``tasks``."""
        return uniforms(
            self.seed,
            self.replication,
            [self.chain.robot] * len(which),
            self.tasks[which],
            [self.kinds[k] for k in which.tolist()],
            purpose,
            np.broadcast_to(np.asarray(index, dtype=np.int64), len(which)),
        )

    def of_node(self) -> Indices:
        """Return the place in ``tasks`` of every node's task."""
        return np.repeat(np.arange(len(self.tasks)), np.diff(self.first))


def _moving(
    draws: _ChainDraws, planned: Nanoseconds, disturbances: Disturbances
) -> Nanoseconds:
    """Return the durations of a chain's nodes with speed factor and jitter."""
    chain = draws.chain
    out = planned
    speed = disturbances.speed.get(chain.robot)
    if speed is not None:
        factor = speed.ppf(draws.draw(np.arange(len(draws.tasks)), "speed"))
        slowed = to_nanoseconds(chain.duration / factor[draws.of_node()])
        out = np.where(chain.skill, out, slowed)
    if disturbances.jitter is not None:
        of_node = draws.of_node()
        index = np.arange(len(chain)) - draws.first[of_node]
        u = draws.draw(of_node, "jitter", index)
        out = out + to_nanoseconds(disturbances.jitter.ppf(u))
    return out


def _interruptions(
    draws: _ChainDraws, moving: Nanoseconds, disturbances: Disturbances
) -> list[Standstill]:
    """Return the standstills that come at a rate of busy time."""
    found: list[Standstill] = []
    stalls = disturbances.stall_rate
    if stalls is not None and stalls.rate_per_h > 0:
        mean_ns = _HOUR_NS / stalls.rate_per_h
        found += _arrivals(draws, moving, mean_ns, stalls.duration, "stall")
    breaks = disturbances.breakdowns
    robot = draws.chain.robot
    if breaks is not None and breaks.clock == "busy" and breaks.affects(robot):
        repair = Exponential(breaks.mttr_s)
        mean_ns = breaks.mtbf_s * NANOSECONDS
        found += _arrivals(draws, moving, mean_ns, repair, "breakdown")
    return found


def _arrivals(
    draws: _ChainDraws,
    moving: Nanoseconds,
    mean_ns: float,
    duration: DurationModel,
    cause: Cause,
) -> list[Standstill]:
    """Return the events of a Poisson process of a robot's busy time.

    The process has no memory, so it starts afresh with every task: a task sees the same events
    whatever came before it, as common random numbers ask for.
    """
    found: list[Standstill] = []
    passed = np.concatenate([[0], np.cumsum(moving)])
    begin, end = passed[draws.first[:-1]], passed[draws.first[1:]]
    clock = begin.astype(float)
    active = np.arange(len(draws.tasks))
    index = 0
    while len(active):
        u = draws.draw(active, f"{cause}-gap", index)
        clock[active] -= mean_ns * np.log(u)
        active = active[clock[active] < end[active]]
        if len(active):
            at = np.searchsorted(passed, clock[active], side="right") - 1
            seconds = duration.ppf(draws.draw(active, f"{cause}-duration", index))
            found += [
                Standstill(node, cause, stand)
                for node, stand in zip(
                    at.tolist(), to_nanoseconds(seconds).tolist(), strict=True
                )
                if stand > 0
            ]
        index += 1
    return found


def _failed_attempts(
    draws: _ChainDraws, moving: Nanoseconds, disturbances: Disturbances
) -> tuple[list[Standstill], int]:
    """Return the attempts that failed, and the first node that fails for good or -1."""
    found: list[Standstill] = []
    failed = -1
    for skill, failure in disturbances.failures.items():
        if failure.probability == 0:
            continue
        which = np.array(
            [k for k, kind in enumerate(draws.kinds) if kind == skill], dtype=np.int64
        )
        attempt = 0
        while len(which) and attempt <= failure.retries:
            fails = draws.draw(which, "failure", attempt) < failure.probability
            which = which[fails]
            costs = _costs(draws, moving, failure, which, attempt)
            for k, cost in zip(which.tolist(), costs.tolist(), strict=True):
                node = _skill_node(draws, k)
                found.append(Standstill(node, "retry", cost))
                if attempt == failure.retries and (failed < 0 or node < failed):
                    failed = node
            attempt += 1
    return found, failed


def _costs(
    draws: _ChainDraws,
    moving: Nanoseconds,
    failure: SkillFailure,
    which: Indices,
    attempt: int,
) -> Nanoseconds:
    """Return what failed attempts at some tasks cost [ns]."""
    if failure.retry is not None:
        return to_nanoseconds(failure.retry.ppf(draws.draw(which, "retry", attempt)))
    skill = np.where(draws.chain.skill, moving, 0)
    passed = np.concatenate([[0], np.cumsum(skill)])
    own = passed[draws.first[which + 1]] - passed[draws.first[which]]
    return np.asarray(own, dtype=np.int64)


def _skill_node(draws: _ChainDraws, k: int) -> int:
    """Return the first node of a task that belongs to its skill."""
    low, high = draws.first[k], draws.first[k + 1]
    return int(low + np.argmax(draws.chain.skill[low:high]))
