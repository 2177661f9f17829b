"""Precedence graph with causes as flat arrays, for compiled passes over many replications."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.flat_graph import flatten
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks
from twin.durations import Nanoseconds


class PrecedenceArrays(NamedTuple):
    """A flat graph with the causes of its edges and earliest starts.

    Attributes:
        first, chain, order, edge_first, source: see FlatGraph.
        cause: why, by edge, shape (edges,).
        not_before: no node starts before this, shape (nodes,) [ns].
    """

    first: Indices
    chain: Indices
    order: Indices
    edge_first: Indices
    source: Indices
    cause: npt.NDArray[np.uint8]
    not_before: Nanoseconds


def precedence_arrays(
    tpg: TemporalPlanGraph, not_before_ns: Nanoseconds | None = None
) -> PrecedenceArrays:
    """Return what every node of a TPG, contracted or not, waits for.

    Args:
        tpg: the graph.
        not_before_ns: no node starts before this, shape (nodes,) [ns]; 0 by default.
    """
    flat = flatten(planned_ranks(tpg.chains), tpg.edges)
    return PrecedenceArrays(
        flat.first,
        flat.chain,
        flat.order,
        flat.edge_first,
        flat.source,
        tpg.cause[flat.row],
        np.zeros_like(flat.order) if not_before_ns is None else not_before_ns,
    )


def last_ends(graph: PrecedenceArrays, end: Nanoseconds) -> Nanoseconds:
    """Return the end of the last node of each chain, 0 for a chain without nodes."""
    out = np.zeros((len(graph.first) - 1, end.shape[1]), dtype=np.int64)
    has_nodes = np.diff(graph.first) > 0
    out[has_nodes] = end[graph.first[1:][has_nodes] - 1]
    return out
