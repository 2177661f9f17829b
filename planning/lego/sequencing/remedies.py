"""Temporary bricks that make a structure buildable: a plinth under it, and scaffolding under single bricks."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product

from planning.lego.bricks.assembly import BrickType, Cell, GridPlace, PlacedBrick
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.insertion.insertion import Insertions
from planning.lego.insertion.rules import SequencingRules
from planning.lego.sequencing.blocking import blocked_parts, smallest_blocking_set
from planning.lego.sequencing.removal import UnremovableBrick, find_unremovable_bricks
from planning.lego.stability.partial_structures import Names, PartialStructures

_MOST_COLUMNS = 40
"""Number of column places tried together."""


def supporting_columns(
    item: PlacedBrick,
    filled: Mapping[GridPlace, str],
    types: Collection[BrickType],
    *,
    beyond: Collection[tuple[int, int]] = (),
) -> Iterator[tuple[PlacedBrick, ...]]:
    """Yield columns that would support a brick with nothing below it, widest first.

    Each is a choice of its own: they may share places.

    Args:
        item: the brick.
        filled: the brick in each place of the grid.
        types: that columns may be made of.
        beyond: studs that columns may cover besides those of the brick; those that carry most of
            it come first then.

    Yields:
        The bricks of a column from the top down, named after the brick and their layer.
    """
    top = item.cell.level
    free = {(x, y) for x, y in item.studs if top > 0 and (x, y, top - 1) not in filled}
    heights: dict[tuple[tuple[int, int], bool], dict[int, BrickType]] = {}
    for brick in (item for item in types if not item.bare):
        for turned in (False, True) if brick.studs[0] != brick.studs[1] else (False,):
            size = brick.studs[::-1] if turned else brick.studs
            heights.setdefault((size, turned), {})[brick.height] = brick

    def order(size: tuple[tuple[int, int], bool]) -> tuple[int, int, bool]:
        (w, d), turned = size
        return -w * d, abs(w - d), turned

    for (w, d), turned in sorted(heights, key=order):
        corners = free
        if beyond:
            corners = {
                (x - i, y - j) for x, y in free for i in range(w) for j in range(d)
            }

        def carried(at: tuple[int, int], w: int = w, d: int = d) -> int:
            """Return how much of the brick is above a patch."""
            return sum(
                (at[0] + i, at[1] + j) in free for i in range(w) for j in range(d)
            )

        for x, y in sorted(corners, key=lambda at: (-carried(at), at)):
            patch = {(x + i, y + j) for i in range(w) for j in range(d)}
            if all(stud in free or stud in beyond for stud in patch):
                column = _column(x, y, top, turned, heights[(w, d), turned], filled)
                if column:
                    yield tuple(
                        replace(part, name=f"under {item.name}: {part.cell.words}")
                        for part in column
                    )


def _column(
    x: int,
    y: int,
    top: int,
    turned: bool,
    heights: Mapping[int, BrickType],
    filled: Mapping[GridPlace, str],
) -> list[PlacedBrick]:
    """Return a column up to a level on the bricks below it; none where heights do not add up."""
    column: list[PlacedBrick] = []
    while top > 0:
        fitting = [h for h in heights if h <= top]
        for height in sorted(fitting, reverse=True):
            cell = Cell.at_level(x, y, top - height, turned=turned)
            part = PlacedBrick("", heights[height], cell)
            if not any(p in filled for p in part.places):
                column.append(part)
                top -= height
                break
        else:
            some = PlacedBrick("", next(iter(heights.values())), Cell(x, y, 1, turned))
            under = any((i, j, top - 1) in filled for i, j in some.studs)
            return column if under else []
    return column


def raise_on_plinth(
    structure: Sequence[PlacedBrick], layers: int
) -> tuple[tuple[PlacedBrick, ...], tuple[PlacedBrick, ...]]:
    """Return a structure raised by layers, and the temporary bricks under it.

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


