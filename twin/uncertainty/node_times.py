"""Durations and standstills of all nodes in a replication, drawn before the run begins.

Speeds of motions, jitter, stalls, breakdowns after a busy time and failed attempts at skills do not depend on events of
the run. Stops at given clock times are given as time intervals. The event engine and the bulk engine, which computes
many replications at once, use the same draws.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import is_driven
from twin.durations.nanoseconds import Nanoseconds, require_within_longest_run
from twin.uncertainty.chain_draws import Cause, ChainDraws, RobotTaskNodes, Standstills
from twin.uncertainty.contraction import Contraction
from twin.uncertainty.disturbances import Disturbances, Speed
from twin.uncertainty.draws import TaskName
from twin.uncertainty.least_durations import least_ns
from twin.uncertainty.skill_durations import SkillDurations, nominal_ns
from twin.uncertainty.stop import StopCode
from twin.uncertainty.stop_times import Stops, draw_stops

_MOST_VALUES = 4_000_000
"""Node times drawn together, to bound memory."""


@dataclass(frozen=True)
class Standstill:
    """Standstill of a robot between the start of a node and its motion.

    Its position within the node does not affect other robots, which wait for whole nodes.

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
    """Times of every node in one replication, one entry for each chain.

    Attributes:
        motion: duration of each node without standstills, shape (nodes,) [ns].
        stood: total standstill of each node, shape (nodes,) [ns].
        standstills: the standstills in ``stood``, by node and in time order.
        failed: the first node whose task fails for good, -1 for none. It never moves and is never complete.
            After its standstills, ``SimulatedRobots.perform`` reports the failure to ``Execution``, whose
            replanner recovers from it.
        stops: stops at times of the run's clock, None without any.
        raised: skills that were drawn shorter than their joints' speed limits allow.
        lost: chains of which the task that fails for good loses its object.
        speed_override: share of planned speed at which nodes of stretches are executed, shape (nodes,)
            each; empty where it is 1 for all.
    """

    motion: tuple[Nanoseconds, ...]
    stood: tuple[Nanoseconds, ...]
    standstills: tuple[tuple[Standstill, ...], ...]
    failed: tuple[int, ...]
    stops: tuple[Stops, ...] | None = None
    raised: int = 0
    lost: frozenset[int] = frozenset()
    speed_override: tuple[Array, ...] = ()

    def override(self, chain: int) -> Array:
        """Return the speed override of the nodes of a chain, shape (nodes,)."""
        if self.speed_override:
            return self.speed_override[chain]
        return np.ones(len(self.motion[chain]))

    @cached_property
    def busy(self) -> tuple[Nanoseconds, ...]:
        """Standstill plus motion of every node; failed ones do not move [ns]."""
        out = []
        for motion, stood, failed in zip(
            self.motion, self.stood, self.failed, strict=True
        ):
            total = motion + stood
            if failed >= 0:
                total[failed] = stood[failed]
                total[failed + 1 :] = 0
            out.append(total)
        return tuple(out)

    def stopped_until(self, t_ns: int) -> tuple[tuple[tuple[int, int], ...], ...]:
        """Return the stops of each robot until a time, see ``ExecutionRecord`` [ns]."""
        if not self.stops:
            return ((),) * len(self.motion)
        return tuple(own.intervals(t_ns) for own in self.stops)

    def stopped_by_code(self, t_ns: int) -> tuple[Mapping[StopCode, int], ...]:
        """Return how long each robot was stopped until a time, by code [ns]."""
        return tuple(own.times_by_code(t_ns) for own in self.stops or ())

    def cut_failed(
        self, start: Sequence[Nanoseconds], end: Sequence[Nanoseconds]
    ) -> None:
        """Set the times of nodes after a task that failed for good to -1."""
        for node, begun, done in zip(self.failed, start, end, strict=True):
            if node >= 0:
                begun[node + 1 :] = -1
                done[node:] = -1


