"""Removal of temporary bricks from a finished structure, and detection of those that are trapped.

The finished structure is lifted off the plate; bricks that were present from the start stay on the plate. Then
temporary bricks are removed one at a time. A temporary brick is pulled straight up or down off its knobs, and then
moves in any direction along the grid until it is outside. A removal only makes space for others, so the trapped
bricks do not depend on the order. Hands, pulling forces, and simultaneous removals are not modelled.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import product

from planning.lego.bricks.assembly import GridPlace, GridSpan, PlacedBrick

_VERTICAL = ((0, 0, -1), (0, 0, 1))
_ASIDE = ((1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0))

_NAMED = 4
"""Greatest number of blocking bricks to name."""


@dataclass(frozen=True)
class UnremovableBrick:
    """A temporary brick that can no longer be removed.

    Attributes:
        brick: the helper.
        behind: the bricks that block it, those it is pressed onto first.
    """

    brick: PlacedBrick
    behind: tuple[PlacedBrick, ...]

    @property
    def words(self) -> str:
        """The temporary brick and what blocks it, in one phrase."""
        named = [_place(item) for item in self.behind[:_NAMED]]
        more = len(self.behind) - len(named)
        named += [f"{more} more"] if more else []
        return f"{_place(self.brick)} is shut in behind {', '.join(named)}"


def find_unremovable_bricks(
    bricks: Iterable[PlacedBrick], helpers: frozenset[str]
) -> tuple[UnremovableBrick, ...]:
    """Return the temporary bricks trapped in a finished structure, lowest first.

    Args:
        bricks: of the structure with its helpers, without what stays behind with the plate.
        helpers: names of those that are to be taken out.
    """
    known = {item.name: item for item in bricks}
    filled = {place: item.name for item in known.values() for place in item.places}
    left = sorted(helpers, key=lambda name: (known[name].cell.level, name))
    searches: dict[str, _ExitSearch] = {}
    while left:
        kept = []
        for name in left:
            searches[name] = search = _ExitSearch.of(known[name], filled)
            if search.outside:
                for place in known[name].places:
                    del filled[place]
            else:
                kept.append(name)
        if len(kept) == len(left):
            break
        left = kept
    return tuple(
        UnremovableBrick(known[name], tuple(known[n] for n in searches[name].hits))
        for name in left
    )


@dataclass(frozen=True)
class _ExitSearch:
    """Search for an exit path of a brick among others.

    Attributes:
        outside: whether it gets out.
        hits: obstacles on all its paths, those at its own knobs first.
    """

    outside: bool
    hits: tuple[str, ...]

    @staticmethod
    def of(item: PlacedBrick, filled: Mapping[GridPlace, str]) -> _ExitSearch:
        """Search all paths of a brick along the grid, straight ones first."""
        own, span = item.places, item.span
        around = _bounds(place for place in filled if place not in own)
        hits: dict[str, None] = {}

        def clear(at: GridPlace, margin: int) -> bool:
            """Tell whether it is clear of others within a number of levels above and below it."""
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
                return _ExitSearch(True, ())
            # Off its knobs it may move sideways: neither its own nor those of others are in the way.
            moves = _ASIDE if at != (0, 0, 0) and clear(at, 1) else ()
            for move, margin in (
                *((w, 1) for w in moves),
                *((w, 0) for w in _VERTICAL),
            ):
                after = (at[0] + move[0], at[1] + move[1], at[2] + move[2])
                if after not in seen and clear(after, margin):
                    seen.add(after)
                    todo.append(after)
        return _ExitSearch(False, tuple(hits))


def _bounds(places: Iterable[GridPlace]) -> GridSpan | None:
    """Return the block around some places, None for none."""
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
