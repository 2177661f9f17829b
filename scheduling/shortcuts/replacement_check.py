"""Conflicts of replacement nodes with other robots' nodes, and the edges they require.

New nodes are checked against every node of another robot that is not ordered with all of them
already, against robots that stand meanwhile and objects at rest; ``scenery`` knows what never
moves. Of two that conflict, the one that is earlier in the total order goes first; a new node has
the place of the one that it replaces.

Edges and chains after nodes were replaced (APEX-MR IV-C, extended to N robots).

In-edges of the replaced nodes go to the last new node, out-edges of all but the last one start
at the node before. An order u -> a_p ... a_q -> w with p <= q held through the replaced nodes;
with the edges moved apart it would be lost, so u -> w is added.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    GraphStretch,
    StretchConflicts,
    holds_stretch,
    nodes_stretch,
    rest_stretch,
)
from scheduling.conflicts.object_spans import while_at_rest
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    Causes,
    NodeChain,
    TemporalPlanGraph,
    joined_corners,
)
from scheduling.graph.total_order import planned_ranks, reduce_again, with_edges
from scheduling.shortcuts.candidates import Span

Edge = tuple[int, int, int, int]
"""Robot and node that must be complete, robot and node that may then start."""


@dataclass(frozen=True)
class Swap:
    """Nodes ``first`` to ``last`` of a chain become as many others.

    There is a node before ``first``. The last new node stands for the last replaced one: it
    ends where that ended. The replaced nodes handle nothing.
    """

    chain: int
    first: int
    last: int

    @property
    def count(self) -> int:
        """Number of the nodes."""
        return self.last - self.first + 1


def rewire(
    graph: DerivedTpg, swap: Swap, new: NodeChain, edges: Sequence[Edge]
) -> DerivedTpg:
    """Return the graph with nodes replaced by as many others; what stays is not worked out again.

    Args:
        graph: the graph before.
        swap: which nodes of which chain.
        new: the nodes that take their place.
        edges: that these need, the new nodes numbered from ``swap.first``; they follow the total
            order, which stays as it is.
    """
    tpg, extra = graph.tpg, np.array(edges, dtype=np.int64).reshape(-1, 4)
    moved, cause = splice_edges(tpg.edges, tpg.cause, swap)
    wanted = np.concatenate([moved, extra])
    cause = np.append(cause, np.full(len(extra), MOTION_CONFLICT, dtype=np.uint8))
    chains = list(tpg.chains)
    chains[swap.chain] = _replaced(chains[swap.chain], swap, new)
    flat = with_edges(graph.flat, wanted)
    order, keep = reduce_again(flat, graph.order, _changed_nodes(graph, wanted))
    kept = wanted[keep]
    after = replace(tpg, chains=tuple(chains), edges=kept, cause=cause[keep])
    same = ("ranks", "history", "spans")
    return graph.derive(after, *same, order=order, flat=with_edges(flat, kept))


IN_PLACE, LATE, EARLY = "in place", "late", "early"
"""Where new nodes stand in the total order: where those that they replace did, right before the
last of these, or right after the first."""


def in_order(graph: DerivedTpg, chain: int, run: range, place: str) -> DerivedTpg:
    """Return the graph with some nodes of a chain elsewhere in the total order.

    They are to be replaced, and so have no edges that matter; the first and the last of them stay.

    Args:
        graph: the graph.
        chain: the chain.
        run: its nodes.
        place: IN_PLACE, LATE or EARLY.
    """
    if place == IN_PLACE:
        return graph
    nodes, first, last = graph.tpg.chains[chain], run[0], run[-1]
    planned = nodes.planned_start.copy()
    planned[first:last] = planned[last] if place == LATE else planned[first]
    chains = list(graph.tpg.chains)
    chains[chain] = replace(nodes, planned_start=planned)
    ranks = planned_ranks(chains)
    flat = graph.flat._replace(order=np.argsort(np.concatenate(ranks)))
    same = ("history", "spans", "order", "rollout")
    moved = replace(graph.tpg, chains=tuple(chains))
    return graph.derive(moved, *same, ranks=ranks, flat=flat)


def _replaced(chain: NodeChain, swap: Swap, new: NodeChain) -> NodeChain:
    """Return a chain with as many other pose nodes in the place of some."""
    begin, stop = swap.first, swap.last + 1
    low, high = int(chain.first[begin]), int(chain.first[stop])
    shift = len(new.waypoints) - (high - low)
    duration = chain.duration.copy()
    duration[begin:stop] = new.duration
    kept = None if chain.corners is None else chain.corners.outside(begin, stop)
    return replace(
        chain,
        waypoints=np.vstack(
            [chain.waypoints[:low], new.waypoints, chain.waypoints[high:]]
        ),
        fraction=np.concatenate(
            [chain.fraction[:low], new.fraction, chain.fraction[high:]]
        ),
        first=np.concatenate(
            [chain.first[:begin], low + new.first, chain.first[stop + 1 :] + shift]
        ),
        duration=duration,
        corners=joined_corners((kept, 0), (new.corners, begin)),
    )


def _changed_nodes(graph: DerivedTpg, edges: Indices) -> npt.NDArray[np.bool_]:
    """Return which nodes, chain by chain, may have other edges into them than in a graph before."""
    first, old = graph.flat.first, graph.tpg.edges
    changed = np.zeros(len(graph.flat.chain), dtype=np.bool_)
    moved = np.any(edges[: len(old)] != old, axis=1)
    for rows in (old[moved], edges[: len(old)][moved], edges[len(old) :]):
        changed[first[rows[:, 2]] + rows[:, 3]] = True
    return changed


def splice_edges(edges: Indices, cause: Causes, swap: Swap) -> tuple[Indices, Causes]:
    """Return the edges after nodes were replaced.

    Args:
        edges: type-2 edges, shape (e, 4).
        cause: of each, shape (e,).
        swap: the nodes.
    """
    first, last = swap.first, swap.last
    out = edges.copy()
    into = (edges[:, 2] == swap.chain) & (first <= edges[:, 3]) & (edges[:, 3] <= last)
    out[into, 3] = last
    outof = (edges[:, 0] == swap.chain) & (first <= edges[:, 1]) & (edges[:, 1] < last)
    out[outof, 1] = first - 1
    added = [
        (*edges[i, :2].tolist(), *edges[o, 2:].tolist())
        for i in np.flatnonzero(into).tolist()
        for o in np.flatnonzero(outof).tolist()
        if edges[i, 3] <= edges[o, 1] and edges[i, 0] != edges[o, 2]
    ]
    if not added:
        return out, cause
    return (
        np.concatenate([out, np.array(added, dtype=np.int64)]),
        np.append(cause, np.full(len(added), MOTION_CONFLICT, dtype=np.uint8)),
    )


class Rivals:
    """Other robots' nodes that are not ordered with all of some new nodes, and their conflicts.

    Those that come before the first replaced node, or after the last one, go before or after all
    new nodes wherever these stand in the total order: they are searched once. Edges (robot, node,
    robot, node) have the new nodes numbered from ``swap.first``.

    Args:
        graph: the graph.
        pieces: occupancies of its chains.
        swap: the nodes that are to be replaced.
        new: the new nodes, numbered from 0.
    """

    def __init__(
        self, graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: GraphStretch
    ) -> None:
        self._graph, self._pieces, self._swap, self._new = graph, pieces, swap, new
        chain, first, last = swap.chain, swap.first, swap.last
        self._between: dict[int, tuple[int, int]] = {}
        self.outside: list[Edge] = []
        ends = graph.ranks[chain][[first, last]]
        for other in range(len(graph.tpg.chains)):
            if other == chain:
                continue
            done = int(graph.order.of(chain)[first - 1, other])
            after = int(graph.order.first_after(chain, other, np.array([last]))[0])
            turns = np.searchsorted(graph.ranks[other], ends)
            low, high = np.clip(turns, done + 1, after).tolist()
            self._between[other] = low, high
            ones = np.ones(swap.count, dtype=np.int64)
            self.outside += self._go_first(other, done + 1, low * ones)
            self.outside += self._wait(other, high * ones, after)

    @property
    def choice(self) -> bool:
        """True if it matters where the new nodes stand in the total order."""
        return any(low < high for low, high in self._between.values())

    def edges(self, ordered: DerivedTpg) -> list[Edge]:
        """Return the type-2 edges that the new nodes require.

        Args:
            ordered: the graph, with the nodes that are to be replaced where the new ones are to
                stand in the total order.
        """
        swap, found = self._swap, list(self.outside)
        own = ordered.ranks[swap.chain][swap.first : swap.last + 1]
        for other, (low, high) in self._between.items():
            if low < high:
                # Of the other's nodes, how many come before each new node.
                turn = np.clip(np.searchsorted(ordered.ranks[other], own), low, high)
                found += self._go_first(other, low, turn)
                found += self._wait(other, turn, high)
        return found

    def _go_first(self, other: int, first: int, turn: Indices) -> list[Edge]:
        """Return edges from nodes of another robot from ``first`` up to each new node's turn."""
        edges, chain, at_least = [], self._swap.chain, self._swap.first
        search = self._pieces.conflicts.search
        between = self._pieces.between(self._graph, other, first, int(turn[-1]))
        for at, piece in between:
            floor = np.full(self._swap.count, first - 1 - at)
            limit = np.minimum(turn - at, piece.nodes)
            for v, u in search(self._graph, self._new, piece, (floor, limit)):
                edges.append((other, at + u, chain, at_least + v))
        return edges

    def _wait(self, other: int, turn: Indices, stop: int) -> list[Edge]:
        """Return edges to nodes of another robot from each new node's turn up to ``stop``."""
        edges, swap, search = [], self._swap, self._pieces.conflicts.search
        for at, piece in self._pieces.between(self._graph, other, int(turn[0]), stop):
            nodes = at + np.arange(piece.nodes)
            inside = nodes < stop
            asked = np.searchsorted(turn, nodes, side="right")
            floor = np.where(inside, -1, swap.count)
            limit = np.where(inside, asked, swap.count)
            for w, x in search(self._graph, piece, self._new, (floor, limit)):
                edges.append((swap.chain, swap.first + x, other, at + w))
        return edges


