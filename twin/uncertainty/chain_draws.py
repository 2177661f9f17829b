"""Random motion times, standstills and failures of one robot in many replications.

Random numbers depend on the task, so a task gets the same random numbers whatever the order of events. Rare events are
stored as a list of (node, replication) entries instead of dense arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.tasks.task import TaskKind
from planning.transforms import Array, Indices
from scheduling.graph.actuations import chain_actuations
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.uncertainty.disturbances import (
    Disturbances,
    MachineBreakdowns,
    SkillFailure,
    Stalls,
)
from twin.uncertainty.draws import TaskName, uniforms

Cause = Literal["stall", "breakdown", "retry"]

_HOUR_NS = 3600 * NANOSECONDS


@dataclass(frozen=True)
class Standstills:
    """Standstills of one cause in some replications.

    Attributes:
        cause: their cause.
        node, column: node of the robot and column of the replication, shape (n,).
        duration_ns: their durations, shape (n,) [ns].
    """

    cause: Cause
    node: Indices
    column: Indices
    duration_ns: Nanoseconds


def moving_nodes(tpg: TemporalPlanGraph, chain: NodeChain) -> npt.NDArray[np.bool_]:
    """Return for each node of a robot whether it is a plain motion, timed by the controller."""
    straight = [task.index for task in tpg.tasks if task.kind == TaskKind.STRAIGHT]
    moves = np.asarray(~chain.skill | np.isin(chain.task, straight))
    acts = chain_actuations(tpg, tpg.chain_index[chain.robot])
    moves[list(acts)] = False
    return moves


class RobotTaskNodes:
    """Nodes of every task of one robot.

    Attributes:
        chain: the robot's nodes.
        tasks: its tasks in order, shape (tasks,).
        kinds: kind of each task.
        objects: object of each task, None without one.
        first: first node of each task and the number of nodes, shape (tasks + 1,).
        of_node: place in ``tasks`` of every node's task, shape (nodes,).
        moves: whether a node is a plain motion, shape (nodes,).
        robots, numbers: key of the draws of each task.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        chain: NodeChain,
        names: Mapping[int, TaskName],
    ) -> None:
        self.chain = chain
        self.moves = moving_nodes(tpg, chain)
        opens = np.flatnonzero(np.diff(chain.task, prepend=-1) != 0)
        self.tasks: Indices = chain.task[opens]
        self.kinds = [tpg.tasks[task].kind for task in self.tasks.tolist()]
        self.objects = [tpg.tasks[task].object for task in self.tasks.tolist()]
        named = [names.get(k, (chain.robot, k)) for k in self.tasks.tolist()]
        self.robots = [robot for robot, _ in named]
        self.numbers: Indices = np.array([k for _, k in named], dtype=np.int64)
        self.first: Indices = np.append(opens, len(chain)).astype(np.int64)
        self.of_node: Indices = np.repeat(
            np.arange(len(self.tasks)), np.diff(self.first)
        )

    def skill_nodes(self, place: int) -> Indices:
        """Return the nodes of a task that belong to its skill."""
        low, high = self.first[place], self.first[place + 1]
        return np.asarray(low + np.flatnonzero(self.chain.skill[low:high]))


