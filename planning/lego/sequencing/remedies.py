"""Temporary bricks that make a structure buildable: a plinth, and scaffolding where it is blocked.

Which helpers can be taken out of a finished structure again, and behind what the others stay.

Temporary bricks stay until the structure is lifted off the plate; what stands from the start stays
behind with it. Then a helper comes off its knobs straight up or down, and from there on moves in any
way along the grid until it is outside. One is taken at a time. Taking one makes room for others and
takes none away, so that helpers are taken as they come, and those that remain at the end remain in
any order. Hands, the force of pulling, and helpers that would come out together are not looked at.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice, product

from planning.lego.bricks.assembly import (
    BRICKS,
    BrickType,
    Cell,
    GridPlace,
    GridSpan,
    PlacedBrick,
)
from planning.lego.insertion.insertion import Insertions
from planning.lego.insertion.rules import SequencingRules
from planning.lego.sequencing.blocking import remaining, smallest_blocking_set
from planning.lego.stability.partial_structures import Names, PartialStructures


def columns_below(
    item: PlacedBrick,
    filled: Mapping[GridPlace, str],
    types: Collection[BrickType],
    *,
    beyond: Collection[tuple[int, int]] = (),
) -> Iterator[tuple[PlacedBrick, ...]]:
    """Yield columns that would carry a brick where there is nothing below it, the widest first.

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
    for brick in types:
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
    """Return a column up to a level from what stands below it; none where heights do not add up."""
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


_MOST_COLUMNS = 40
"""So many places for a column are tried at once."""


@dataclass(frozen=True, eq=False)
class Design:
    """A structure with the temporary bricks that it needs, and what is known of its bricks.

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
        """Names of the bricks that are put in."""
        return frozenset(item.name for item in (*self.structure, *self.temporary))

    @cached_property
    def insertions(self) -> Insertions:
        """How bricks go in."""
        bricks = [*self.structure, *self.temporary]
        return Insertions.of(bricks, self.fixed, self.rules)

    @property
    def structures(self) -> PartialStructures:
        """What stands and what it bears."""
        return self.insertions.structures

    @cached_property
    def shut_in(self) -> tuple[ShutIn, ...]:
        """Temporary bricks that cannot be taken out again."""
        names = frozenset(item.name for item in self.temporary)
        return shut_in((*self.structure, *self.temporary), names)

    def on_plinth(self) -> Design:
        """Return it raised on the plinth that the rules ask for."""
        raised, plinth = on_plinth(self.structure, self.rules.plinth)
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
        """Return a column under a brick, or under the nearest of its carriers with room for one."""
        for item in self._with_carriers([name]):
            column = self._best(self._columns_below(item))
            if column or not carriers:
                return column
        return ()

    def _best(
        self, columns: Iterable[tuple[PlacedBrick, ...]]
    ) -> tuple[PlacedBrick, ...]:
        """Return the first column that shuts no temporary brick in, or else the first.

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
        """Return the bricks that remain when all that might go in last are set aside."""
        return remaining(self.order(), self.insertions.perhaps)

    def blocking_set(self) -> Names:
        """Return a smallest set of bricks of which none can be the last one in."""
        some = (name for name in self.order() if name in self.blocked)
        return smallest_blocking_set(some, self.insertions.perhaps)

    def scaffolded(self) -> Design:
        """Return it with scaffolding under bricks that could not go in otherwise.

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
        """Return it with columns at the places that leave the fewest bricks blocked, None for none.

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
        """Yield a bounded number of columns below the smallest blocking set and what carries it."""
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
        return columns_below(item, self.structures.filled, types, beyond=beyond)

    def _with_carriers(self, front: list[str]) -> Iterator[PlacedBrick]:
        """Yield bricks, then what is below them, then what is below that."""
        bricks, seen = self.structures.bricks, set(front)
        every = frozenset(bricks)
        while front:
            yield from (bricks[name] for name in front)
            below = (n for up in front for n in self.structures.below(every, up))
            front = sorted({n for n in below if n is not None} - seen)
            seen.update(front)


_VERTICAL = ((0, 0, -1), (0, 0, 1))
_ASIDE = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))

_NAMED = 4
"""So many of the bricks in the way of a helper are named."""


