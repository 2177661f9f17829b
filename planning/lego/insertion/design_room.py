"""Bricks of a design that obstruct the tool, for every press of a brick and every support.

They are computed once for the whole design. In a partial structure, a press or a support is unobstructed if none of
these bricks is present.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import chain, product

import numpy as np

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    STUD_PITCH,
    Cell,
    GridPlace,
    PlacedBrick,
    Press,
    Support,
)
from planning.lego.bricks.grid import level_height
from planning.lego.insertion.rules import InsertionMethod
from planning.lego.insertion.tool_room import (
    PLATE,
    Approach,
    BrickBoxes,
    blocking_bricks,
    brick_box,
    tool_room,
)
from planning.lego.skills.support_targets import ORIENTATIONS
from planning.lego.skills.targets import APPROACH_HEIGHT, HIGH_APPROACH
from planning.lego.stability.contacts import ToolHold
from planning.lego.stability.partial_structures import Names
from planning.transforms import Array

_LEAST_TOUCH = 0.002
"""Faces that overlap by less on a side do not touch [m]."""

_CLEARANCE = 0.001
"""Room that a support keeps from bricks that it does not touch [m]."""

_NONE: Names = frozenset()

_APPROACHES = tuple(product((1, -1), (APPROACH_HEIGHT, HIGH_APPROACH)))
"""Sides and heights that a brick may come from, from above."""

_TIP_SHIFTS = ((0, 0), (-1, 0), (0, -1))
"""Shifts of a supporting tool's cell by which its tip still covers a stud."""

Point = tuple[float, float]

_LEVELS = {
    InsertionMethod.DOWN_HELD_BELOW: (-9, -6, -12, -8, -7, -10, -11, -5, -4),
    InsertionMethod.UP: (9, 12, 8, 7, 6, 5, 10, 11),
    InsertionMethod.DOWN_HELD_ABOVE: (),
}
"""Levels of a support's cell from the contact of the press that are looked at first, those of
whole layers before the others."""

_SHIFTS = (0, -1, 1)
"""Offsets of the tip from the contact, in x and in y [studs]."""


@dataclass(frozen=True)
class SupportPlace:
    """A supporting tool among the bricks of a design.

    Attributes:
        support: where the tool is.
        touches: where it touches each brick that it touches.
        blockers: bricks that it would run into, the plate included.
        near: further bricks that it passes within a millimetre.
    """

    support: Support
    touches: Mapping[str, tuple[ToolHold, ...]]
    blockers: Names = _NONE
    near: Names = _NONE


