"""State of the shortcut search: transits that may be shortened, and the change of the graph by a candidate path."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planning.motion.speed import SpeedModel, path_duration
from planning.transforms import Array
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    OccupantConflicts,
    occupant_of_nodes,
)
from scheduling.graph.rollout import latest_ends
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.shortcuts.candidates import (
    CORNER,
    SHAPES,
    SMOOTH,
    candidate_path,
    find_spans,
    new_nodes,
    remove_waypoints_on_lines,
)
from scheduling.shortcuts.graph_pieces import GraphPieces
from scheduling.shortcuts.replacement_check import ReplacementConflicts
from scheduling.shortcuts.rewiring import (
    EARLY,
    IN_PLACE,
    LATE,
    Swap,
    reorder_nodes,
    rewire,
)
from scheduling.shortcuts.stand_check import are_standing_robots_clear
from scheduling.shortcuts.static_scene import SmoothedPathCache, StaticSceneCache

_SAME_MAKESPAN = 1e-9
"""Makespans that differ by less are the same [s]."""

_GAIN = 1e-6
"""Least duration that a shortcut saves in its chain [s]."""

_LEAST = 5e-5
"""Least duration that a shortcut saves in its chain, as a share of the makespan."""

_WORTH = 3e-4
"""Shortcutting continues while the candidates of a window shorten the makespan by this share."""

_FEWEST = 500
"""Least number of candidates in a window."""

_PASSES = 2
"""How often each span is smoothed as a whole."""

_SLACK = 1e-3
"""Nodes with less slack than this are critical for the makespan [s]."""


Candidate = tuple[int, int, int, Array]
"""Number of a span, its first and last node to replace, and the path in place of them."""


class ShortcutSearch:
    """Current graph, and the transit spans in it that may be shortened.

    Args:
        tpg: the graph.
        speeds: speed model of each robot.
        step: longest time between pose nodes [s].
        passes: how often each span is smoothed as a whole.
        known, conflicts: caches filled for other graphs; None to begin with empty ones.

    Attributes:
        graph: the current graph.
        spans: the transit spans.
        window: number of candidates after which progress is judged, see ``shorten_tpg``.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        speeds: Mapping[str, SpeedModel],
        step: float,
        *,
        passes: int = _PASSES,
        known: SmoothedPathCache | None = None,
        conflicts: OccupantConflicts | None = None,
    ) -> None:
        self.graph = DerivedTpg(tpg)
        self.spans = find_spans(self.graph)
        self._speeds = speeds
        self._step = step
        self._scenery = StaticSceneCache(known)
        self._pieces = GraphPieces(tpg, self.spans, conflicts)
        self.window = max(_FEWEST, len(self.spans) // 2)
        self._least = max(_GAIN, _LEAST * self.makespan)
        self._tried: set[int] = set()
        self._smoothing = False
        self._passes = passes
        self._parts: list[tuple[int, int, int]] = []
        self._excess = np.array([self._span_excess(k) for k in range(len(self.spans))])
        self._critical = self._find_critical()

    @property
    def makespan(self) -> float:
        """Makespan of the current graph [s]."""
        return float(self.graph.rollout.makespan)

    def has_saved_enough(self, before: float) -> bool:
        """Tell whether the makespan is shorter than before by enough to continue [s]."""
        return before - self.makespan >= _WORTH * self.makespan

    @property
    def searched(self) -> bool:
        """True once every critical span has been smoothed as a whole in all passes."""
        return self._passes == 0

    def step(self, rng: np.random.Generator) -> None:
        """Draw a candidate, and accept it if it is an improvement; queue parts of a refused one."""
        drawn = self.draw(rng)
        if drawn is not None:
            accepted = self.try_candidate(*drawn)
            if self._smoothing and not accepted:
                self._split(*drawn[:3])

    def _span_excess(self, which: int) -> float:
        span = self.spans[which]
        return self._saving_bound(span.chain, span.first, span.last)

    def _find_critical(self) -> list[int]:
        graph, flat = self.graph, self.graph.flat
        latest = latest_ends(graph.tpg, graph.rollout, flat=flat)
        slack = np.concatenate(latest) - np.concatenate(graph.rollout.end)
        tight = np.concatenate([[0], np.cumsum(slack < _SLACK)])
        first = np.array([flat.first[s.chain] + s.first for s in self.spans], np.int64)
        last = np.array([flat.first[s.chain] + s.last for s in self.spans], np.int64)
        return np.flatnonzero(tight[last + 1] > tight[first]).tolist()

    def draw(self, rng: np.random.Generator) -> Candidate | None:
        """Return a transit span, the nodes of it to replace, and the new path, or None."""
        if not self._critical:
            self._passes = 0
            return None
        part = self._next_part()
        self._smoothing = part is not None
        if part is not None:
            return self._smoothed(*part, rng)
        excess = np.maximum(self._excess[self._critical], 0.0)
        total = np.cumsum(excess)
        if total[-1] < self._least:
            return None
        at = int(np.searchsorted(total, rng.random() * total[-1], side="right"))
        which = self._critical[min(at, len(total) - 1)]
        span = self.spans[which]
        first, last = span.first, span.last
        shape = SHAPES[int(rng.integers(len(SHAPES)))]
        if shape != CORNER or rng.random() < 0.5:
            first, last = np.sort(
                rng.integers(span.first, span.last + 1, size=2)
            ).tolist()
        if shape == SMOOTH:
            return self._smoothed(which, first, last, rng)
        if self._saving_bound(span.chain, first, last) < self._least:
            return None
        path = candidate_path(self.waypoints(span.chain, first, last), shape, rng)
        return self._faster_candidate(which, first, last, path)

    def _next_part(self) -> tuple[int, int, int] | None:
        """Return a part of a transit span to smooth: halves of refused parts, else a whole span."""
        if self._parts:
            return self._parts.pop()
        fresh = [k for k in self._critical if k not in self._tried]
        if not fresh and self._passes:
            # In another pass, the spans of other robots are no longer where they were.
            self._passes -= 1
            if self._passes:
                self._tried.clear()
                fresh = self._critical
        if not fresh:
            return None
        which = fresh[int(np.argmax(self._excess[fresh]))]
        self._tried.add(which)
        return which, self.spans[which].first, self.spans[which].last

    def _smoothed(
        self, which: int, first: int, last: int, rng: np.random.Generator
    ) -> Candidate | None:
        """Return a candidate shortened as far as possible, checked against static obstacles only."""
        chain = self.spans[which].chain
        if self._saving_bound(chain, first, last) < self._least:
            return None
        scene = self._scenery.scene_during(self.graph, chain, first, last)
        speed = self._speeds[self.graph.tpg.chains[chain].robot]
        old = remove_waypoints_on_lines(self.waypoints(chain, first, last))
        path = scene.smoothed(old, speed, rng)
        return self._faster_candidate(which, first, last, path)

    def _split(self, which: int, first: int, last: int) -> None:
        """Queue the halves of nodes that could not be replaced as a whole, if they are many."""
        span = self.spans[which]
        count = last - first + 1
        if count >= (span.last - span.first + 1) // 3 and count >= 8:
            half, quarter = count // 2, count // 4
            self._parts += [
                (which, first + quarter, first + quarter + half),
                (which, first + half, last),
                (which, first, first + half),
            ]

    def _saving_bound(self, chain: int, first: int, last: int) -> float:
        """Return an upper bound of the saving: that of a straight line [s]."""
        if last <= first:
            return 0.0
        nodes, path = self.graph.tpg.chains[chain], self.waypoints(chain, first, last)
        direct = self._speeds[nodes.robot].duration(path[0], path[-1])
        return float(nodes.duration[first : last + 1].sum()) - direct

    def waypoints(self, chain: int, first: int, last: int) -> Array:
        """Return the waypoints from the start of a node to the end of another."""
        nodes = self.graph.tpg.chains[chain]
        return nodes.waypoints[nodes.first[first] - 1 : nodes.first[last + 1]]

    def _faster_candidate(
        self, which: int, first: int, last: int, path: Array
    ) -> Candidate | None:
        """Return a candidate if it is faster than the nodes that it replaces."""
        chain = self.graph.tpg.chains[self.spans[which].chain]
        seconds = path_duration(path, self._speeds[chain.robot])
        saved = float(chain.duration[first : last + 1].sum()) - seconds
        if saved < self._least or seconds < _GAIN:
            return None
        return which, first, last, path

    def try_candidate(
        self,
        which: int,
        first: int,
        last: int,
        path: Array,
        *,
        sooner: float | None = None,
    ) -> bool:
        """Accept a candidate if it is free, has a place in the order, and does not increase the makespan.

        Args:
            which: the span.
            first, last: nodes of it that would be replaced.
            path: that would replace them, shape (w, n).
            sooner: least reduction of the makespan [s]; the candidate is then tried at all
                places in the order. None if none is required.
        """
        graph, index = self.graph, self.spans[which].chain
        chain = graph.tpg.chains[index]
        if not self._scenery.scene_during(graph, index, first, last).free(path):
            return False
        new = new_nodes(chain, first, last, path, self._speeds[chain.robot], self._step)
        if new is None:
            return False
        swap = Swap(index, first, last)
        occupant = occupant_of_nodes(graph, index, first, last + 1, new)
        conflicts_of_new = ReplacementConflicts(graph, self._pieces, swap, occupant)
        # Other places in the order are tried only for candidates that may save much.
        choice = conflicts_of_new.choice and (self._smoothing or sooner is not None)
        latest = self.makespan + (_SAME_MAKESPAN if sooner is None else -sooner)
        places = (IN_PLACE, LATE, EARLY) if choice else (IN_PLACE,)
        if choice and self._ends_late(
            rewire(graph, swap, new, conflicts_of_new.outside), latest
        ):
            return False
        for place in places:
            ordered = reorder_nodes(graph, index, range(first, last + 1), place)
            candidate = rewire(ordered, swap, new, conflicts_of_new.edges(ordered))
            if self._ends_late(candidate, latest):
                continue
            if are_standing_robots_clear(candidate, self._pieces, swap, occupant):
                self._accept(candidate, which, swap)
                return True
        return False

    @staticmethod
    def _ends_late(candidate: DerivedTpg, latest: float) -> bool:
        """Tell whether a plan would exceed its allowed end [s]."""
        return candidate.rollout.makespan > latest

    def _accept(self, candidate: DerivedTpg, which: int, swap: Swap) -> None:
        self.graph = candidate
        self._pieces.replace_nodes(swap)
        self._excess[which] = self._span_excess(which)
        self._critical = self._find_critical()