def stands_stay_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: GraphStretch
) -> bool:
    """Tell whether new nodes and robots that stand keep apart, in the graph that has them.

    New nodes may now fall into a stand of another robot, or meet what it has been given while it
    stands, and another robot's nodes may fall into the stands before and between the new nodes.
    Every other stand is as it was.

    Args:
        graph: with the new nodes.
        pieces: occupancies of its chains; those of the new nodes' chain are not looked at.
        swap: the new nodes.
        new: the same, numbered from 0.
    """
    return all(
        _clear_of_stands(graph, pieces, swap, new, other)
        and _stand_clear(graph, pieces, swap, other)
        for other in range(len(graph.tpg.chains))
        if other != swap.chain
    ) and _gifts_stay_clear(graph, pieces, swap, new)


def _clear_of_stands(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: GraphStretch, other: int
) -> bool:
    """Tell whether new nodes keep clear of another robot wherever it stands meanwhile."""
    nodes = np.arange(swap.first, swap.first + swap.count)
    before = graph.order.of(swap.chain)[nodes, other]
    after = graph.order.first_after(swap.chain, other, nodes)
    stands = before + 1 == after
    for hold in np.unique(after[stands]).tolist():
        from_here = np.flatnonzero(stands & (after == hold))[0]
        limit = (np.arange(swap.count) >= from_here).astype(np.int64)
        floor = np.full(swap.count, -1)
        standing = holds_stretch(graph, other, np.array([hold]))
        if not pieces.conflicts.are_clear(graph, new, standing, (floor, limit)):
            return False
    return True