class DesignRoom:
    """Obstacles of the tool among the bricks of one design, each computed at most once.

    Args:
        bricks: of the design, by name.
        filled: the brick in each place of the grid.
        robot: the registered robot that carries the tool.
    """

    def __init__(
        self,
        bricks: Mapping[str, PlacedBrick],
        filled: Mapping[GridPlace, str],
        robot: str,
    ) -> None:
        self._tool = tool_room(robot)
        self._bricks, self._filled = bricks, filled
        self._others = cache(lambda brick: self._boxes.without({brick}))
        self._blockers = cache(self._find_blockers)
        self._touching = cache(self._find_touching)
        self._supports: dict[Support, SupportPlace] = {}

    def press_obstacles(
        self, brick: str, press: Press, names: Names, *, up: bool
    ) -> Names:
        """Return which of the present bricks, or the plate, block a press.

        A brick that goes in from above may come from either side, low or high over its
        neighbours: one way that is free will do.
        """
        there = (names - {brick}) | {PLATE}
        found = self._blockers(brick, press, up) & there
        if found or up:
            return found
        first: Names | None = None
        for approach in _APPROACHES:
            found = self._blockers(brick, press, up, approach) & there
            if not found:
                return found
            first = first or found
        return first or _NONE

    def _find_blockers(
        self, brick: str, press: Press, up: bool, approach: Approach | None = None
    ) -> Names:
        """Return the obstacles in the design to a press, or to one approach direction."""
        item, others = self._bricks[brick], self._others(brick)
        if approach is not None:
            return frozenset(self._tool.approach_blocked(item, press, others, approach))
        return frozenset(self._tool.place_blocked(item, press, others, up=up))

    def support(self, support: Support) -> SupportPlace:
        """Return the contacts and obstacles of a supporting tool."""
        known = self._supports.get(support)
        if known is None:
            room = self._tool.support(support)
            touches = self._touches(support, room.face)
            known = SupportPlace(support, touches)
            if touches:
                blockers = frozenset(blocking_bricks(room.boxes, self._boxes))
                others = self._boxes.without(touches.keys())
                near = frozenset(
                    blocking_bricks(room.boxes, others, clearance=_CLEARANCE)
                )
                known = SupportPlace(support, touches, blockers, near - blockers)
            self._supports[support] = known
        return known

    def touching(self, brick: str, *, from_above: bool) -> list[SupportPlace]:
        """Return the supporting tools that touch a brick and are clear of the plate."""
        return self._touching(from_above)[brick]

    def _find_touching(self, from_above: bool) -> dict[str, list[SupportPlace]]:
        found: dict[str, list[SupportPlace]] = {name: [] for name in self._bricks}
        for support in self._all_supports(from_above):
            place = self.support(support)
            if PLATE not in place.blockers:
                for name in place.touches:
                    found[name].append(place)
        return found

    def possible_holds(
        self,
        brick: str,
        touchable: Iterable[str],
        obstacles: Names,
        approach: InsertionMethod,
    ) -> tuple[ToolHold, ...]:
        """Return pushes that bound those of any supporting tool with room, and of all of them together.

        Wherever a tool touches a brick, it does no more than pushes on the corners of its face. No
        tool may touch the brick that is pressed on, or run into obstacles.
        """
        top = approach.holds_from_above
        return tuple(
            hold
            for other in touchable
            if other != brick
            and _extent(self._corners[brick], self._corners[other]) >= approach.apart
            and any(
                brick not in place.touches and place.blockers.isdisjoint(obstacles)
                for place in self.touching(other, from_above=top)
            )
            for hold in _pushes(other, self._corners[other], top=top)
        )

    def _all_supports(self, from_above: bool) -> Iterator[Support]:
        """Yield the poses of the supporting tool at the tops or bottoms of all bricks."""
        found = set()
        for item in self._bricks.values():
            level = item.span.top if from_above else item.span.bottom - BRICK_LEVELS
            if level >= 0:
                found |= {
                    (x + dx, y + dy, level)
                    for x, y in (item.knobs if from_above else item.studs)
                    for dx, dy in _TIP_SHIFTS
                }
        for (x, y, level), turn in product(sorted(found), ORIENTATIONS):
            yield Support(Cell.at_level(x, y, level), turn, from_above)

    def attack(self, brick: str, press: Press, names: Names, *, up: bool) -> int:
        """Return +1 or -1: the side of the approach with a brick, past no neighbour if possible."""
        others = self._boxes.without(self._bricks.keys() - names | {brick})
        return self._tool.attack_side(self._bricks[brick], press, others, up=up)

    @cached_property
    def _boxes(self) -> BrickBoxes:
        corners = [brick_box(item) for item in self._bricks.values()]
        return BrickBoxes(tuple(self._bricks), np.array(corners).reshape(-1, 2, 3))

    @cached_property
    def _corners(self) -> dict[str, Array]:
        return dict(zip(self._boxes.names, self._boxes.corners, strict=True))

    def _touches(
        self, support: Support, rectangle: Array
    ) -> dict[str, tuple[ToolHold, ...]]:
        """Return the contact points of a supporting tool with bricks: the corners of the shared areas."""
        top, (low, high) = support.from_above, rectangle
        face = support.cell.level + (0 if top else BRICK_LEVELS)
        level, height = face - 1 if top else face, level_height(face)
        xs = range(int(low[0] // STUD_PITCH), int(high[0] // STUD_PITCH) + 1)
        ys = range(int(low[1] // STUD_PITCH), int(high[1] // STUD_PITCH) + 1)
        names = {self._filled.get((x, y, level)) for x, y in product(xs, ys)} - {None}
        out = {}
        for name in sorted(str(n) for n in names):
            span = self._bricks[name].span
            if face != (span.top if top else span.bottom):
                continue
            least, most = self._corners[name]
            shared = np.array([np.maximum(low, least), np.minimum(high, most)])
            shared[:, 2] = height
            if (shared[1, :2] - shared[0, :2] > _LEAST_TOUCH).all():
                out[name] = _pushes(name, shared, top=top)
        return out


def _pushes(brick: str, box: Array, *, top: bool) -> tuple[ToolHold, ...]:
    """Return pushes on the corners of the bottom of a box, or of its top."""
    (x0, y0, z0), (x1, y1, z1) = box.tolist()
    sign, height = (-1, z1) if top else (1, z0)
    corners = product((x0, x1), (y0, y1))
    return tuple(ToolHold(brick, sign, (x, y, height)) for x, y in corners)


def _extent(one: Array, other: Array) -> float:
    """Return the extent of two boxes together, along x plus along y [m]."""
    far = np.maximum(one[1], other[1]) - np.minimum(one[0], other[0])
    return float(far[0] + far[1])


@dataclass(frozen=True)
class SupportSpot:
    """A spot where a supporting tool touches bricks and has room.

    Attributes:
        support: cell and orientation of the tool.
        holds: where it touches bricks.
        tight: True when it passes other bricks within a millimetre.
    """

    support: Support
    holds: tuple[ToolHold, ...]
    tight: bool

    def away(self, at: Point) -> float:
        """Return the distance of its contacts from a point, along x plus along y [m]."""
        n = len(self.holds)
        x, y = (sum(hold.point[k] for hold in self.holds) / n for k in (0, 1))
        return abs(x - at[0]) + abs(y - at[1])


@dataclass(frozen=True)
class SupportSpots:
    """Finds support positions of the other arm for one partial structure.

    Attributes:
        room: of the tool in the design.
        names: the bricks that are there: they may be touched, and are in the tool's way.
        inserted: the brick that is pressed on: held itself, it would not go in.
    """

    room: DesignRoom
    names: Names
    inserted: str

    def found(
        self, approach: InsertionMethod, contact: Cell, at: Point
    ) -> Iterator[SupportSpot]:
        """Yield the spots: those next to the press first, then the others by distance.

        Args:
            approach: how the brick is pressed on.
            contact: cell of the press.
            at: middle of the press, in the plate's frame [m].
        """
        levels, top = _LEVELS[approach], approach.holds_from_above
        nearby = [
            Support(
                Cell.at_level(contact.x + dx, contact.y + dy, contact.level + k),
                turn,
                top,
            )
            for k, dx, dy, turn in product(levels, _SHIFTS, _SHIFTS, ORIENTATIONS)
        ]

        def order(spot: SupportSpot) -> tuple[bool, int, float]:
            rank = levels.index(spot.support.cell.level - contact.level)
            return spot.tight, rank, round(spot.away(at), 9)

        yield from sorted(filter(None, map(self._spot, nearby)), key=order)
        tried = set(nearby)
        for support in self._touching_positions(at, from_above=top):
            if support not in tried:
                spot = self._spot(support)
                if spot is not None and spot.away(at) >= approach.apart:
                    yield spot

    def _spot(self, support: Support) -> SupportSpot | None:
        """Return a tool position as a spot, None where it touches nothing or has no room."""
        if support.cell.level < 0:
            return None
        place = self.room.support(support)
        if PLATE in place.blockers or not place.blockers.isdisjoint(self.names):
            return None
        touched = [n for n in place.touches if n in self.names]
        if not touched or self.inserted in touched:
            return None
        holds = tuple(chain.from_iterable(place.touches[n] for n in touched))
        return SupportSpot(support, holds, not place.near.isdisjoint(self.names))

    def _touching_positions(self, at: Point, *, from_above: bool) -> list[Support]:
        """Return the tool positions that touch bricks, nearest first."""
        found = {
            place.support
            for name in self.names
            for place in self.room.touching(name, from_above=from_above)
        }

        def order(s: Support) -> tuple[float, int, int, int, int]:
            x, y = s.cell.x, s.cell.y
            away = abs((x + 0.5) * STUD_PITCH - at[0])
            away += abs((y + 0.5) * STUD_PITCH - at[1])
            return round(away, 9), s.cell.level, x, y, s.orientation

        return sorted(found, key=order)
