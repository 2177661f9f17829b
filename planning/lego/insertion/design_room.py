"""Which bricks of a design stand in the tool's way, for every press and every supporting spot.

Worked out once for the whole design: a press or a support has room in a partial structure when
none of those bricks is there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
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
from planning.lego.insertion.rules import TOOLS_APART
from planning.lego.insertion.tool_room import (
    PLATE,
    Approach,
    BrickBoxes,
    blocking,
    brick_box,
    tool_room,
)
from planning.lego.skills.targets import APPROACH_HEIGHT, HIGH_APPROACH, ORIENTATIONS
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


TIP_SHIFTS = ((0, 0), (-1, 0), (0, -1))
"""Shifts of a supporting tool's cell by which its tip still covers a stud."""


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
    blockers: Names
    near: Names


class DesignRoom:
    """Obstacles of the tool among the bricks of one design; each is worked out at most once.

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
        self._ways: dict[tuple[str, Press, bool, Approach | None], Names] = {}
        self._without: dict[str, BrickBoxes] = {}
        self._supports: dict[Support, SupportPlace] = {}
        self._touching: dict[bool, dict[str, list[SupportPlace]]] = {}

    def in_the_way(self, brick: str, press: Press, names: Names, *, up: bool) -> Names:
        """Return which of some bricks stand in the way of a press; none where it has room.

        A brick that goes in from above may come from either side, low or high over its
        neighbours: one way that is free will do.

        Args:
            brick: that is pressed on.
            press: the grip.
            names: the bricks that are there; the plate always is.
            up: True for a place-up.
        """
        there = (names - {brick}) | {PLATE}
        found = self._blockers(brick, press, up, None) & there
        if found or up:
            return found
        first: Names | None = None
        for way in _APPROACHES:
            found = self._blockers(brick, press, up, way) & there
            if not found:
                return found
            first = first or found
        return first or _NONE

    def _blockers(
        self, brick: str, press: Press, up: bool, way: Approach | None
    ) -> Names:
        """Return the obstacles in the design to a press, or to one way to come to it."""
        key = (brick, press, up, way)
        known = self._ways.get(key)
        if known is None:
            item, others = self._bricks[brick], self._others(brick)
            if way is not None:
                found = self._tool.approach_blocked(item, press, others, way)
            elif up:
                found = self._tool.place_up_blocked(item, press, others)
            else:
                found = self._tool.place_down_blocked(item, press, others)
            known = self._ways[key] = frozenset(found)
        return known

    def _others(self, brick: str) -> BrickBoxes:
        if brick not in self._without:
            self._without[brick] = self._boxes.without({brick})
        return self._without[brick]

    def support(self, support: Support) -> SupportPlace:
        """Return what a supporting tool touches, and what stands in its way."""
        known = self._supports.get(support)
        if known is None:
            room = self._tool.support(support)
            touches = self._touches(support, room.face)
            if not touches:
                known = SupportPlace(support, {}, _NONE, _NONE)
                self._supports[support] = known
                return known
            blockers = frozenset(blocking(room.boxes, self._boxes))
            others = self._boxes.without(touches.keys())
            near = (
                frozenset(blocking(room.boxes, others, clearance=_CLEARANCE)) - blockers
            )
            known = SupportPlace(support, touches, blockers, near)
            self._supports[support] = known
        return known

    def touching(self, brick: str, *, from_above: bool) -> tuple[SupportPlace, ...]:
        """Return the supporting tools that touch a brick and are not in the plate's way."""
        if from_above not in self._touching:
            found: dict[str, list[SupportPlace]] = {name: [] for name in self._bricks}
            for support in self._all_supports(from_above):
                place = self.support(support)
                if PLATE not in place.blockers:
                    for name in place.touches:
                        found[name].append(place)
            self._touching[from_above] = found
        return tuple(self._touching[from_above][brick])

    def holds_anywhere(
        self,
        brick: str,
        touchable: Iterable[str],
        obstacles: Names,
        *,
        from_above: bool,
        apart: float = 0.0,
    ) -> tuple[ToolHold, ...]:
        """Return pushes that are worth any supporting tool that has room, and all of them at once.

        Wherever a tool touches a brick, it does no more than pushes on the corners of its face.

        Args:
            brick: that is pressed on, which no supporting tool may touch.
            touchable: bricks that may be held.
            obstacles: bricks that a tool may not run into.
            from_above: whether tools stand on bricks, or hold them from below.
            apart: distance that a tool keeps from where the brick is pressed [m].
        """
        return tuple(
            hold
            for other in touchable
            if other != brick
            and _extent(self._corners[brick], self._corners[other]) >= apart
            and any(
                brick not in place.touches and place.blockers.isdisjoint(obstacles)
                for place in self.touching(other, from_above=from_above)
            )
            for hold in self.face(other, top=from_above)
        )

    def face(self, brick: str, *, top: bool) -> tuple[ToolHold, ...]:
        """Return pushes on the corners of a brick's bottom, or top: what any touch there amounts to."""
        (x0, y0, z0), (x1, y1, z1) = self._corners[brick].tolist()
        sign, height = (-1, z1) if top else (1, z0)
        return tuple(
            ToolHold(brick, sign, (x, y, height))
            for x, y in product((x0, x1), (y0, y1))
        )

    def _all_supports(self, from_above: bool) -> Iterator[Support]:
        """Yield the tool's places at the tops or bottoms of all bricks."""
        found = set()
        for item in self._bricks.values():
            span = item.span
            level = span.top if from_above else span.bottom - BRICK_LEVELS
            if level >= 0:
                found |= {
                    (x + dx, y + dy, level)
                    for x, y in item.studs
                    for dx, dy in TIP_SHIFTS
                }
        for (x, y, level), turn in product(sorted(found), ORIENTATIONS):
            yield Support(Cell.at_level(x, y, level), turn, from_above)

    def attack(self, brick: str, press: Press, names: Names, *, up: bool) -> int:
        """Return +1 or -1: the side to come from with a brick, past no neighbour if possible."""
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
        """Return where a supporting tool touches bricks: the corners of what they share."""
        top, (low, high) = support.from_above, rectangle
        face = support.cell.level + (0 if top else BRICK_LEVELS)
        level, height = face - 1 if top else face, level_height(face)
        xs = range(int(low[0] // STUD_PITCH), int(high[0] // STUD_PITCH) + 1)
        ys = range(int(low[1] // STUD_PITCH), int(high[1] // STUD_PITCH) + 1)
        names = {self._filled.get((x, y, level)) for x, y in product(xs, ys)} - {None}
        out = {}
        for name in sorted(str(n) for n in names):
            item = self._bricks[name]
            span = item.span
            if face != (span.top if top else span.bottom):
                continue
            box = self._corners[name]
            x0, y0 = (max(float(low[k]), float(box[0, k])) for k in (0, 1))
            x1, y1 = (min(float(high[k]), float(box[1, k])) for k in (0, 1))
            if x1 - x0 > _LEAST_TOUCH and y1 - y0 > _LEAST_TOUCH:
                sign = -1 if top else 1
                corners = product((x0, x1), (y0, y1))
                out[name] = tuple(
                    ToolHold(name, sign, (x, y, height)) for x, y in corners
                )
        return out


def _extent(one: Array, other: Array) -> float:
    """Return how far two boxes reach together, along x plus along y [m]."""
    far = np.maximum(one[1], other[1]) - np.minimum(one[0], other[0])
    return float(far[0] + far[1])


Point = tuple[float, float]

_BELOW = (-9, -6, -12, -8, -7, -10, -11, -5, -4)
_ABOVE = (9, 12, 8, 7, 6, 5, 10, 11)
"""Levels of a support's cell from the contact of the press, those of whole layers first."""
_SHIFTS = (0, -1, 1)
"""Studs by which it is aside from the contact, in x and in y."""


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
        """Return the distance of what it touches from a point, along x plus along y [m]."""
        n = len(self.holds)
        x, y = (sum(hold.point[k] for hold in self.holds) / n for k in (0, 1))
        return abs(x - at[0]) + abs(y - at[1])


@dataclass(frozen=True)
class SupportSpots:
    """Finds where the other arm may hold one partial structure.

    Attributes:
        room: of the tool in the design.
        names: the bricks that are there: they may be touched, and are in the tool's way.
        inserted: the brick that is pressed on: held itself, it would not go in.
    """

    room: DesignRoom
    names: Names
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
        if PLATE in place.blockers or not place.blockers.isdisjoint(self.names):
            return None
        touched = [n for n in place.touches if n in self.names]
        if not touched or self.inserted in touched:
            return None
        holds = tuple(chain.from_iterable(place.touches[n] for n in touched))
        return SupportSpot(support, holds, not place.near.isdisjoint(self.names))

    def _spots(
        self, contact: Cell, at: Point, levels: tuple[int, ...], *, from_above: bool
    ) -> Iterator[SupportSpot]:
        turns = ORIENTATIONS
        nearby = [
            Support(
                Cell.at_level(contact.x + dx, contact.y + dy, contact.level + k),
                turn,
                from_above,
            )
            for k, dx, dy, turn in product(levels, _SHIFTS, _SHIFTS, turns)
        ]
        near = [spot for spot in map(self.spot, nearby) if spot is not None]

        def order(spot: SupportSpot) -> tuple[bool, int, float]:
            rank = levels.index(spot.support.cell.level - contact.level)
            return spot.tight, rank, round(spot.away(at), 9)

        yield from sorted(near, key=order)
        tried = set(nearby)
        for support in self._anywhere(at, from_above=from_above):
            if support not in tried:
                spot = self.spot(support)
                if spot is not None:
                    yield spot

    def _anywhere(self, at: Point, *, from_above: bool) -> list[Support]:
        """Return the tool's places that touch bricks, the nearest first."""
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