@dataclass(frozen=True)
class ChainDraws:
    """Draws of one robot in some replications, one column each.

    Attributes:
        own: the robot's tasks.
        seed: names the draws.
        numbers: numbers of the replications, shape (r,).
        disturbances: disturbances of the run.
    """

    own: RobotTaskNodes
    seed: int
    numbers: Indices
    disturbances: Disturbances

    def draw(self, which: Indices, purpose: str, index: npt.ArrayLike = 0) -> Array:
        """Return one uniform for each of some tasks, by index, shape (n, r)."""
        return uniforms(
            self.seed,
            self.numbers,
            [self.own.robots[k] for k in which.tolist()],
            self.own.numbers[which],
            [self.own.kinds[k] for k in which.tolist()],
            purpose,
            index,
        )

    def of_robot(self, count: int, purpose: str, *, first: int = 0) -> Array:
        """Return uniforms that belong to no task, from the number ``first`` on, shape (count, r)."""
        return uniforms(
            self.seed,
            self.numbers,
            [self.own.chain.robot] * count,
            -1,
            [""] * count,
            purpose,
            range(first, first + count),
        )

    @cached_property
    def speed_override(self) -> Array | None:
        """Speed override of each node, shape (nodes, r); None for 1.

        With acceleration limits a stretch, a straight run from rest to rest, is one motion with one factor:
        that of the task in which it begins. It is planned as fast as limits allow, so the factor is at most 1.
        """
        own, drive = self.own, self.own.chain.drive
        speed = self.disturbances.speed.model_of(own.chain.robot)
        if speed is None:
            return None
        factor = speed.ppf(self.draw(np.arange(len(own.tasks)), "speed"))[own.of_node]
        if drive is not None:
            opens = np.append(0, np.flatnonzero(drive.rests[:-1]) + 1)
            first = np.repeat(opens, np.diff(np.append(opens, len(own.of_node))))
            stretch = drive.ramp > 0.0
            factor[stretch] = np.minimum(factor[first[stretch]], 1.0)
        return np.where(own.moves[:, None], factor, 1.0)

    def motion(self, planned: Nanoseconds, least: Nanoseconds) -> Nanoseconds:
        """Return the durations of nodes with speed factor and jitter, shape (nodes, r) [ns].

        Args:
            planned: durations without both, shape (nodes, r) [ns].
            least: lower bounds for the speed factor, shape (nodes,) [ns].
        """
        own, chain, factor = self.own, self.own.chain, self.speed_override
        out = planned
        if factor is not None:
            scaled = to_nanoseconds(chain.duration[:, None] / factor)
            out = np.where(own.moves[:, None], scaled, out)
        out = np.maximum(out, least[:, None])
        if self.disturbances.jitter is not None:
            index = np.arange(len(chain)) - own.first[own.of_node]
            u = self.draw(own.of_node, "jitter", index)
            out = out + to_nanoseconds(self.disturbances.jitter.ppf(u))
        return out

    def standstills(self, motion: Nanoseconds) -> list[Standstills]:
        """Return stalls and breakdowns by busy time.

        Args:
            motion: durations of nodes, shape (nodes, r) [ns].
        """
        found = []
        stalls, breaks = self.disturbances.stalls, self.disturbances.breakdowns
        if stalls.count_per_robot > 0:
            found.append(self._counted(stalls))
        if stalls.rate_per_h > 0:
            mean_ns = _HOUR_NS / stalls.rate_per_h
            found += self._arrivals(motion, mean_ns, stalls.model, "stall")
        if breaks is not None and breaks.affects(self.own.chain.robot, "busy"):
            if breaks.mtbf_s is not None:
                mean_ns = breaks.mtbf_s * NANOSECONDS
                found += self._arrivals(motion, mean_ns, breaks.repair, "breakdown")
            else:
                found.append(self._renewals(motion, breaks))
        return found

    def failures(
        self, motion: Nanoseconds
    ) -> tuple[list[Standstills], Indices, npt.NDArray[np.bool_]]:
        """Return failed attempts, and the first node that fails for good.

        Args:
            motion: durations of nodes, shape (nodes, r) [ns].

        Returns:
            The attempts, shape (r,) with -1 where nothing fails for good, and whether the object is
            lost where something does, shape (r,).
        """
        found: list[Standstills] = []
        never = len(self.own.chain)
        failed = np.full(len(self.numbers), never, dtype=np.int64)
        losing = failed.copy()
        for skill, failure in self.disturbances.failures.items():
            places = [k for k, kind in enumerate(self.own.kinds) if kind == skill]
            if places and (failure.probability > 0 or failure.parts):
                which = np.array(places, dtype=np.int64)
                found += self._attempts(which, motion, failure, failed, losing)
        lost = (failed == losing) & (failed < never)
        return found, np.where(failed == never, -1, failed), lost

    def _counted(self, stalls: Stalls) -> Standstills:
        """Return a given number of stalls at nodes that are equally likely."""
        count = min(stalls.count_per_robot, len(self.own.chain))
        place = self.of_robot(count, "stall-node")
        duration = to_nanoseconds(stalls.model.ppf(self.of_robot(count, "stall")))
        column = np.broadcast_to(np.arange(len(self.numbers)), duration.shape)
        node = choose_distinct(len(self.own.chain), place)
        return Standstills("stall", node.ravel(), column.ravel(), duration.ravel())

    def _arrivals(
        self,
        motion: Nanoseconds,
        mean_ns: float,
        duration: DurationModel,
        cause: Cause,
    ) -> list[Standstills]:
        """Return the events of a Poisson process of the robot's busy time.

        The process is memoryless, so each task may start it again.
        """
        own = self.own
        found = []
        passed = np.zeros((motion.shape[0] + 1, motion.shape[1]), dtype=np.int64)
        np.cumsum(motion, axis=0, out=passed[1:])
        length = passed[own.first[1:]] - passed[own.first[:-1]]
        clock = np.zeros(length.shape)
        active = np.ones(length.shape, dtype=bool)
        rows = np.arange(len(own.tasks))
        index = 0
        while len(rows):
            clock[rows] -= mean_ns * np.log(self.draw(rows, f"{cause}-gap", index))
            active[rows] &= clock[rows] < length[rows]
            rows = rows[active[rows].any(axis=1)]
            if len(rows):
                u = self.draw(rows, f"{cause}-duration", index)
                row, column = np.nonzero(active[rows])
                task = rows[row]
                node = _locate(passed, own.first, task, column, clock)
                seconds = duration.ppf(u[row, column])
                found.append(Standstills(cause, node, column, to_nanoseconds(seconds)))
            index += 1
        return found

    def _renewals(self, motion: Nanoseconds, breaks: MachineBreakdowns) -> Standstills:
        """Return the breakdowns of a renewal process of the robot's busy time."""
        ends = np.cumsum(motion, axis=0)
        busy = motion.sum(axis=0)
        clock = np.zeros(len(busy))
        none = np.empty(0, dtype=np.int64)
        nodes, columns, lasting = [none], [none], [none]
        index = 0
        while (running := np.flatnonzero(clock < busy)).size:
            gap, repair = self.of_robot(2, "breakdown", first=2 * index)
            clock += NANOSECONDS * breaks.between.ppf(gap)
            failing = running[clock[running] < busy[running]]
            nodes.append((ends[:, failing] <= clock[failing]).sum(axis=0))
            columns.append(failing)
            lasting.append(to_nanoseconds(breaks.repair.ppf(repair[failing])))
            index += 1
        found = (np.concatenate(part) for part in (nodes, columns, lasting))
        return Standstills("breakdown", *found)

    def _attempts(
        self,
        which: Indices,
        motion: Nanoseconds,
        failure: SkillFailure,
        failed: Indices,
        losing: Indices,
    ) -> list[Standstills]:
        """Return failed attempts at some tasks.

        Lowers ``failed`` to the first node of each replication that fails for good, and ``losing`` to the
        first that loses its object.
        """
        skills = [self.own.skill_nodes(k) for k in which.tolist()]
        nodes = np.array([skill[0] for skill in skills], dtype=np.int64)
        fails = np.ones((len(which), len(self.numbers)), dtype=bool)
        own = self.own
        chance = np.array(
            [failure.of(own.chain.robot, own.objects[k]) for k in which.tolist()]
        )
        found = []
        for attempt in range(failure.retries + 1):
            fails &= self.draw(which, "failure", attempt) < chance[:, None]
            row, column = np.nonzero(fails)
            if len(row) == 0:
                break
            if failure.retry is None:
                skill_ns = np.stack([motion[skill].sum(axis=0) for skill in skills])
                cost = skill_ns[row, column]
            else:
                u = self.draw(which, "retry", attempt)
                cost = to_nanoseconds(failure.retry.ppf(u[row, column]))
            found.append(Standstills("retry", nodes[row], column, cost))
            lost = fails & self._lost(which, failure, attempt)
            last = fails if attempt == failure.retries else lost
            for least, which_fail in ((failed, last), (losing, lost)):
                row, column = np.nonzero(which_fail)
                np.minimum.at(least, column, nodes[row])
            fails = fails & ~last
        return found

    def _lost(
        self, which: Indices, failure: SkillFailure, attempt: int
    ) -> npt.NDArray[np.bool_]:
        """Return whether a failed attempt at each task loses its object, shape (n, r)."""
        if failure.loses <= 0.0:
            return np.zeros((len(which), len(self.numbers)), dtype=np.bool_)
        kinds = np.array(
            [self.own.kinds[k] in TaskKind.HANDLING for k in which.tolist()]
        )
        lost = self.draw(which, "lost", attempt) < failure.loses
        return np.asarray(lost & kinds[:, None])