def _stand_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, other: int
) -> bool:
    """Tell whether another robot keeps clear of the stands before each of the new nodes."""
    chain = swap.chain
    holds = np.arange(swap.first, swap.first + swap.count)
    waits_for = np.ascontiguousarray(graph.order.of(other)[:, chain])
    first = np.searchsorted(waits_for, holds - 1, side="left")
    stop = np.minimum(
        np.searchsorted(waits_for, holds - 1, side="right"),
        graph.order.of(chain)[holds, other] + 1,
    )
    met = first < stop
    if not np.any(met):
        return True
    first, stop = first[met], stop[met]
    standing = holds_stretch(graph, chain, holds[met])
    return all(
        pieces.conflicts.are_clear(graph, standing, piece, (first - 1 - at, stop - at))
        for at, piece in pieces.between(graph, other, int(first[0]), int(stop[-1]))
    )


def _gifts_stay_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: GraphStretch
) -> bool:
    """Tell whether new nodes keep clear of objects handed to robots that stand.

    Such an object is in the robot's hand only from its next node on: its stand does not show it.
    """
    nodes = len(graph.tpg.chains[swap.chain])
    for rest in graph.history.rests:
        if rest.holder is None:
            continue
        floor, limit = while_at_rest(graph.order, rest, swap.chain, nodes)
        floor, limit = max(floor - swap.first, -1), min(limit - swap.first, swap.count)
        if floor + 1 >= limit:
            continue
        window = np.full(1, floor), np.full(1, limit)
        lying = rest_stretch(graph, rest)
        if not pieces.conflicts.are_clear(graph, lying, new, window):
            return False
    return True


