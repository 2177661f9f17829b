"""Spots where the other arm may hold a structure while a brick is pressed on.

From below, the level tip of the tool pushes up against the bottoms of bricks; from above, the
upright tool stands on their studs. The published code looks beside the press only (shifts of up
to a stud, a few layers), which comes first here; then come all others, by distance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, product

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    STUD_PITCH,
    Cell,
    Support,
)
from planning.lego.insertion.design_room import TIP_SHIFTS, DesignRoom, support_at
from planning.lego.insertion.tool_room import PLATE
from planning.lego.skills.targets import ORIENTATIONS
from planning.lego.stability.partial_structures import Names, PartialStructures
from planning.lego.stability.stability import Hold

Point = tuple[float, float]

_BELOW = (-9, -6, -12, -8, -7, -10, -11, -5, -4)
_ABOVE = (9, 12, 8, 7, 6, 5, 10, 11)
"""Levels of a support's cell from the contact of the press, those of whole layers first."""
_SHIFTS = (0, -1, 1)
"""Studs by which it is aside from the contact, in x and in y."""

TOOLS_APART = 0.095
"""Two upright tools whose axes are nearer than this meet at their force sensors [m]."""


@dataclass(frozen=True)
class SupportSpot:
    """A spot where a supporting tool touches bricks and has room.

    Attributes:
        support: cell and orientation of the tool.
        holds: where it touches bricks.
        tight: True when it passes other bricks within a millimetre.
    """

    support: Support
    holds: tuple[Hold, ...]
    tight: bool

    def away(self, at: Point) -> float:
        """Return the distance of what it touches from a point, along x plus along y [m]."""
        n = len(self.holds)
        x, y = (sum(hold.point[k] for hold in self.holds) / n for k in (0, 1))
        return abs(x - at[0]) + abs(y - at[1])


@dataclass(frozen=True)
class SupportSpots:
    """Finds where the other arm may hold one partial structure.

    Attributes:
        structures: of the design.
        room: of the tool in the design.
        touchable: the bricks that may be touched.
        obstacles: the bricks that are in the tool's way.
        inserted: the brick that is pressed on: held itself, it would not go in.
    """

    structures: PartialStructures
    room: DesignRoom
    touchable: Names
    obstacles: Names
    inserted: str

    def below(self, contact: Cell, at: Point) -> Iterator[SupportSpot]:
        """Yield the spots below bricks: those beside the press first, then the others by distance.

        Args:
            contact: cell of the press.
            at: middle of the press, in the plate's frame [m].
        """
        return self._spots(contact, at, _BELOW, from_above=False)

    def above(self, contact: Cell, at: Point) -> Iterator[SupportSpot]:
        """Yield the spots on top of bricks, for a press from below, in the same order."""
        return self._spots(contact, at, _ABOVE, from_above=True)

    def above_aside(self, at: Point) -> Iterator[SupportSpot]:
        """Yield the spots on top of bricks that leave room for a tool that presses from above."""
        for support in self._anywhere(at, from_above=True):
            spot = self.spot(support)
            if spot is not None and spot.away(at) >= TOOLS_APART:
                yield spot

    def spot(self, support: Support) -> SupportSpot | None:
        """Return a tool's place as a spot, None where it touches nothing or has no room."""
        if support.cell.level < 0:
            return None
        place = self.room.support(support)
        if PLATE in place.blockers or not place.blockers.isdisjoint(self.obstacles):
            return None
        touched = [n for n in place.touches if n in self.touchable]
        if not touched or self.inserted in touched:
            return None
        holds = tuple(chain.from_iterable(place.touches[n] for n in touched))
        return SupportSpot(support, holds, not place.near.isdisjoint(self.obstacles))

    def _spots(
        self, contact: Cell, at: Point, levels: tuple[int, ...], *, from_above: bool
    ) -> Iterator[SupportSpot]:
        turns = ORIENTATIONS
        beside = [
            support_at(
                contact.x + dx,
                contact.y + dy,
                contact.level + k,
                turn,
                from_above=from_above,
            )
            for k, dx, dy, turn in product(levels, _SHIFTS, _SHIFTS, turns)
        ]
        near = [spot for spot in map(self.spot, beside) if spot is not None]

        def order(spot: SupportSpot) -> tuple[bool, int, float]:
            rank = levels.index(spot.support.cell.level - contact.level)
            return spot.tight, rank, round(spot.away(at), 9)

        yield from sorted(near, key=order)
        tried = set(beside)
        for support in self._anywhere(at, from_above=from_above):
            if support not in tried:
                spot = self.spot(support)
                if spot is not None:
                    yield spot

    def _anywhere(self, at: Point, *, from_above: bool) -> list[Support]:
        """Return the tool's places at all bare tops or bottoms of bricks, nearest first."""
        filled = self.structures.filled
        step = 1 if from_above else -BRICK_LEVELS
        beyond = 1 if from_above else -1
        bare = {
            (x, y, level + step)
            for (x, y, level), name in filled.items()
            if name in self.touchable and name != self.inserted
            for other in [filled.get((x, y, level + beyond))]
            if other is None or (other != name and other not in self.obstacles)
        }
        found = {
            support_at(x + dx, y + dy, level, turn, from_above=from_above)
            for x, y, level in bare
            for dx, dy in TIP_SHIFTS
            for turn in ORIENTATIONS
        }

        def order(s: Support) -> tuple[float, int, int, int, int]:
            away = abs((s.x + 0.5) * STUD_PITCH - at[0])
            away += abs((s.y + 0.5) * STUD_PITCH - at[1])
            return round(away, 9), s.cell.level, s.x, s.y, s.orientation

        return sorted(found, key=order)
