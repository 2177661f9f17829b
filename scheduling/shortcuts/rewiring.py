"""Edges and node chains of a graph after some nodes of one robot are replaced.

The method is that of APEX-MR, section IV-C, extended to N robots. Incoming edges of the replaced nodes are moved
to the last new node. Outgoing edges of all replaced nodes but the last are moved to the node before the first. If
u preceded w along a path u -> a_p ... a_q -> w through replaced nodes a_p to a_q, the moved edges no longer imply
this order, so the edge u -> w is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    Causes,
    NodeChain,
    joined_corners,
)
from scheduling.graph.total_order import planned_ranks, update_reduction, with_edges

Edge = tuple[int, int, int, int]
"""Robot and node that must be complete, robot and node that may then start."""

IN_PLACE, LATE, EARLY = "in place", "late", "early"
"""Where new nodes stand in the total order: where those that they replace did, right before the
last of these, or right after the first."""


@dataclass(frozen=True)
class Swap:
    """Replacement of nodes ``first`` to ``last`` of a chain by as many others.

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
    """Return the graph after a replacement of nodes; unchanged parts are reused.

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
    order, keep = update_reduction(flat, graph.order, _changed_nodes(graph, wanted))
    kept = wanted[keep]
    after = replace(tpg, chains=tuple(chains), edges=kept, cause=cause[keep])
    same = ("ranks", "history", "spans")
    return graph.derive(after, *same, order=order, flat=with_edges(flat, kept))


def reorder_nodes(graph: DerivedTpg, chain: int, run: range, place: str) -> DerivedTpg:
    """Return the graph with some nodes of a chain moved in the total order.

    The nodes are replaced afterwards, so their edges do not matter. The last one keeps its
    place; the others move next to it (LATE) or to the first one (EARLY).

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
    """Return a chain with some pose nodes replaced by as many others."""
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
    """Return the nodes, chain by chain, whose incoming edges may differ from those of an earlier graph."""
    first, old = graph.flat.first, graph.tpg.edges
    changed = np.zeros(len(graph.flat.chain), dtype=np.bool_)
    moved = np.any(edges[: len(old)] != old, axis=1)
    for rows in (old[moved], edges[: len(old)][moved], edges[len(old) :]):
        changed[first[rows[:, 2]] + rows[:, 3]] = True
    return changed


def splice_edges(edges: Indices, cause: Causes, swap: Swap) -> tuple[Indices, Causes]:
    """Return the edges after a replacement of nodes.

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
