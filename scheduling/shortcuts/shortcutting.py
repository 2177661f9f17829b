"""Shortcutting of a temporal plan graph (APEX-MR IV-C): anytime, seeded, HOME skipped.

A candidate joins two places of a run of transits by a straight line, goes over a corner between
them, or straightens a single joint. It is taken when it is free, when it can be ordered with
everyone else's nodes, and when the plan does not end later. Only runs that the makespan hangs on
are drawn: elsewhere a robot would move less only to wait more. Each is first tried as a whole.
The budget is a number of candidates, so the same seed gives the same plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from planning.errors import PlanInvariantError
from planning.motion.speed import SpeedModel, path_duration
from planning.transforms import Array
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.rollout import latest_ends
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.shortcuts.candidates import (
    CORNER,
    LINE,
    SHAPES,
    candidate_path,
    find_spans,
    new_nodes,
)
from scheduling.shortcuts.replacement_check import (
    Pieces,
    Scenery,
    order_against,
    stands_stay_clear,
)
from scheduling.shortcuts.rewiring import Swap, rewire

_LATER = 1e-9
"""Makespans that differ by less are the same [s]."""

_GAIN = 1e-6
"""Least time that a shortcut has to save its robot [s]."""

_SLACK = 1e-3
"""The makespan hangs on nodes that could end less than this later [s]."""


def shorten_tpg(
    tpg: TemporalPlanGraph,
    speeds: Mapping[str, SpeedModel],
    *,
    step: float,
    candidates: int,
    seed: int = 0,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> TemporalPlanGraph:
    """Return a graph with runs of transit nodes replaced by shorter ones.

    It is the same graph where no replacement was found.

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
    board = Board(tpg, speeds, step)
    rng = np.random.default_rng(seed)
    for done in range(candidates):
        drawn = board.draw(rng)
        if drawn is not None:
            board.try_candidate(*drawn)
        if done % 16 == 0:
            progress(done, candidates)
    progress(candidates, candidates)
    shortened = board.graph.tpg
    if shortened is not tpg:
        check_invariant(DerivedTpg(shortened))
    return shortened


class Board:
    """The graph as it is now, and the runs of it that may be shortened.

    Args:
        tpg: the graph.
        speeds: speed model of each robot.
        step: longest time between pose nodes [s].

    Attributes:
        graph: as it is now.
        spans: the runs.
    """

    def __init__(
        self, tpg: TemporalPlanGraph, speeds: Mapping[str, SpeedModel], step: float
    ) -> None:
        self.graph = DerivedTpg(tpg)
        self.spans = find_spans(self.graph)
        self._speeds = speeds
        self._step = step
        self._scenery = Scenery()
        cuts: list[list[int]] = [[] for _ in tpg.chains]
        for span in self.spans:
            cuts[span.chain] += [span.first, span.last + 1]
        self._pieces = Pieces([len(chain) for chain in tpg.chains], cuts)
        self._whole = set(range(len(self.spans)))
        self._critical = self._find_critical()

    def _find_critical(self) -> list[int]:
        graph = self.graph
        latest = latest_ends(graph.tpg, graph.rollout, ranks=graph.ranks)
        slack = [a - b for a, b in zip(latest, graph.rollout.end, strict=True)]
        return [
            k
            for k, span in enumerate(self.spans)
            if np.any(slack[span.chain][span.first : span.last + 1] < _SLACK)
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
        span = self.spans[which]
        first, last = span.first, span.last
        if whole is None and (shape != CORNER or rng.random() < 0.5):
            first, last = np.sort(
                rng.integers(span.first, span.last + 1, size=2)
            ).tolist()
        if last - first < 1:
            return None
        chain = self.graph.tpg.chains[span.chain]
        old = chain.waypoints[chain.first[first] - 1 : chain.first[last + 1]]
        path = candidate_path(old, shape, rng)
        seconds = path_duration(path, self._speeds[chain.robot])
        saved = float(chain.duration[first : last + 1].sum()) - seconds
        if saved < _GAIN or seconds < _GAIN:
            return None
        return which, first, last, path

    def try_candidate(self, which: int, first: int, last: int, path: Array) -> bool:
        """Take a candidate if it is free, fits, and the plan does not end later.

        Args:
            which: the span.
            first, last: nodes of it that would be replaced.
            path: that would replace them, shape (w, n).
        """
        graph, index = self.graph, self.spans[which].chain
        chain = graph.tpg.chains[index]
        if not self._scenery.free(graph, index, first, last, path):
            return False
        new = new_nodes(chain, first, last, path, self._speeds[chain.robot], self._step)
        swap = Swap(index, first, last, len(new))
        occupancy = graph.occupancy(index, first, last + 1, new)
        edges = order_against(graph, self._pieces, swap, occupancy)
        try:
            candidate = rewire(graph, swap, new, edges)
        except PlanInvariantError:
            return False
        if candidate.rollout.makespan > graph.rollout.makespan + _LATER:
            return False
        if not stands_stay_clear(candidate, self._pieces, swap, occupancy):
            return False
        self.graph = candidate
        self._pieces.splice(swap)
        self.spans = [
            span
            if span.chain != index or span.last < first
            else replace(
                span,
                first=span.first if span.first <= first else span.first + swap.shift,
                last=span.last + swap.shift,
            )
            for span in self.spans
        ]
        self._critical = self._find_critical()
        return True