@dataclass(frozen=True)
class SegmentTimes:
    """Times of the segments of a contracted graph in some replications.

    Attributes:
        busy_ns: standstills and durations of each segment together, chain by chain, shape
            (segments, r) [ns].
        fails: True where a task fails for good: its consequences need the event engine,
            shape (r,).
        standstills: the part of ``busy_ns`` for which robots stand; segments are numbered
            through, chain by chain.
        speed_override: share of planned speed at which nodes are executed, shaped as ``busy_ns``;
            of shape (0, 0) where it is 1 for all, and for robots without limits of acceleration.
        rows: the segments that ``busy_ns`` is of, without standstills, where it is not of others; None for all,
            with standstills.
    """

    busy_ns: Nanoseconds
    fails: npt.NDArray[np.bool_]
    standstills: tuple[Standstills, ...] = ()
    speed_override: Array = field(default_factory=lambda: np.empty((0, 0)))
    rows: Indices | None = None

    def completing(self) -> SegmentTimes:
        """Keep the replications in which no task fails for good."""
        return self.some(np.flatnonzero(~self.fails)) if self.fails.any() else self

    def some(self, columns: Indices) -> SegmentTimes:
        """Keep some replications, in ascending order."""
        place = np.full(len(self.fails), -1)
        place[columns] = np.arange(len(columns))
        kept = []
        for group in self.standstills:
            own = place[group.column] >= 0
            kept.append(
                Standstills(
                    group.cause,
                    group.node[own],
                    place[group.column[own]],
                    group.duration_ns[own],
                )
            )
        override = self.speed_override
        if len(override):
            override = override[:, columns]
        return SegmentTimes(
            self.busy_ns[:, columns],
            self.fails[columns],
            tuple(kept),
            override,
            self.rows,
        )

    def stood_ns(self, cause: Cause | None = None) -> Nanoseconds:
        """Return the standstill time of each segment, for one cause or all, shaped as ``busy_ns`` [ns]."""
        stood = np.zeros_like(self.busy_ns)
        for group in self.standstills:
            if cause in (None, group.cause):
                np.add.at(stood, (group.node, group.column), group.duration_ns)
        return stood


