"""A temporal plan graph as flat arrays, for compiled passes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planning.transforms import Indices


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
    target = first[edges[:, 2]] + edges[:, 3]
    row = np.argsort(target, kind="stable")
    return FlatGraph(
        first,
        np.repeat(np.arange(len(ranks)), np.diff(first)),
        np.argsort(rank, kind="stable"),
        np.searchsorted(target[row], np.arange(len(rank) + 1)),
        (first[edges[:, 0]] + edges[:, 1])[row],
        row,
    )
