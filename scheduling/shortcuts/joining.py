"""Joining of pose nodes on one straight way, where nobody can tell the difference.

While shortcuts are searched, a shorter way has as many nodes as the way that it replaces. A node
that nobody waits for and the next one, which waits for nobody, are one piece of motion: whoever
waits for the one waits for the other, at any delays, and together they sweep the same space.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.shortcuts.candidates import Span

_STRAIGHT = 1e-9
"""Farthest that a waypoint left out may be from the straight way past it [rad or m]."""


def join_nodes(
    graph: DerivedTpg, spans: Sequence[Span], step: float
) -> TemporalPlanGraph:
    """Return a graph with fewer nodes that does the same.

    Args:
        graph: the graph.
        spans: runs of pose nodes in which nodes may be joined.
        step: longest time between pose nodes [s].
    """
    tpg = graph.tpg
    number, chains = [], []
    for index, chain in enumerate(tpg.chains):
        last = _last_nodes(chain, _borders(graph, spans, index), step)
        number.append(np.searchsorted(last, np.arange(len(chain))))
        chains.append(_joined(chain, last))
    edges = tpg.edges.copy()
    for end in (0, 2):
        for index, numbers in enumerate(number):
            own = edges[:, end] == index
            edges[own, end + 1] = numbers[edges[own, end + 1]]
    handlings = tuple(
        replace(h, node=int(number[h.robot][h.node])) for h in tpg.handlings
    )
    return replace(tpg, chains=tuple(chains), edges=edges, handlings=handlings)


def _borders(
    graph: DerivedTpg, spans: Sequence[Span], index: int
) -> npt.NDArray[np.bool_]:
    """Return for each node whether it has to stay apart from the one after it."""
    edges, chain = graph.tpg.edges, graph.tpg.chains[index]
    stays = np.ones(len(chain), dtype=np.bool_)
    for span in spans:
        if span.chain == index:
            stays[span.first : span.last] = False
    stays[edges[edges[:, 0] == index, 1]] = True
    stays[np.maximum(edges[edges[:, 2] == index, 3] - 1, 0)] = True
    stays[:-1] |= chain.task[1:] != chain.task[:-1]
    # Another robot's handling in between asks where this one stands: see ``trace_objects``.
    for handling in graph.tpg.handlings:
        if handling.robot != index:
            rank = graph.ranks[handling.robot][handling.node]
            stays[max(int(np.searchsorted(graph.ranks[index], rank)) - 1, 0)] = True
    return stays


def _last_nodes(chain: NodeChain, stays: npt.NDArray[np.bool_], step: float) -> Indices:
    """Return the last of the nodes that become each new one."""
    out: list[int] = []
    begin, taken = 0, 0.0
    for node in range(len(chain)):
        taken += float(chain.duration[node])
        more = node + 1 < len(chain) and not stays[node]
        if (
            more
            and taken + chain.duration[node + 1] <= step * (1.0 + 1e-9)
            and _straight(chain, begin, node + 1)
        ):
            continue
        out.append(node)
        begin, taken = node + 1, 0.0
    return np.array(out, dtype=np.int64)


def _straight(chain: NodeChain, begin: int, end: int) -> bool:
    """Tell whether pose nodes lead straight from the start of one to the end of another."""
    at = chain.first[begin]
    points = chain.waypoints[at - 1 : chain.first[end + 1]]
    share = np.cumsum(chain.duration[begin : end + 1])
    if at == 0 or len(points) != end - begin + 2 or share[-1] <= 0.0:
        return False
    way = points[0] + (share / share[-1])[:, None] * (points[-1] - points[0])
    return bool(np.max(np.abs(points[1:] - way)) <= _STRAIGHT)


def _joined(chain: NodeChain, last: Indices) -> NodeChain:
    """Return a chain in which nodes up to each last one are one node."""
    first = np.append(0, last[:-1] + 1)
    kept = np.ones(len(chain.waypoints), dtype=np.bool_)
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        if a < b:
            kept[chain.first[a] : chain.first[b]] = False
    passed = np.append(0, np.cumsum(kept))
    return NodeChain(
        chain.robot,
        chain.start,
        chain.waypoints[kept],
        chain.fraction[kept],
        np.append(0, passed[chain.first[last + 1]]),
        chain.task[first],
        chain.skill[first],
        np.add.reduceat(chain.duration, first),
        chain.planned_start[first],
    )
