"""A temporal plan graph as flat arrays, for compiled passes over many replications."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks
from twin.durations import Nanoseconds


class PrecedenceArrays(NamedTuple):
    """A TPG as flat arrays; nodes of all chains are numbered through, chain by chain.

    Attributes:
        order: node numbers in a total order that every edge follows, shape (nodes,).
        before: the node before it in its chain, -1 for a first node, shape (nodes,).
        edge_first: edges into node n are ``edge_first[n]`` to ``edge_first[n + 1]``,
            shape (nodes + 1,).
        source: the node that must be complete, by edge, shape (edges,).
        cause: why, by edge, shape (edges,).
        chain_first: first node of each chain and the number of nodes, shape (chains + 1,).
        not_before: no node starts before this, shape (nodes,) [ns].
    """

    order: Indices
    before: Indices
    edge_first: Indices
    source: Indices
    cause: npt.NDArray[np.uint8]
    chain_first: Indices
    not_before: Nanoseconds


def precedence_arrays(
    tpg: TemporalPlanGraph, not_before_ns: Nanoseconds | None = None
) -> PrecedenceArrays:
    """Return a TPG, contracted or not, as the flat arrays that the kernels take.

    Args:
        tpg: the graph; edge k of the arrays is row ``edge_order(tpg)[k]`` of its edges.
        not_before_ns: no node starts before this, shape (nodes,) [ns]; 0 by default.
    """
    ranks = planned_ranks(tpg.chains)
    first = np.cumsum([0, *(len(r) for r in ranks)]).astype(np.int64)
    total = int(first[-1])
    rank = np.concatenate([*ranks, np.empty(0, dtype=np.int64)])
    before = np.arange(-1, total - 1, dtype=np.int64)
    before[first[:-1][np.diff(first) > 0]] = -1
    by_target = edge_order(tpg)
    target = first[tpg.edges[:, 2]] + tpg.edges[:, 3]
    source = first[tpg.edges[:, 0]] + tpg.edges[:, 1]
    return PrecedenceArrays(
        order=np.argsort(rank).astype(np.int64),
        before=before,
        edge_first=np.searchsorted(target[by_target], np.arange(total + 1)).astype(
            np.int64
        ),
        source=np.ascontiguousarray(source[by_target], dtype=np.int64),
        cause=np.ascontiguousarray(tpg.cause[by_target]),
        chain_first=first,
        not_before=np.zeros(total, dtype=np.int64)
        if not_before_ns is None
        else np.ascontiguousarray(not_before_ns, dtype=np.int64),
    )


def edge_order(tpg: TemporalPlanGraph) -> Indices:
    """Return the rows of ``tpg.edges`` in the order of the edges of its PrecedenceArrays."""
    return np.lexsort((tpg.edges[:, 3], tpg.edges[:, 2])).astype(np.int64)


def last_ends(graph: PrecedenceArrays, end: Nanoseconds) -> Nanoseconds:
    """Return the end of the last node of each chain, 0 for a chain without nodes."""
    out = np.zeros((len(graph.chain_first) - 1, end.shape[1]), dtype=np.int64)
    for k, (low, high) in enumerate(
        zip(graph.chain_first, graph.chain_first[1:], strict=False)
    ):
        if high > low:
            out[k] = end[high - 1]
    return out