@dataclass(frozen=True, eq=False)
class Design:
    """A structure with the temporary bricks that it needs, and cached results on its bricks.

    Attributes:
        structure: what is built.
        fixed: bricks that stand from the start.
        temporary: bricks that only help.
        rules: what is allowed, and what scaffolding may be made of.
    """

    structure: tuple[PlacedBrick, ...]
    fixed: tuple[PlacedBrick, ...]
    temporary: tuple[PlacedBrick, ...]
    rules: SequencingRules

    @cached_property
    def parts(self) -> Names:
        """Names of the bricks to insert."""
        return frozenset(item.name for item in (*self.structure, *self.temporary))

    @cached_property
    def insertions(self) -> Insertions:
        """Insertions of its bricks."""
        bricks = [*self.structure, *self.temporary]
        return Insertions.of(bricks, self.fixed, self.rules)

    @property
    def structures(self) -> PartialStructures:
        """Stability of its partial structures."""
        return self.insertions.structures

    @cached_property
    def shut_in(self) -> tuple[UnremovableBrick, ...]:
        """Temporary bricks that can no longer be removed."""
        names = frozenset(item.name for item in self.temporary)
        return find_unremovable_bricks((*self.structure, *self.temporary), names)

    def on_plinth(self) -> Design:
        """Return the design raised on the plinth that the rules require."""
        raised, plinth = raise_on_plinth(self.structure, self.rules.plinth)
        return replace(self, structure=raised, temporary=plinth) if plinth else self

    def order(self) -> list[str]:
        """Return the bricks from the top down."""
        bricks = self.structures.bricks
        return sorted(self.parts, key=lambda n: (-bricks[n].cell.level, n))

    def columns(self, names: Iterable[str]) -> list[PlacedBrick]:
        """Return the bricks of columns under some bricks."""
        design, out = self, list[PlacedBrick]()
        for name in names:
            column = design._column(name)
            if column:
                out += column
                design = design._with(column)
        return out

    def column(self, names: Sequence[str]) -> list[PlacedBrick]:
        """Return the bricks of one column, under the first brick that has room for one below it.

        Where none has, it is under the nearest one that carries one of them.
        """
        tries = product((False, True), names)
        columns = (self._column(name, carriers=more) for more, name in tries)
        return list(next(filter(None, columns), ()))

    def _column(self, name: str, *, carriers: bool = False) -> tuple[PlacedBrick, ...]:
        """Return a column under a brick, or under its nearest carrier with room for one."""
        for item in self._with_carriers([name]):
            column = self._best(self._columns_below(item))
            if column or not carriers:
                return column
        return ()

    def _best(
        self, columns: Iterable[tuple[PlacedBrick, ...]]
    ) -> tuple[PlacedBrick, ...]:
        """Return the first column that traps no temporary brick, or else the first.

        Where temporary bricks must be removable there is none else.
        """
        first: tuple[PlacedBrick, ...] = ()
        for column in columns:
            if len(self._with(column).shut_in) <= len(self.shut_in):
                return column
            first = first or column
        return () if self.rules.removable else first

    @cached_property
    def blocked(self) -> Names:
        """Return the bricks that remain after removing all that might be inserted last."""
        return blocked_parts(self.order(), self.insertions.perhaps)

    def blocking_set(self) -> Names:
        """Return a smallest set of bricks of which none can be inserted last."""
        some = (name for name in self.order() if name in self.blocked)
        return smallest_blocking_set(some, self.insertions.perhaps)

    def scaffolded(self) -> Design:
        """Return the design with scaffolding under bricks that could not be inserted otherwise.

        Bricks that nothing lets in whatever stands around them get a column first; then one brick
        of the smallest blocking set at a time, until no set of bricks is blocked or no column
        helps.
        """
        design = replace(self)
        while True:
            alone = [
                name
                for name in sorted(design.blocked)
                if not design.insertions.perhaps(frozenset((name,)), name)
            ]
            columns = design.columns(alone)
            columns = columns or design.column(sorted(design.blocking_set()))
            if not columns:
                return design
            design = design._with(columns)

    def scaffolded_elsewhere(self) -> Design | None:
        """Return the design with columns at the places that leave the fewest bricks blocked, None for none.

        One column after another. Each place below the smallest blocking set, and below what carries
        it, is tried: it takes longer than ``scaffolded``, whose columns may stand where the tool has
        to be.
        """
        design = self
        while design.blocked:
            options = [
                option
                for column in design._all_columns()
                if not (option := design._with(column)).shut_in
                or not self.rules.removable
            ]
            best = min(
                options,
                key=lambda o: (len(o.blocked), len(o.shut_in), len(o.temporary)),
                default=design,
            )
            if len(best.blocked) >= len(design.blocked):
                return None
            design = best
        return design

    def _with(self, column: Iterable[PlacedBrick]) -> Design:
        return replace(self, temporary=(*self.temporary, *column))

    def _all_columns(self) -> Iterator[tuple[PlacedBrick, ...]]:
        """Yield a bounded number of columns below the smallest blocking set and its carriers."""
        every = (
            column
            for item in self._with_carriers(sorted(self.blocking_set()))
            for column in self._columns_below(item, beyond=self.rules.ground)
        )
        yield from islice(every, _MOST_COLUMNS)

    def _columns_below(
        self, item: PlacedBrick, beyond: Collection[tuple[int, int]] = ()
    ) -> Iterator[tuple[PlacedBrick, ...]]:
        types = self.rules.types or tuple(BRICKS.values())
        return supporting_columns(item, self.structures.filled, types, beyond=beyond)

    def _with_carriers(self, front: list[str]) -> Iterator[PlacedBrick]:
        """Yield bricks, then their carriers, then the carriers of those."""
        bricks, seen = self.structures.bricks, set(front)
        every = frozenset(bricks)
        while front:
            yield from (bricks[name] for name in front)
            below = (n for up in front for n in self.structures.below(every, up))
            front = sorted({n for n in below if n is not None} - seen)
            seen.update(front)
