"""Bricks that may be removed from a partial structure, and how they would be put back.

What assembly by disassembly asks at every partial structure (APEX-MR App. A): what remains must
stand, and the brick must go in again with room for the tools, the structure bearing the press.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import groupby, product

from planning.lego.insertion.insertion import Insertion, InsertionRules, Way
from planning.lego.sequencing.disassembly import Removal
from planning.lego.stability.partial_structures import Names


class Removals:
    """Removal candidates of the partial structures of one design.

    Args:
        insertion: rules of the design.
        ways: gives those that are allowed for a brick, the preferred ones first.
        fixed: bricks that stand from the start.

    Attributes:
        urgency: how often a brick could not be removed any more at a dead end; the most urgent
            bricks are removed first.
    """

    def __init__(
        self,
        insertion: InsertionRules,
        ways: Callable[[str], Sequence[Way]],
        fixed: Names,
    ) -> None:
        self._insertion, self._ways, self._fixed = insertion, ways, fixed
        self._structures = insertion.structures
        self.urgency: Counter[str] = Counter()

    def candidates(self, parts: Iterable[str]) -> list[str]:
        """Return bricks in the order in which they are tried: urgent ones, then from the top."""
        bricks = self._structures.bricks

        def order(name: str) -> tuple[int, int, int, int, str]:
            cell = bricks[name].cell
            return -self.urgency[name], -cell.level, -cell.x, -cell.y, name

        return sorted(parts, key=order)

    def of(self, parts: Names) -> Iterator[Removal[str, Insertion]]:
        """Yield the bricks that may be removed from some (and what is fixed)."""
        names, bricks = parts | self._fixed, self._structures.bricks
        groups = groupby(
            self.candidates(parts),
            key=lambda n: (self.urgency[n], bricks[n].cell.level),
        )
        for _, group in groups:
            for way, brick in product(Way, tuple(group)):
                if way not in self._ways(brick):
                    continue
                insertion = self.insertion(names, brick, way)
                if insertion is not None:
                    yield Removal(brick, insertion)

    def insertion(self, names: Names, brick: str, way: Way) -> Insertion | None:
        """Return how a brick of a partial structure would be put in as its last one."""
        site = self._insertion.at(names, brick, up=way.up)
        if site.obstacle() is not None or not site.roomy_presses:
            return None
        if not self._structures.stands(names - {brick}):
            return None
        return site.insertion(way)