def choose_distinct(n: int, u: Array) -> Indices:
    """Return distinct numbers below n, every choice equally likely.

    Floyd's algorithm: it needs one uniform for each number, without rejection.

    Args:
        n: exclusive bound of the numbers, at least the number of rows.
        u: uniforms in (0, 1), shape (count, r).

    Returns:
        Shape (count, r); the numbers in a column are distinct.
    """
    chosen = np.empty(u.shape, dtype=np.int64)
    for k, row in enumerate(u):
        last = n - len(u) + k
        pick = np.minimum((row * (last + 1)).astype(np.int64), last)
        taken = (chosen[:k] == pick).any(axis=0)
        chosen[k] = np.where(taken, last, pick)
    return chosen


@kernel
def _locate(
    passed: Nanoseconds, first: Indices, task: Indices, column: Indices, clock: Array
) -> Indices:
    """Return the node of a task at a time since the task began."""
    node = np.empty(len(task), np.int64)
    for k in range(len(task)):
        a, b, r = first[task[k]], first[task[k] + 1], column[k]
        start = passed[a, r]
        # Bisection: the last node that begins no later than the time.
        while b - a > 1:
            middle = (a + b) // 2
            if passed[middle, r] - start <= clock[task[k], r]:
                a = middle
            else:
                b = middle
        node[k] = a
    return node
