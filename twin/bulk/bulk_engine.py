"""Bulk engine: simulation of many replications of a plan at the same time, without an event queue.

Completion times are longest paths in the precedence graph of the policy (see ``policy_graph``). For robots with
acceleration limits, ``driven_times`` computes them node by node; messages then take no time. If no event is
scheduled at a fixed time, the results equal those of the event engine to the nanosecond.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.parallel import map_in_parallel, usable_cores
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import is_driven, with_full_speed_times
from twin.bulk.driven_times import DrawnTimes, driven_times, joined_drives
from twin.bulk.max_plus import (
    Completions,
    PrecedenceArrays,
    end_times,
    explain_completions,
    makespans,
    policy_graph,
)
from twin.durations.nanoseconds import Nanoseconds, to_nanoseconds
from twin.engine.execution_model import UNLIMITED, ExecutionModel, Messages
from twin.uncertainty.chain_draws import Standstills
from twin.uncertainty.contraction import Contraction, contract
from twin.uncertainty.disturbances import Speed
from twin.uncertainty.node_times import NodeTimeSampler, SegmentTimes
from twin.uncertainty.skill_durations import SkillDraws, cumulative_shares


class _Shares(NamedTuple):
    """Shares of drawn tasks in the segments of a contraction.

    Attributes:
        fixed: time of each segment that does not vary, shape (segments,) [ns].
        segment, draw: a segment and the drawn task that is part of it, shape (shares,).
        low, high: which part of the task's total: ``rint(high * total) - rint(low * total)``.
    """

    fixed: Nanoseconds
    segment: Indices
    draw: Indices
    low: Array
    high: Array


class BulkEngine:
    """Executes one plan as often as asked, many replications at a time.

    Args:
        tpg: plan to execute, with the holds of the model, see ``with_model_holds``.
        model: execution model, with disturbances. Messages take no time, whatever it says, where
            robots keep to limits of acceleration.
        by_node: whether times are drawn and returned of every node where robots keep to such limits.

    Raises:
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
    """

    def __init__(
        self, tpg: TemporalPlanGraph, model: ExecutionModel, *, by_node: bool = False
    ) -> None:
        free = with_full_speed_times(tpg)
        self._sampler = NodeTimeSampler(free, model.durations, model.disturbances)
        # Open loop there are no messages.
        asking = Messages() if model.policy == "open-loop" else model.messages
        self._ahead = asking.ahead(driven=True)
        self.messages = model.messages.under(model.policy)
        self._by_node = by_node
        self._drawn_by = self.contraction = contract_for_bulk(tpg, model)
        self._drive = joined_drives(tpg) if is_driven(tpg) else None
        if self._drive is not None:
            every = self._ahead < UNLIMITED or model.policy == "open-loop"
            if not (by_node or every):
                opens = np.diff(self._drive.last, prepend=-1) != 0
                borders = np.cumsum([len(chain) for chain in tpg.chains])[:-1]
                self.contraction = contract(tpg, np.split(opens, borders))
        self._heads = self.contraction.heads()
        self.graph: PrecedenceArrays = policy_graph(self.contraction.tpg, model.policy)
        self._draws = self._sampler.skills
        self._shares = _shares(self._draws, self._drawn_by)

    def sample(self, *, seed: int, replications: npt.ArrayLike) -> SegmentTimes:
        """Draw the duration of every segment in some replications."""
        numbers = np.asarray(replications, dtype=np.int64)
        totals = self._draws.totals(seed=seed, replications=numbers)
        disturbed, count = self._sampler.disturbed, len(self._drawn_by.first)
        if not disturbed:
            return self._busy(totals)
        known = None if len(disturbed) == count else disturbed
        found = self._sampler.sample_segments(
            self._drawn_by,
            seed=seed,
            replications=numbers,
            chains=known,
            totals=totals,
        )
        return found if found.rows is None else self._with_undisturbed(found, totals)

    def execute(self, times: SegmentTimes) -> Completions:
        """Return all node times of replications without failed tasks."""
        return explain_completions(self.graph, *self.node_times(times))

    def node_times(self, times: SegmentTimes) -> tuple[Nanoseconds, Nanoseconds]:
        """Return start and end of every segment in such replications, shape (segments, replications) each [ns]."""
        if self._drive is None:
            end = end_times(self.graph, times.busy_ns, self.messages)
            return end - times.busy_ns, end
        start, end = self._driven(self._drawn(times))
        return start.T, end.T

    def standstills(self, times: SegmentTimes) -> list[Standstills]:
        """Return standstills by segment of the contraction."""
        if self._drawn_by is self.contraction:
            return list(times.standstills)
        return [
            replace(own, node=np.searchsorted(self._heads, own.node, side="right") - 1)
            for own in times.standstills
        ]

    def makespans(
        self, times: SegmentTimes, messages: Messages | None = None
    ) -> Nanoseconds:
        """Return the makespan of every such replication, shape (replications,) [ns].

        On all cores, where robots have acceleration limits: callers have no other work meanwhile.

        Args:
            times: of the segments.
            messages: in place of the model's.
        """
        if self._drive is None:
            said = self.messages if messages is None else messages
            return makespans(self.graph, end_times(self.graph, times.busy_ns, said))
        columns = np.array_split(np.arange(len(times.fails)), usable_cores())
        parts = (self._drawn(times.some(own)) for own in columns)
        ends = map_in_parallel(lambda part: self._driven(part)[1], parts)
        return makespans(self.graph, np.concatenate(ends).T)

    def _drawn(self, times: SegmentTimes) -> DrawnTimes:
        """Return the times of nodes, replications one after another in memory, as they are simulated."""
        rows, motion = times.rows, times.busy_ns
        if rows is None:
            rows = np.arange(len(motion))
            motion = motion - times.stood_ns() if times.standstills else motion
        none = np.empty(0, dtype=np.int64)
        stands = [(none, none, none)]
        stands += [(own.column, own.node, own.duration_ns) for own in times.standstills]
        column, node, lasting = map(np.concatenate, zip(*stands, strict=True))
        order = np.argsort(column, kind="stable")
        return DrawnTimes(
            self._shares.fixed,
            rows,
            np.ascontiguousarray(motion.T),
            np.searchsorted(column[order], np.arange(len(times.fails) + 1)),
            node[order],
            lasting[order],
            np.ascontiguousarray(times.speed_override.T),
        )

    def _driven(self, drawn: DrawnTimes) -> tuple[Nanoseconds, Nanoseconds]:
        """Return start and end of every segment, shape (replications, segments) each [ns]."""
        assert self._drive is not None
        return driven_times(self.graph, self._heads, self._drive, drawn, self._ahead)

    def _busy(self, totals: Nanoseconds) -> SegmentTimes:
        """Return the times of segments from those of skills, shape (tasks, r) [ns]."""
        none = np.zeros(totals.shape[1], dtype=np.bool_)
        nothing = np.empty((0, totals.shape[1]), dtype=np.int64)
        rows = np.empty(0, dtype=np.int64)
        return self._with_undisturbed(SegmentTimes(nothing, none, rows=rows), totals)

    def _with_undisturbed(
        self, drawn: SegmentTimes, totals: Nanoseconds
    ) -> SegmentTimes:
        """Return the times of some segments and of others from those of skills, shape (tasks, r) [ns].

        Of robots with limits, those of other segments that do not vary are left out.
        """
        assert drawn.rows is not None
        shares, rows = self._shares, None
        varied, own = np.unique(shares.segment, return_inverse=True)
        fixed = shares.fixed
        if self._drive is not None and not self._by_node:
            rows = np.union1d(varied, drawn.rows)
            fixed, place = fixed[rows], np.searchsorted(rows, varied)
            known = np.searchsorted(rows, drawn.rows)
        else:
            place, known = varied, drawn.rows
        busy = np.repeat(fixed[:, None], totals.shape[1], axis=1)
        _add_shares(totals, shares._replace(segment=place[own]), busy)
        busy[known] = drawn.busy_ns
        if rows is None:
            for group in drawn.standstills:
                np.add.at(busy, (group.node, group.column), group.duration_ns)
        return replace(drawn, busy_ns=busy, rows=rows)

    def least_makespan_ns(self) -> int:
        """Return the makespan with the shortest possible duration of every skill [ns].

        No undisturbed run is shorter.
        """
        totals = np.zeros((len(self._draws.tasks), 1), dtype=np.int64)
        for model, rows in self._draws.groups:
            totals[rows] = to_nanoseconds(model.minimum)
        return int(self.makespans(self._busy(totals))[0])


def contract_for_bulk(tpg: TemporalPlanGraph, model: ExecutionModel) -> Contraction:
    """Return a graph for the bulk engine, nodes merged where that changes no time.

    Where robots pass borders at speed, or messages take time, every node counts. By the planned clock
    a node that is done before its time is up keeps the next one waiting.
    """
    if is_driven(tpg) or not model.messages.under(model.policy).instant:
        return Contraction.trivial(tpg)
    if model.policy != "open-loop":
        return contract(tpg)
    if model.disturbances.speed != Speed():
        return Contraction.trivial(tpg)
    return contract(tpg, apart=[chain.skill for chain in tpg.chains])


def _shares(draws: SkillDraws, contraction: Contraction) -> _Shares:
    segment_of = [
        np.repeat(np.arange(len(first) - 1), np.diff(first))
        for first in contraction.first
    ]
    offsets = np.cumsum([0, *(len(first) - 1 for first in contraction.first)])
    fixed = [nominal.copy() for nominal in draws.nominal]
    rows: list[tuple[int, int, float, float]] = []
    for draw, (chain, nodes, weights) in enumerate(draws.nodes):
        fixed[chain][nodes] = 0
        # The parts of a total are differences of rounded cumulative shares, so the parts of a
        # segment add up to the difference at its borders.
        upto = np.concatenate([[0.0], cumulative_shares(weights)])
        own = segment_of[chain][nodes]
        cuts = np.flatnonzero(np.diff(own, prepend=-1, append=-1))
        for low, high in zip(cuts, cuts[1:], strict=False):
            segment = int(offsets[chain] + own[low])
            rows.append((segment, draw, float(upto[low]), float(upto[high])))
    sums = np.concatenate([*contraction.sums(fixed), np.empty(0, dtype=np.int64)])
    return _Shares(
        fixed=sums.astype(np.int64),
        segment=np.array([row[0] for row in rows], dtype=np.int64),
        draw=np.array([row[1] for row in rows], dtype=np.int64),
        low=np.array([row[2] for row in rows], dtype=float),
        high=np.array([row[3] for row in rows], dtype=float),
    )


@kernel
def _add_shares(totals: Nanoseconds, shares: _Shares, busy: Nanoseconds) -> None:
    for k in range(len(shares.segment)):
        segment, draw = shares.segment[k], shares.draw[k]
        for r in range(busy.shape[1]):
            total = float(totals[draw, r])
            part = np.rint(shares.high[k] * total) - np.rint(shares.low[k] * total)
            busy[segment, r] += np.int64(part)
