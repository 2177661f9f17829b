"""Occupancies of chains in pieces, built when asked for and kept until their nodes change."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.occupancy import Occupancy
from scheduling.shortcuts.rewiring import Swap

_LONGEST = 128
"""Nodes in a piece."""


class Pieces:
    """All chains of a graph, cut so that every run that may be shortened is pieces of its own.

    Args:
        lengths: number of nodes of each chain.
        cuts: per chain, nodes at which a piece has to start.
    """

    def __init__(self, lengths: Sequence[int], cuts: Sequence[Sequence[int]]) -> None:
        self._sizes: list[list[int]] = []
        self._built: list[list[Occupancy | None]] = []
        for length, wanted in zip(lengths, cuts, strict=True):
            sizes = []
            for lo, hi in pairwise(sorted({0, *wanted, length})):
                parts = -(-(hi - lo) // _LONGEST)
                marks = np.linspace(lo, hi, parts + 1).astype(int)
                sizes += np.diff(marks).tolist()
            self._sizes.append(sizes)
            self._built.append([None] * len(sizes))

    def between(
        self, graph: DerivedTpg, chain: int, first: int, stop: int
    ) -> Iterator[tuple[int, Occupancy]]:
        """Yield the first node and the occupancy of every piece with nodes in a range.

        Args:
            graph: as it is now.
            chain: the chain.
            first, stop: its nodes ``range(first, stop)``.
        """
        starts = self._starts(chain)
        lo = int(np.searchsorted(starts, first, side="right")) - 1
        for piece, (at, end) in enumerate(pairwise(starts[lo:].tolist()), lo):
            if at >= stop:
                return
            built = self._built[chain][piece]
            if built is None:
                built = graph.occupancy(chain, at, end)
                self._built[chain][piece] = built
            yield at, built

    def splice(self, swap: Swap) -> None:
        """Forget the pieces around nodes that were replaced."""
        starts = self._starts(swap.chain)
        lo = int(np.searchsorted(starts, swap.first, side="right")) - 1
        hi = int(np.searchsorted(starts, swap.last, side="right"))
        size = int(starts[hi] - starts[lo]) + swap.shift
        self._sizes[swap.chain][lo:hi] = [size]
        self._built[swap.chain][lo:hi] = [None]

    def _starts(self, chain: int) -> Indices:
        return np.cumsum([0, *self._sizes[chain]])
