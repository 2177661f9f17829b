"""Division of the nodes of each robot into pieces, for reuse of their swept volumes and conflicts.

The nodes are divided at the ends of all sequences of transits that may be shortened.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    Occupant,
    OccupantConflicts,
    occupant_of_nodes,
)
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.shortcuts.candidates import TransitSpan
from scheduling.shortcuts.rewiring import Swap

_LONGEST = 128
"""Nodes in a piece."""


class GraphPieces:
    """All chains of a graph, divided such that every transit span that may be shortened consists of whole pieces.

    Args:
        tpg: the graph.
        spans: these transit spans.
        conflicts: searches conflicts between pieces and others, or knows them already.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        spans: Sequence[TransitSpan],
        conflicts: OccupantConflicts | None = None,
    ) -> None:
        self.conflicts = conflicts or OccupantConflicts()
        self._starts: list[Indices] = []
        self._built: list[list[Occupant | None]] = []
        for k, chain in enumerate(tpg.chains):
            cuts = {0, len(chain)}
            for span in spans:
                if span.chain == k:
                    cuts |= {span.first, span.last + 1}
            starts = [0]
            for low, high in pairwise(sorted(cuts)):
                parts = -(-(high - low) // _LONGEST)
                starts += np.linspace(low, high, parts + 1).astype(int)[1:].tolist()
            self._starts.append(np.array(starts, dtype=np.int64))
            self._built.append([None] * (len(starts) - 1))

    def between(
        self, graph: DerivedTpg, chain: int, first: int, stop: int
    ) -> Iterator[tuple[int, Occupant]]:
        """Yield the pieces with nodes in a range, each with its first node.

        Args:
            graph: as it is now.
            chain: the chain.
            first, stop: its nodes ``range(first, stop)``.
        """
        starts = self._starts[chain]
        lo = int(np.searchsorted(starts, first, side="right")) - 1
        for piece, (at, end) in enumerate(pairwise(starts[lo:].tolist()), lo):
            if at >= stop:
                return
            built = self._built[chain][piece]
            if built is None:
                built = occupant_of_nodes(graph, chain, at, end)
                self._built[chain][piece] = built
            yield at, built

    def replace_nodes(self, swap: Swap) -> None:
        """Drop the cached pieces around replaced nodes."""
        starts = self._starts[swap.chain]
        lo = int(np.searchsorted(starts, swap.first, side="right")) - 1
        hi = int(np.searchsorted(starts, swap.last, side="right"))
        self._built[swap.chain][lo:hi] = [None] * (hi - lo)
