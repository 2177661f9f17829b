"""Shortcutting of a temporal plan graph (APEX-MR IV-C): anytime, seeded, HOME skipped.

A candidate joins two places of a run of transits by a straight line, goes over a corner between
them, or straightens a single joint. It is taken when it is free, when it can be ordered with
everyone else's nodes, and when the plan does not end later. Only runs that the makespan hangs on
are drawn: elsewhere a robot would move less only to wait more. Each is first tried as a whole.
The budget is a number of candidates, so the same seed gives the same plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.errors import PlanInvariantError
from planning.motion.speed import SpeedModel, path_duration
from planning.transforms import Array, Indices
from scheduling.conflicts.allowed_contacts import EntityNumbers, contact_table
from scheduling.conflicts.kept_occupancies import Pieces, occupancy_of
from scheduling.conflicts.object_spans import (
    ObjectHistory,
    shift_history,
    trace_objects,
)
from scheduling.conflicts.occupancy import Occupancy
from scheduling.graph.reduction import NodeOrder, order_and_reduce
from scheduling.graph.rollout import Rollout, earliest_times, latest_ends
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    NodeChain,
    TemporalPlanGraph,
)
from scheduling.graph.total_order import planned_ranks
from scheduling.invariant import check_invariant
from scheduling.shortcuts.candidate_paths import (
    CORNER,
    LINE,
    SHAPES,
    candidate_path,
    new_nodes,
    planned_after,
    splice_chain,
)
from scheduling.shortcuts.replacement_check import (
    Surroundings,
    holds_stay_clear,
    order_against,
)
from scheduling.shortcuts.rewiring import splice_edges, splice_index
from scheduling.shortcuts.scenery import Scenery
from scheduling.shortcuts.spans import Span, find_spans

_LATER = 1e-9
"""Makespans that differ by less are the same [s]."""

_GAIN = 1e-6
"""Least time that a shortcut has to save its robot [s]."""

_SLACK = 1e-3
"""The makespan hangs on nodes that could end less than this later [s]."""


@dataclass(frozen=True)
class ShortcutReport:
    """What shortcutting did.

    Attributes:
        tpg: the shortened graph.
        tried: candidates that would have been faster and were checked.
        taken: those that were taken.
        makespan_before_s, makespan_after_s: earliest ends at nominal durations [s].
    """

    tpg: TemporalPlanGraph
    tried: int
    taken: int
    makespan_before_s: float
    makespan_after_s: float


def shorten_tpg(
    tpg: TemporalPlanGraph,
    speeds: Mapping[str, SpeedModel],
    *,
    step: float,
    candidates: int,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> ShortcutReport:
    """Replace runs of transit nodes by shorter ones, as long as the budget lasts.

    Args:
        tpg: a graph that keeps its invariant.
        speeds: speed model of each robot.
        step: longest time between pose nodes [s].
        candidates: number of candidates drawn.
        seed: of the draws.
        progress: told candidates done and in all.

    Raises:
        PlanInvariantError: the result breaks the invariant, a fault of this program.
    """
    board = _Board(tpg, speeds, step)
    before = float(board.rollout.makespan)
    rng = np.random.default_rng(seed)
    tried = taken = 0
    for done in range(candidates):
        drawn = board.draw(rng)
        if drawn is not None:
            tried += 1
            taken += board.try_candidate(*drawn)
        if done % 16 == 0:
            progress(done, candidates)
    progress(candidates, candidates)
    if taken:
        check_invariant(board.tpg)
    return ShortcutReport(
        board.tpg, tried, taken, before, float(board.rollout.makespan)
    )


class _Board:
    """The graph as it is now, and what is derived from it."""

    def __init__(
        self, tpg: TemporalPlanGraph, speeds: Mapping[str, SpeedModel], step: float
    ) -> None:
        self.tpg = tpg
        self._speeds = speeds
        self._step = step
        handled = dict.fromkeys(handling.object for handling in tpg.handlings)
        self._entities = EntityNumbers((r.name for r in tpg.cell.robots), handled)
        self._table = contact_table(self._entities, tpg.allowed, tpg.cell.clearances)
        self._scenery = Scenery()
        self._ranks = planned_ranks(tpg.chains)
        self._order: NodeOrder = order_and_reduce(self._ranks, tpg.edges)[0]
        self._history: ObjectHistory = trace_objects(tpg, self._ranks)
        self._spans = find_spans(tpg, self._history.spans)
        cuts: list[list[int]] = [[] for _ in tpg.chains]
        for span in self._spans:
            cuts[span.chain] += [span.first, span.last + 1]
        self._pieces = Pieces(tpg, cuts, self._entities)
        self._whole = set(range(len(self._spans)))
        self._weigh(earliest_times(tpg))

    def _weigh(self, rollout: Rollout) -> None:
        """Note which spans the makespan hangs on."""
        self.rollout = rollout
        slack = latest_ends(self.tpg, rollout, ranks=self._ranks)
        self._critical = [
            k
            for k, span in enumerate(self._spans)
            if np.any(
                slack[span.chain][span.first : span.last + 1]
                - rollout.end[span.chain][span.first : span.last + 1]
                < _SLACK
            )
        ]

    def draw(self, rng: np.random.Generator) -> tuple[int, int, int, Array] | None:
        """Return a span, the nodes of it to replace, and the new path, or None."""
        if not self._critical:
            return None
        whole = next((k for k in self._critical if k in self._whole), None)
        if whole is not None:
            which, shape = whole, LINE
            self._whole.remove(which)
        else:
            which = self._critical[int(rng.integers(len(self._critical)))]
            shape = SHAPES[int(rng.integers(len(SHAPES)))]
        span = self._spans[which]
        first, last = span.first, span.last
        if whole is None and (shape != CORNER or rng.random() < 0.5):
            first, last = np.sort(
                rng.integers(span.first, span.last + 1, size=2)
            ).tolist()
        if last - first < 1:
            return None
        chain = self.tpg.chains[span.chain]
        old = chain.waypoints[chain.first[first] - 1 : chain.first[last + 1]]
        path = candidate_path(old, shape, rng)
        seconds = path_duration(path, self._speeds[chain.robot])
        saved = float(chain.duration[first : last + 1].sum()) - seconds
        if saved < _GAIN or seconds < _GAIN:
            return None
        return which, first, last, path

    def try_candidate(self, which: int, first: int, last: int, path: Array) -> bool:
        """Take a candidate if it is free, fits, and the plan does not end later."""
        index = self._spans[which].chain
        chain = self.tpg.chains[index]
        around = self._surroundings(self.tpg, self._ranks, self._order, self._history)
        if not self._scenery.free(around, index, first, last, path):
            return False
        new = new_nodes(chain, first, last, path, self._speeds[chain.robot], self._step)
        occupancy = occupancy_of(
            self.tpg,
            index,
            new,
            first,
            last - first + 1,
            self._history.spans,
            self._entities,
        )
        edges = order_against(around, index, first, last, occupancy, len(new))
        return self._replace(which, first, last, new, occupancy, edges)

    def _surroundings(
        self,
        tpg: TemporalPlanGraph,
        ranks: Sequence[Indices],
        order: NodeOrder,
        history: ObjectHistory,
    ) -> Surroundings:
        return Surroundings(
            tpg,
            ranks,
            order,
            history.spans,
            history.rests,
            self._pieces,
            self._entities,
            self._table,
        )

    def _replace(
        self,
        which: int,
        first: int,
        last: int,
        new: NodeChain,
        occupancy: Occupancy,
        edges: list[tuple[int, int, int, int]],
    ) -> bool:
        tpg, index, count = self.tpg, self._spans[which].chain, len(new)
        moved, cause = splice_edges(tpg.edges, tpg.cause, index, first, last, count)
        extra = np.array(edges, dtype=np.int64).reshape(-1, 4)
        chain = splice_chain(
            tpg.chains[index],
            first,
            last,
            replace(
                new,
                planned_start=planned_after(tpg.chains, index, first, last, new, edges),
            ),
        )
        chains = (*tpg.chains[:index], chain, *tpg.chains[index + 1 :])
        handlings = tuple(
            replace(h, node=splice_index(h.node, first, last, count))
            if h.robot == index
            else h
            for h in tpg.handlings
        )
        all_edges = np.concatenate([moved, extra])
        causes = np.concatenate(
            [cause, np.full(len(extra), MOTION_CONFLICT, dtype=np.uint8)]
        )
        try:
            ranks = planned_ranks(chains)
            order, keep = order_and_reduce(ranks, all_edges)
        except PlanInvariantError:
            return False
        all_edges, causes = all_edges[keep], causes[keep]
        by_edge = np.lexsort(all_edges.T[::-1])
        candidate = replace(
            tpg,
            chains=chains,
            handlings=handlings,
            edges=all_edges[by_edge],
            cause=causes[by_edge],
        )
        rollout = earliest_times(candidate, ranks=ranks)
        if rollout.makespan > self.rollout.makespan + _LATER:
            return False
        history = shift_history(self._history, index, first, last, count)
        around = self._surroundings(candidate, ranks, order, history)
        if not holds_stay_clear(around, index, first, occupancy, count):
            return False
        self.tpg, self._ranks, self._order = candidate, ranks, order
        self._history = history
        self._pieces.splice(index, first, last, count)
        shift = count - (last - first + 1)
        self._spans = [
            span
            if span.chain != index or span.last < first
            else Span(
                index,
                span.first if span.first <= first else span.first + shift,
                span.last + shift,
            )
            for span in self._spans
        ]
        self._weigh(rollout)
        return True
