"""Type-2 edges around nodes that are replaced (APEX-MR IV-C, mended for more than two robots).

In-edges of the replaced nodes go to the last new node, out-edges of all but the last one start
at the node before. An order u -> a_p ... a_q -> w with p <= q held through the replaced nodes;
with the edges moved apart it would be lost, so u -> w is added.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT

Causes = npt.NDArray[np.uint8]


def splice_edges(
    edges: Indices, cause: Causes, chain: int, first: int, last: int, count: int
) -> tuple[Indices, Causes]:
    """Return the edges after nodes ``first`` to ``last`` became ``count`` others.

    The last new node stands for the last replaced one: it ends where that ended.

    Args:
        edges: type-2 edges, shape (e, 4).
        cause: of each, shape (e,).
        chain: whose nodes are replaced.
        first, last: the replaced nodes; there is a node before them.
        count: number of new nodes, at least 1.
    """
    shift = count - (last - first + 1)
    end = first + count - 1
    out = edges.copy()
    into = (edges[:, 2] == chain) & (edges[:, 3] >= first)
    inner_in = into & (edges[:, 3] <= last)
    out[inner_in, 3] = end
    out[into & ~inner_in, 3] += shift
    outof = (edges[:, 0] == chain) & (edges[:, 1] >= first)
    inner_out = outof & (edges[:, 1] < last)
    out[inner_out, 1] = first - 1
    out[outof & ~inner_out, 1] += shift
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
        np.concatenate([cause, np.full(len(added), MOTION_CONFLICT, dtype=np.uint8)]),
    )


def splice_index(node: int, first: int, last: int, count: int) -> int:
    """Return the new index of a node that is not replaced."""
    return node if node < first else node + count - (last - first + 1)
