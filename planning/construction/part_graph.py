"""Which parts touch each other in their places, and which may be placed when (V-A1, eq. 6)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PartGraph:
    """Contacts of the finished structure.

    Attributes:
        neighbours: part to the parts that it touches.
        ground: part to the fixtures that it touches; parts that stand on nothing fixed are
            left out.
        carriers: part to the neighbours that it rests on. They lie where it would have to pass
            if they came later.
    """

    neighbours: Mapping[str, frozenset[str]]
    ground: Mapping[str, frozenset[str]]
    carriers: Mapping[str, frozenset[str]]

    def placeable(
        self, placed: Collection[str], *, carried: bool = True
    ) -> tuple[str, ...]:
        """Return the parts that may be placed next, in the order of the graph.

        Args:
            placed: the parts that are in place.
            carried: whether a part waits for everything that it rests on. Without, one placed
                neighbour is enough, as in the paper.
        """
        there = frozenset(placed)
        return tuple(
            part
            for part, near in self.neighbours.items()
            if part not in there
            and (part in self.ground or near & there)
            and (not carried or self.carriers[part] <= there)
        )

    def placed_neighbours(self, part: str, placed: Collection[str]) -> int:
        """Return how many neighbours of a part are in place: the heuristic h of eq. 6."""
        return len(self.neighbours[part].intersection(placed))
