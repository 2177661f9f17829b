"""Occupancies of chains in pieces, built when asked for and kept until their nodes change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from scheduling.conflicts.allowed_contacts import EntityNumbers
from scheduling.conflicts.object_spans import Moment, ObjectSpan
from scheduling.conflicts.occupancy import Occupancy, chain_occupancy
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph

_LONGEST = 128
"""Nodes in a piece."""


def cut_chain(chain: NodeChain, first: int, stop: int) -> NodeChain:
    """Return nodes ``first`` to ``stop - 1`` of a chain as a chain of their own."""
    lo, hi = int(chain.first[first]), int(chain.first[stop])
    return NodeChain(
        chain.robot,
        chain.start if lo == 0 else chain.waypoints[lo - 1],
        chain.waypoints[lo:hi],
        chain.fraction[lo:hi],
        chain.first[first : stop + 1] - lo,
        chain.task[first:stop],
        chain.skill[first:stop],
        chain.duration[first:stop],
        chain.planned_start[first:stop],
    )


def occupancy_of(
    tpg: TemporalPlanGraph,
    index: int,
    nodes: NodeChain,
    first: int,
    count: int,
    objects: Sequence[ObjectSpan],
    entities: EntityNumbers,
) -> Occupancy:
    """Return what some nodes of a chain occupy, numbered from 0.

    Args:
        tpg: the graph.
        index: of the chain.
        nodes: the nodes themselves.
        first, count: the nodes of the chain whose place they take: what the chain carries
            there, they carry.
        objects: what every robot carries when.
        entities: numbers of the entities.
    """

    def clip(moment: Moment) -> Moment:
        node, waypoint = moment
        if node < first:
            return (0, 0)
        return (len(nodes), 0) if node >= first + count else (node - first, waypoint)

    own = [
        replace(span, start=clip(span.start), end=clip(span.end))
        for span in objects
        if span.robot == index
        and span.start[0] < first + count
        and span.end >= (first, 0)
    ]
    chains = (*tpg.chains[:index], nodes, *tpg.chains[index + 1 :])
    return chain_occupancy(replace(tpg, chains=chains), index, own, entities)


class Pieces:
    """All chains of a graph, cut so that every run that may be shortened is pieces of its own.

    Args:
        tpg: the graph.
        cuts: per chain, nodes at which a piece has to start.
        entities: numbers of the entities.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        cuts: Sequence[Sequence[int]],
        entities: EntityNumbers,
    ) -> None:
        self._entities = entities
        self._sizes: list[list[int]] = []
        self._built: list[list[Occupancy | None]] = []
        for chain, wanted in zip(tpg.chains, cuts, strict=True):
            sizes = []
            for lo, hi in pairwise(sorted({0, *wanted, len(chain)})):
                parts = -(-(hi - lo) // _LONGEST)
                marks = np.linspace(lo, hi, parts + 1).astype(int)
                sizes += np.diff(marks).tolist()
            self._sizes.append(sizes)
            self._built.append([None] * len(sizes))

    def between(
        self,
        tpg: TemporalPlanGraph,
        index: int,
        first: int,
        stop: int,
        objects: Sequence[ObjectSpan],
    ) -> Iterator[tuple[int, Occupancy]]:
        """Yield the first node and the occupancy of every piece with nodes in a range.

        Args:
            tpg: the graph as it is now.
            index: of the chain.
            first, stop: the range.
            objects: what every robot carries when, as it is now.
        """
        starts = np.concatenate([[0], np.cumsum(self._sizes[index])])
        lo = int(np.searchsorted(starts, first, side="right")) - 1
        for piece in range(lo, len(self._sizes[index])):
            at, size = int(starts[piece]), self._sizes[index][piece]
            if at >= stop:
                return
            built = self._built[index][piece]
            if built is None:
                nodes = cut_chain(tpg.chains[index], at, at + size)
                built = occupancy_of(
                    tpg, index, nodes, at, size, objects, self._entities
                )
                self._built[index][piece] = built
            yield at, built

    def splice(self, index: int, first: int, last: int, count: int) -> None:
        """Forget the pieces around nodes that were replaced by ``count`` others."""
        starts = np.concatenate([[0], np.cumsum(self._sizes[index])])
        lo = int(np.searchsorted(starts, first, side="right")) - 1
        hi = int(np.searchsorted(starts, last, side="right"))
        size = int(starts[hi] - starts[lo]) + count - (last - first + 1)
        self._sizes[index][lo:hi] = [size]
        self._built[index][lo:hi] = [None]
