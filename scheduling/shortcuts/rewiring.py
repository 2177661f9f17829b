"""Edges and chains after nodes were replaced (APEX-MR IV-C, extended to N robots).

In-edges of the replaced nodes go to the last new node, out-edges of all but the last one start
at the node before. An order u -> a_p ... a_q -> w with p <= q held through the replaced nodes;
with the edges moved apart it would be lost, so u -> w is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.transforms import Array, Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    Causes,
    NodeChain,
    join_chains,
)

Edge = tuple[int, int, int, int]
"""Robot and node that must be complete, robot and node that may then start."""


@dataclass(frozen=True)
class Swap:
    """Nodes ``first`` to ``last`` of a chain become ``count`` others, at least one.

    There is a node before ``first``. The last new node stands for the last replaced one: it
    ends where that ended. The replaced nodes handle nothing.
    """

    chain: int
    first: int
    last: int
    count: int

    @property
    def shift(self) -> int:
        """By how much the nodes behind the replaced ones are moved on."""
        return self.count - (self.last - self.first + 1)

    def moved(self, node: int) -> int:
        """Return the new index of a node of the chain that is not replaced, or of the last one."""
        return node if node < self.last else node + self.shift


def rewire(
    graph: DerivedTpg, swap: Swap, new: NodeChain, edges: Sequence[Edge]
) -> DerivedTpg:
    """Return the graph with nodes replaced.

    Args:
        graph: the graph before.
        swap: which nodes of which chain.
        new: the nodes that take their place.
        edges: that these need, the new nodes numbered from ``swap.first``.

    Raises:
        PlanInvariantError: they do not fit into the total order.
    """
    tpg, extra = graph.tpg, np.array(edges, dtype=np.int64).reshape(-1, 4)
    moved, cause = splice_edges(tpg.edges, tpg.cause, swap)
    planned = planned_after(tpg.chains, swap, new, edges)
    chains = list(tpg.chains)
    new = replace(new, planned_start=planned)
    old = chains[swap.chain]
    ends = old.cut(0, swap.first), old.cut(swap.last + 1, len(old))
    chains[swap.chain] = join_chains([ends[0], new, ends[1]])
    handlings = tuple(
        replace(h, node=swap.moved(h.node)) if h.robot == swap.chain else h
        for h in tpg.handlings
    )
    after = graph.derive(replace(tpg, chains=tuple(chains), handlings=handlings))
    return after.with_edges(
        np.concatenate([moved, extra]),
        np.append(cause, np.full(len(extra), MOTION_CONFLICT, dtype=np.uint8)),
    )


def splice_edges(edges: Indices, cause: Causes, swap: Swap) -> tuple[Indices, Causes]:
    """Return the edges after nodes were replaced.

    Args:
        edges: type-2 edges, shape (e, 4).
        cause: of each, shape (e,).
        swap: the nodes.
    """
    first, last = swap.first, swap.last
    out = edges.copy()
    into = (edges[:, 2] == swap.chain) & (edges[:, 3] >= first)
    inner_in = into & (edges[:, 3] <= last)
    out[inner_in, 3] = first + swap.count - 1
    out[into & ~inner_in, 3] += swap.shift
    outof = (edges[:, 0] == swap.chain) & (edges[:, 1] >= first)
    inner_out = outof & (edges[:, 1] < last)
    out[inner_out, 1] = first - 1
    out[outof & ~inner_out, 1] += swap.shift
    added = [
        (*edges[i, :2], *edges[o, 2:])
        for i in np.flatnonzero(inner_in)
        for o in np.flatnonzero(inner_out)
        if edges[i, 3] <= edges[o, 1] and edges[i, 0] != edges[o, 2]
    ]
    if not added:
        return out, cause
    return (
        np.concatenate([out, np.array(added, dtype=np.int64)]),
        np.append(cause, np.full(len(added), MOTION_CONFLICT, dtype=np.uint8)),
    )


def planned_after(
    chains: Sequence[NodeChain], swap: Swap, new: NodeChain, edges: Sequence[Edge]
) -> Array:
    """Return planned starts that put every new node after what it waits for."""
    planned = new.planned_start.copy()
    for robot, node, target, at in edges:
        if target == swap.chain:
            after = np.nextafter(chains[robot].planned_start[node], np.inf)
            planned[at - swap.first] = max(planned[at - swap.first], after)
    latest = float(chains[swap.chain].planned_start[swap.last])
    planned[-1] = max(planned[-1], latest)
    return np.asarray(np.minimum(np.maximum.accumulate(planned), latest))