_LONGEST = 128
"""Nodes in a piece."""


class GraphPieces:
    """All chains of a graph, cut so that every run that may be shortened is pieces of its own.

    Args:
        tpg: the graph.
        spans: the runs.
        conflicts: searches conflicts between pieces and others, or knows them already.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        spans: Sequence[Span],
        conflicts: StretchConflicts | None = None,
    ) -> None:
        self.conflicts = conflicts or StretchConflicts()
        self._starts: list[Indices] = []
        self._built: list[list[GraphStretch | None]] = []
        for k, chain in enumerate(tpg.chains):
            cuts = {0, len(chain)}
            for span in spans:
                if span.chain == k:
                    cuts |= {span.first, span.last + 1}
            starts = [0]
            for low, high in pairwise(sorted(cuts)):
                parts = -(-(high - low) // _LONGEST)
                starts += np.linspace(low, high, parts + 1).astype(int)[1:].tolist()
            self._starts.append(np.array(starts, dtype=np.int64))
            self._built.append([None] * (len(starts) - 1))

    def between(
        self, graph: DerivedTpg, chain: int, first: int, stop: int
    ) -> Iterator[tuple[int, GraphStretch]]:
        """Yield the first node of every piece with nodes in a range, and the piece.

        Args:
            graph: as it is now.
            chain: the chain.
            first, stop: its nodes ``range(first, stop)``.
        """
        starts = self._starts[chain]
        lo = int(np.searchsorted(starts, first, side="right")) - 1
        for piece, (at, end) in enumerate(pairwise(starts[lo:].tolist()), lo):
            if at >= stop:
                return
            built = self._built[chain][piece]
            if built is None:
                built = nodes_stretch(graph, chain, at, end)
                self._built[chain][piece] = built
            yield at, built

    def splice(self, swap: Swap) -> None:
        """Forget the pieces around nodes that were replaced."""
        starts = self._starts[swap.chain]
        lo = int(np.searchsorted(starts, swap.first, side="right")) - 1
        hi = int(np.searchsorted(starts, swap.last, side="right"))
        self._built[swap.chain][lo:hi] = [None] * (hi - lo)