@dataclass(frozen=True)
class ShutIn:
    """A helper that cannot be taken out any more.

    Attributes:
        brick: the helper.
        behind: what is in its way, what it is pressed onto first.
    """

    brick: PlacedBrick
    behind: tuple[PlacedBrick, ...]

    @property
    def words(self) -> str:
        """The helper and what it is behind, in one phrase."""
        named = [_place(item) for item in self.behind[:_NAMED]]
        more = len(self.behind) - len(named)
        named += [f"{more} more"] if more else []
        return f"{_place(self.brick)} is shut in behind {', '.join(named)}"


def shut_in(
    bricks: Iterable[PlacedBrick], helpers: frozenset[str]
) -> tuple[ShutIn, ...]:
    """Return the helpers that cannot be taken out of a finished structure, the lowest first.

    Args:
        bricks: of the structure with its helpers, without what stays behind with the plate.
        helpers: names of those that are to be taken out.
    """
    known = {item.name: item for item in bricks}
    filled = {place: item.name for item in known.values() for place in item.places}
    left = sorted(helpers, key=lambda name: (known[name].cell.level, name))
    ways: dict[str, _WayOut] = {}
    while left:
        kept = []
        for name in left:
            ways[name] = way = _WayOut.of(known[name], filled)
            if way.outside:
                for place in known[name].places:
                    del filled[place]
            else:
                kept.append(name)
        if len(kept) == len(left):
            break
        left = kept
    return tuple(
        ShutIn(known[name], tuple(known[n] for n in ways[name].hits)) for name in left
    )


@dataclass(frozen=True)
class _WayOut:
    """How far a brick gets among others.

    Attributes:
        outside: whether it gets out.
        hits: what it runs into on all its ways, those at its own knobs first.
    """

    outside: bool
    hits: tuple[str, ...]

    @staticmethod
    def of(item: PlacedBrick, filled: Mapping[GridPlace, str]) -> _WayOut:
        """Search all ways of a brick along the grid, straight ones first."""
        own, span = item.places, item.span
        around = _bounds(place for place in filled if place not in own)
        hits: dict[str, None] = {}

        def clear(at: GridPlace, margin: int) -> bool:
            """Tell whether it is clear of others with so many levels above and below it."""
            rows = range(span.bottom - margin, span.top + margin)
            found = [
                name
                for (x, y), z in product(item.studs, rows)
                if (place := (x + at[0], y + at[1], z + at[2])) not in own
                and (name := filled.get(place)) is not None
            ]
            hits.update(dict.fromkeys(sorted(found)))
            return not found

        seen: set[GridPlace] = {(0, 0, 0)}
        todo: list[GridPlace] = [(0, 0, 0)]
        while todo:
            at = todo.pop()
            if around is None or _is_outside(span, at, around):
                return _WayOut(True, ())
            # Off its knobs it may move aside: neither its own nor those of others are in the way.
            ways = _ASIDE if at != (0, 0, 0) and clear(at, 1) else ()
            for way, margin in (*((w, 1) for w in ways), *((w, 0) for w in _VERTICAL)):
                after = (at[0] + way[0], at[1] + way[1], at[2] + way[2])
                if after not in seen and clear(after, margin):
                    seen.add(after)
                    todo.append(after)
        return _WayOut(False, tuple(hits))


def _bounds(places: Iterable[GridPlace]) -> GridSpan | None:
    """Return the room of some places, None for none."""
    axes = list(zip(*places, strict=True))
    if not axes:
        return None
    (x0, x1), (y0, y1), (z0, z1) = ((min(axis), max(axis) + 1) for axis in axes)
    return GridSpan(x0, x1, y0, y1, z0, z1)


def _is_outside(span: GridSpan, at: GridPlace, around: GridSpan) -> bool:
    x, y, z = at
    return (
        span.x1 + x <= around.x0
        or span.x0 + x >= around.x1
        or span.y1 + y <= around.y0
        or span.y0 + y >= around.y1
        or span.top + z <= around.bottom
        or span.bottom + z >= around.top
    )


def _place(item: PlacedBrick) -> str:
    return f"{item.name!r} ({item.brick.name} at {item.cell.words})"
