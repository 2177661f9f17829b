"""Contraction of chains: consecutive nodes of a robot are joined if this changes no start or end time.

A type-2 edge is a dependency between nodes of two robots. If a node has no type-2 predecessor and the node before it
has no type-2 successor, it starts as soon as the node before it is complete, for any queue depth, if messages take no
time. The two nodes can then be simulated as one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import EVER, NodeChain, TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.uncertainty.stop_times import Stops


@dataclass(frozen=True)
class Contraction:
    """A TPG whose nodes are segments of the nodes of another.

    Attributes:
        tpg: the contracted graph.
        first: first node of each segment and the number of nodes, per chain, shape
            (segments + 1,).
    """

    tpg: TemporalPlanGraph
    first: tuple[Indices, ...]

    @classmethod
    def trivial(cls, tpg: TemporalPlanGraph) -> Contraction:
        """Return a graph with every node as a segment of its own."""
        return cls(tpg, tuple(np.arange(len(own) + 1) for own in tpg.chains))

    def heads(self) -> Indices:
        """Return the first node of each segment and the number of nodes, which are numbered through."""
        ends = np.cumsum([0, *(first[-1] for first in self.first)])
        own = (f[:-1] + end for f, end in zip(self.first, ends, strict=False))
        return np.concatenate([*own, ends[-1:]])

    def sums(self, values: Sequence[Nanoseconds]) -> tuple[Nanoseconds, ...]:
        """Return the sums of node values over segments, per chain."""
        return tuple(
            np.add.reduceat(v, f[:-1]) if len(v) else v
            for v, f in zip(values, self.first, strict=True)
        )

    def expand(
        self,
        start_ns: Sequence[Nanoseconds],
        busy_ns: Sequence[Nanoseconds],
        until_ns: int,
        stops: Sequence[Stops] | None = None,
    ) -> tuple[tuple[Nanoseconds, ...], tuple[Nanoseconds, ...]]:
        """Return start and end of every node from the starts of the segments.

        Args:
            start_ns: start of each segment, -1 where it has not started, per chain [ns].
            busy_ns: standstills and duration of each node together, per chain [ns].
            until_ns: end of the run; later starts and ends have not happened [ns].
            stops: stops by the clock, one entry a chain.
        """
        starts, ends = [], []
        for k, (segment, busy, first) in enumerate(
            zip(start_ns, busy_ns, self.first, strict=True)
        ):
            count = np.diff(first)
            passed = np.cumsum(busy)
            before = passed - busy
            base = np.repeat(before[first[:-1]], count)
            origin = np.repeat(segment, count)
            begun = origin >= 0
            if stops is None:
                start, end = origin + before - base, origin + passed - base
            else:
                start = stops[k].expand(origin, before - base)
                end = stops[k].expand(origin, passed - base)
            starts.append(np.where(begun & (start <= until_ns), start, -1))
            ends.append(np.where(begun & (end <= until_ns), end, -1))
        return tuple(starts), tuple(ends)


def contract(
    tpg: TemporalPlanGraph, apart: Sequence[npt.NDArray[np.bool_]] | None = None
) -> Contraction:
    """Merge every node into its predecessor where start and end times provably stay the same.

    Nodes of different tasks are never joined, so a segment belongs to one task.

    Args:
        tpg: the graph.
        apart: True for nodes that are not joined to their predecessor whatever they wait for, one
            array a chain.
    """
    chains, firsts, segment_of = [], [], []
    for k, chain in enumerate(tpg.chains):
        opens = np.zeros(len(chain) + 1, dtype=bool)
        if apart is not None:
            opens[:-1] = apart[k]
        opens[0] = True
        opens[tpg.edges[tpg.edges[:, 2] == k, 3]] = True
        opens[tpg.edges[tpg.edges[:, 0] == k, 1] + 1] = True
        if len(tpg.patience):  # it counts from the begin of the node itself
            counts = (tpg.edges[:, 0] == k) & (tpg.patience < EVER)
            opens[tpg.edges[counts, 1]] = True
        opens[1:-1] |= np.diff(chain.task) != 0
        first = np.flatnonzero(opens[:-1])
        chains.append(_contract_chain(chain, first))
        segment_of.append(np.cumsum(opens[:-1]) - 1)
        firsts.append(np.append(first, len(chain)))
    edges = tpg.edges.copy()
    for k in range(len(chains)):
        for column in (0, 2):
            own = edges[:, column] == k
            edges[own, column + 1] = segment_of[k][edges[own, column + 1]]
    return Contraction(
        replace(tpg, chains=tuple(chains), edges=edges, handlings=()), tuple(firsts)
    )


def _contract_chain(chain: NodeChain, first: Indices) -> NodeChain:
    """Keep one node per segment; geometry is unchanged, as only times are used.

    Durations are added up in whole nanoseconds, as engines add them.
    """
    whole_ns = to_nanoseconds(chain.duration)
    return replace(
        chain,
        first=np.append(chain.first[first], chain.first[-1]),
        task=chain.task[first],
        skill=chain.skill[first],
        duration=np.add.reduceat(whole_ns, first) / NANOSECONDS
        if len(first)
        else np.zeros(0),
        planned_start=chain.planned_start[first],
        # Draws are of the nodes themselves, never of joined ones.
        least=np.zeros(len(first)),
    )