class NodeTimeSampler:
    """Draws the node times of one graph for any number of replications.

    Args:
        tpg: the graph.
        durations, disturbances: the distributions.
        names: of the draws of tasks that are not named by themselves, by index.

    Attributes:
        skills: the draws of skills among them.
        disturbed: chains whose nodes may take longer than their skills say, or fail.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        durations: SkillDurations,
        disturbances: Disturbances,
        names: Mapping[int, TaskName] = MappingProxyType({}),
    ) -> None:
        self._tpg = tpg
        self.skills = durations.bind(tpg, names)
        self._disturbances = disturbances
        machines = tpg.machine_chains()
        self._by_chain = [
            disturbances.of_machine(chain.robot) if k in machines else disturbances
            for k, chain in enumerate(tpg.chains)
        ]
        self._chains = [RobotTaskNodes(tpg, chain, names) for chain in tpg.chains]
        self._scales_drives = is_driven(tpg) and disturbances.speed != Speed()
        self.disturbed: list[int] = [
            k
            for k, (chain, own) in enumerate(
                zip(tpg.chains, self._by_chain, strict=True)
            )
            if self._scales_drives or own.vary_durations(chain.robot)
        ]
        # A transit that is drawn quicker than planned stays within its joints' speed limits.
        self._floor = [
            np.where(chain.moves, np.minimum(least, nominal), 0)
            for chain, least, nominal in zip(
                self._chains, least_ns(tpg), nominal_ns(tpg), strict=True
            )
        ]
        nodes = max((len(chain) for chain in tpg.chains), default=1)
        self._most_replications = max(_MOST_VALUES // max(nodes, 1), 1)

    def sample(self, *, seed: int, replication: int = 0) -> NodeTimes:
        """Draw one replication."""
        moves, stalls, stands, fails, loses = [], [], [], [], []
        overrides = []
        numbers = np.array([replication])
        totals = self.skills.totals(seed=seed, replications=numbers)
        drawn = self._draw(range(len(self._chains)), seed, numbers, totals)
        for motion, found, failed, lost, override in drawn:
            stood = np.zeros(len(motion), dtype=np.int64)
            entries = []
            for group in found:
                np.add.at(stood, group.node, group.duration_ns)
                pairs = zip(
                    group.node.tolist(), group.duration_ns.tolist(), strict=True
                )
                entries += [
                    Standstill(node, group.cause, duration)
                    for node, duration in pairs
                    if duration > 0 or group.cause == "retry"
                ]
            moves.append(np.ascontiguousarray(motion[:, 0]))
            stalls.append(stood)
            stands.append(tuple(sorted(entries, key=lambda entry: entry.node)))
            fails.append(int(failed[0]))
            loses.append(bool(lost[0]))
            overrides.append(override[:, 0])
        stops = draw_stops(
            self._tpg, self._disturbances, seed=seed, replication=replication
        )
        return NodeTimes(
            tuple(moves),
            tuple(stalls),
            tuple(stands),
            tuple(fails),
            stops,
            self.skills.raised(seed=seed, replication=replication),
            frozenset(np.flatnonzero(loses).tolist()),
            tuple(overrides) if self._scales_drives else (),
        )

    def sample_segments(
        self,
        contraction: Contraction,
        *,
        seed: int,
        replications: npt.ArrayLike,
        chains: Sequence[int] | None = None,
        totals: Nanoseconds | None = None,
    ) -> SegmentTimes:
        """Draw many replications, as sums over the segments of the contracted graph.

        Args:
            contraction: the contracted graph.
            seed: names the draws.
            replications: numbers of the replications.
            chains: those whose nodes are drawn, by index; by default all. With them the times have ``rows``.
            totals: duration of every task that varies, where known, shape (tasks, replications) [ns].
        """
        numbers = np.asarray(replications, dtype=np.int64)
        which = range(len(self._chains)) if chains is None else chains
        offsets = np.cumsum([0, *(len(first) - 1 for first in contraction.first)])
        segments = [np.arange(offsets[k], offsets[k + 1]) for k in which]
        borders = np.cumsum([0, *map(len, segments)]).tolist()
        if totals is None:
            totals = self.skills.totals(seed=seed, replications=numbers)
        busy = np.empty((borders[-1], len(numbers)), dtype=np.int64)
        fails = np.zeros(len(numbers), dtype=np.bool_)
        stands: list[Standstills] = []
        scaled = np.ones(busy.shape if self._scales_drives else (0, 0))
        for low in range(0, len(numbers), self._most_replications):
            part = slice(low, low + self._most_replications)
            drawn = self._draw(which, seed, numbers[part], totals[:, part])
            for k, begin, end, (motion, found, failed, _, override) in zip(
                which, borders[:-1], borders[1:], drawn, strict=True
            ):
                first, own = contraction.first[k], slice(begin, end)
                if self._scales_drives:  # no segment is longer than a node then
                    scaled[own, part] = override
                rows = busy[own, part]
                if len(rows):
                    np.add.reduceat(motion, first[:-1], axis=0, out=rows)
                for group in found:
                    segment = np.searchsorted(first, group.node, side="right") - 1
                    if chains is None:
                        np.add.at(rows, (segment, group.column), group.duration_ns)
                    node, column = offsets[k] + segment, low + group.column
                    stands.append(replace(group, node=node, column=column))
                fails[part] |= failed >= 0
        known = None if chains is None else np.concatenate(segments)
        return SegmentTimes(busy, fails, tuple(stands), scaled, known)

    def _draw(
        self, which: Sequence[int], seed: int, numbers: Indices, totals: Nanoseconds
    ) -> Iterator[
        tuple[Nanoseconds, list[Standstills], Indices, npt.NDArray[np.bool_], Array]
    ]:
        """Yield motion, standstills, nodes that fail for good, whether they lose the object, and speed overrides.

        Of some chains, by index, with the durations of tasks that vary.
        """
        busy_ns = np.zeros(len(numbers))
        for k in which:
            floor = self._floor[k]
            draws = ChainDraws(self._chains[k], seed, numbers, self._by_chain[k])
            motion = draws.motion(self.skills.durations(k, totals), floor)
            found = draws.standstills(motion)
            attempts, failed, lost = draws.failures(motion)
            busy_ns += motion.sum(axis=0, dtype=float)
            for group in found + attempts:
                np.add.at(busy_ns, group.column, group.duration_ns.astype(float))
            require_within_longest_run(busy_ns.max(initial=0.0))
            override = draws.speed_override
            if override is None:
                override = np.ones((len(floor), 1))
            yield motion, found + attempts, failed, lost, override
