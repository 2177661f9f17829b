"""The one total order of all nodes (planned start, then task, then node), and graphs as arrays in it.

Every type-2 edge follows this order, so a temporal plan graph has no cycle. Task indices settle
ties (a robot's index never does): zero-length nodes start when the node before them does.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planning.errors import PlanInvariantError
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import NodeChain


def planned_ranks(chains: Sequence[NodeChain]) -> tuple[Indices, ...]:
    """Return the place of every node in the total order, one array of shape (nodes,) a chain.

    Raises:
        PlanInvariantError: a robot's own nodes are not in this order.
    """
    if not chains:
        return ()
    start = np.concatenate([c.planned_start for c in chains])
    task = np.concatenate([c.task for c in chains])
    node = np.concatenate([np.arange(len(c)) for c in chains])
    rank = np.empty(len(start), dtype=np.int64)
    rank[np.lexsort((node, task, start))] = np.arange(len(start))
    bounds = np.cumsum([0, *(len(c) for c in chains)])
    ranks = tuple(rank[a:b] for a, b in pairwise(bounds))
    for chain, own in zip(chains, ranks, strict=True):
        bad = np.flatnonzero(np.diff(own) < 0)
        if len(bad):
            k = int(bad[0])
            raise PlanInvariantError(
                f"robot {chain.robot!r}: node {k + 1} (task {chain.task[k + 1]}) is planned"
                f" at {chain.planned_start[k + 1]:.6f} s, before node {k} (task"
                f" {chain.task[k]}) that it follows"
            )
    return ranks


def nodes_before(ranks: Sequence[Indices], robot: int, other: int) -> Indices:
    """Return, for each node of ``robot``, how many nodes of ``other`` come before it."""
    return np.searchsorted(ranks[other], ranks[robot]).astype(np.int64)


class FlatGraph(NamedTuple):
    """The nodes of all chains, numbered through chain by chain, and the edges into each of them.

    Attributes:
        first: first node of each chain, and the number of nodes, shape (chains + 1,).
        chain: chain of each node, shape (nodes,).
        order: nodes in the total order, shape (nodes,).
        edge_first: edges into node n are ``edge_first[n]`` up to ``edge_first[n + 1]``, shape
            (nodes + 1,).
        source: node that each edge comes from, shape (edges,).
        row: row of each edge in the array that the graph was made from, shape (edges,).
    """

    first: Indices
    chain: Indices
    order: Indices
    edge_first: Indices
    source: Indices
    row: Indices


def flatten(ranks: Sequence[Indices], edges: Indices) -> FlatGraph:
    """Return a graph as flat arrays.

    Args:
        ranks: place of every node in the total order, one array a chain.
        edges: type-2 edges, shape (e, 4).
    """
    first = np.cumsum([0, *(len(r) for r in ranks)], dtype=np.int64)
    rank = np.concatenate([*ranks, np.empty(0, dtype=np.int64)])
    chain = np.repeat(np.arange(len(ranks)), np.diff(first))
    none = np.empty(0, dtype=np.int64)
    order = np.argsort(rank, kind="stable")
    return with_edges(FlatGraph(first, chain, order, none, none, none), edges)


def with_edges(graph: FlatGraph, edges: Indices) -> FlatGraph:
    """Return a graph of the same nodes in the same order with other edges, shape (e, 4)."""
    first = graph.first
    target = first[edges[:, 2]] + edges[:, 3]
    row = np.argsort(target, kind="stable")
    into = np.bincount(target, minlength=len(graph.chain))
    return graph._replace(
        edge_first=np.concatenate([[0], np.cumsum(into)]).astype(np.int64),
        source=(first[edges[:, 0]] + edges[:, 1])[row],
        row=row,
    )
