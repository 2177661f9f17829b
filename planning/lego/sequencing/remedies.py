"""Temporary bricks that make a structure buildable: a plinth, and scaffolding where it is blocked."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from planning.lego.bricks.assembly import BRICKS, PlacedBrick
from planning.lego.bricks.grid import Place, occupied_places
from planning.lego.insertion.insertion import InsertionRules
from planning.lego.sequencing.blocking_set import remaining, smallest_blocking_set
from planning.lego.sequencing.prospects import Prospects
from planning.lego.sequencing.rules import SequencingRules
from planning.lego.sequencing.scaffolding import columns_below
from planning.lego.stability.partial_structures import Names, PartialStructures


def on_plinth(
    structure: Sequence[PlacedBrick], layers: int
) -> tuple[tuple[PlacedBrick, ...], tuple[PlacedBrick, ...]]:
    """Return a structure raised by layers, and the temporary bricks that it then stands on.

    Under each brick that stood on the plate come as many of its own type.
    """
    raised = tuple(
        replace(item, cell=replace(item.cell, z=item.cell.z + layers))
        for item in structure
    )
    plinth = tuple(
        PlacedBrick(
            f"plinth under {item.name}: layer {layer}",
            item.brick,
            replace(item.cell, z=layer),
        )
        for item in structure
        if item.cell.level == 0
        for layer in range(1, layers + 1)
    )
    return raised, plinth


class Design:
    """A structure with the temporary bricks that it needs, and what is known of its bricks.

    Args:
        structure: what is built.
        fixed: bricks that stand from the start.
        temporary: bricks that only help.
        rules: what is allowed.
    """

    def __init__(
        self,
        structure: Sequence[PlacedBrick],
        fixed: Sequence[PlacedBrick],
        temporary: Sequence[PlacedBrick],
        rules: SequencingRules,
    ) -> None:
        self.temporary = tuple(temporary)
        self._types = rules.types or tuple(BRICKS.values())
        self.fixed: Names = frozenset(item.name for item in fixed)
        self.parts: Names = frozenset(
            item.name for item in (*structure, *self.temporary)
        )
        self.structures = PartialStructures([*structure, *fixed, *self.temporary])
        self.insertion = InsertionRules(
            self.structures, rules.force, rules.margin, rules.robot
        )
        self.prospects = Prospects(self.insertion, rules.ways_of, self.fixed)

    def order(self) -> list[str]:
        """Return the bricks from the top down."""
        bricks = self.structures.bricks
        return sorted(self.parts, key=lambda n: (-bricks[n].cell.level, n))

    def columns(
        self, names: Iterable[str], *, most: int = 1000, carriers: bool = False
    ) -> list[PlacedBrick]:
        """Return the bricks of columns under some bricks.

        Args:
            names: the bricks.
            most: so many columns at most.
            carriers: whether, where there is nothing free below a brick, the nearest one below
                it that has room for a column is carried.
        """
        filled = dict(self.structures.filled)
        out: list[PlacedBrick] = []
        for name in names:
            column = self._column(name, filled, carriers)
            for part in column:
                filled |= dict.fromkeys(
                    occupied_places(part.cell, part.brick), part.name
                )
            out += column
            most -= bool(column)
            if most == 0:
                break
        return out

    def column(self, names: Sequence[str]) -> list[PlacedBrick]:
        """Return the bricks of one column, under the first brick that has room for one below it.

        Where none has, it is under the nearest one that carries one of them.
        """
        below = self.columns(names, most=1)
        return below or self.columns(names, most=1, carriers=True)

    def _column(
        self, name: str, filled: Mapping[Place, str], carriers: bool
    ) -> tuple[PlacedBrick, ...]:
        """Return a column under a brick, or under what carries it."""
        bricks, every = self.structures.bricks, frozenset(self.structures.bricks)
        seen, front = {name}, [name]
        while front:
            for carried in front:
                column = next(columns_below(bricks[carried], filled, self._types), ())
                if column or not carriers:
                    return column
            below = (n for up in front for n in self.structures.below(every, up))
            front = sorted({n for n in below if n is not None} - seen)
            seen.update(front)
        return ()

    @cached_property
    def blocked(self) -> Names:
        """Return the bricks that remain when all that might go in last are set aside."""
        return remaining(self.order(), self.prospects.perhaps)

    def blocking_set(self) -> Names:
        """Return a smallest set of bricks of which none can be the last one in."""
        some = (name for name in self.order() if name in self.blocked)
        return smallest_blocking_set(some, self.prospects.perhaps)


def scaffolded(
    structure: Sequence[PlacedBrick],
    fixed: Sequence[PlacedBrick],
    temporary: Sequence[PlacedBrick],
    rules: SequencingRules,
) -> Design:
    """Return a structure with scaffolding under bricks that could not go in otherwise.

    Bricks that nothing lets in whatever stands around them get a column first; then one brick
    of the smallest blocking set at a time, until no set of bricks is blocked or no column helps.

    Args:
        structure: what is built.
        fixed: bricks that stand from the start.
        temporary: bricks that help already.
        rules: what is allowed, and what scaffolding may be made of.
    """
    extra = list(temporary)
    while True:
        design = Design(structure, fixed, extra, rules)
        alone = [
            name
            for name in sorted(design.blocked)
            if not design.prospects.perhaps(frozenset((name,)), name)
        ]
        columns = design.columns(alone) or design.column(sorted(design.blocking_set()))
        if not columns:
            return design
        extra += columns
