"""Insertions of a brick into a structure: from above, with a support, or from below.

This is the pruning of APEX-MR App. A for one brick: the structure must bear the pressing force,
and the tools must have room.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    STUD_PITCH,
    Cell,
    LegoStep,
    PlacedBrick,
    Press,
    Support,
)
from planning.lego.bricks.grid import (
    Span,
    covered_studs,
    footprint,
    level_height,
    occupied_span,
)
from planning.lego.bricks.grips import press_cell, presses
from planning.lego.sequencing.tool_room import (
    BrickBoxes,
    attack_side,
    blocking,
    brick_box,
    place_down_blocked,
    place_up_blocked,
    support_boxes,
    support_face,
)
from planning.lego.skills.support import ORIENTATIONS
from planning.lego.stability.equilibrium import StabilityReport
from planning.lego.stability.partial_structures import Names, PartialStructures
from planning.lego.stability.stability import Hold, Load
from planning.transforms import Array

INSERTION_FORCE = 15.0
"""Force at which the published skills stop pressing (APEX-MR App. C) [N]."""

# Levels of a support's cell from the contact of the press, those of whole layers first.
_BELOW = (-9, -6, -12, -8, -7, -10, -11, -5, -4)
_ABOVE = (9, 12, 8, 7, 6, 5, 10, 11)
_SHIFTS = (0, -1, 1)
_LEAST_TOUCH = 0.002
_CLEARANCE = 0.001


@dataclass(frozen=True)
class Insertion:
    """An insertion of a brick into a structure.

    Attributes:
        up: True for a handover and then a place-up with a support-top.
        press: the grip.
        support: the supporting tool, None without one.
        score: bound of the structure's stability score while the brick is pressed.
    """

    up: bool
    press: Press
    support: Support | None
    score: float


@dataclass(frozen=True)
class InsertionRules:
    """Finds insertions of the bricks of one design.

    Attributes:
        structures: the partial structures of the design.
        force: insertion force [N].
    """

    structures: PartialStructures
    force: float = INSERTION_FORCE

    @cached_property
    def boxes(self) -> dict[str, Array]:
        """Least and greatest corner of each brick in the plate's frame, shape (2, 3) [m]."""
        return {n: brick_box(item) for n, item in self.structures.bricks.items()}

    @cached_property
    def spans(self) -> dict[str, Span]:
        """The room of each brick on the grid."""
        bricks = self.structures.bricks
        return {n: occupied_span(item.cell, item.brick) for n, item in bricks.items()}

    @cached_property
    def faces(self) -> tuple[frozenset[int], frozenset[int]]:
        """Levels of the bottoms of the bricks, and of their tops."""
        spans = self.spans.values()
        return frozenset(s.bottom for s in spans), frozenset(s.top for s in spans)

    def at(self, names: Names, brick: str, *, up: bool) -> InsertionSite:
        """Return the insertion site of a brick in a partial structure.

        Args:
            names: the partial structure with the brick in place.
            brick: the brick.
            up: True for a place-up.
        """
        return InsertionSite(self, names, self.structures.bricks[brick], up)


@dataclass(frozen=True)
class InsertionSite:
    """A brick that is put into a partial structure, from above or from below.

    Attributes:
        rules: of the design.
        names: the partial structure with the brick in place.
        item: the brick.
        up: True for a place-up.
    """

    rules: InsertionRules
    names: Names
    item: PlacedBrick
    up: bool

    def insertions(self, press: Press, *, held: bool) -> Iterator[Insertion]:
        """Yield the insertions with one press: alone, or held by each support that suffices."""
        supports: Iterable[tuple[Support | None, tuple[Hold, ...]]] = [(None, ())]
        if held:
            supports = self._roomy_supports(press)
        for support, holds in supports:
            report = self._pressed(press, holds)
            if report.stable:
                yield Insertion(self.up, press, support, report.score)

    def bears(self, press: Press, support: Support | None = None) -> StabilityReport:
        """Tell whether the structure bears a press, room for the tools set aside.

        Args:
            press: the grip.
            support: the supporting tool; one that touches no brick is as good as none.
        """
        return self._pressed(press, () if support is None else self._holds(support))

    def obstacle(self) -> str | None:
        """Return the reason why the brick cannot be inserted this way, None if it may be."""
        above, below = self._above, self._below
        if self.up:
            if below:
                return f"{_name(below[0])} is in the way below it"
            return None if above else "there is nothing above it to press it onto"
        if above:
            return f"{_name(above[0])} is in the way above it"
        return None if below else "there is nothing below it to press it onto"

    @cached_property
    def roomy_presses(self) -> tuple[Press, ...]:
        """The presses of the brick that leave the tool room, the central ones first."""
        return tuple(p for p in self._ordered_presses() if self._blocked(p) is None)

    def blocker(self) -> str:
        """Return the obstacle to the first press of the brick."""
        found = map(self._blocked, presses(self.item.brick))
        return next((name for name in found if name is not None), "nothing")

    def step(self, chosen: Insertion) -> LegoStep:
        """Return an insertion as a step of an assembly, with all its alternatives."""
        item, press = self.item, chosen.press
        others = (
            other
            for other in self.roomy_presses
            if other != press and self.bears(other, chosen.support).stable
        )
        held = self.insertions(press, held=chosen.support is not None)
        return LegoStep(
            brick=item.brick,
            cell=item.cell,
            up=self.up,
            presses=(press, *others),
            supports=tuple(i.support for i in held if i.support is not None),
            attack=attack_side(item, press, self._others, up=self.up),
        )

    @property
    def _above(self) -> tuple[str, ...]:
        return self.rules.structures.above(self.names, self.item.name)

    @property
    def _below(self) -> tuple[str | None, ...]:
        return self.rules.structures.below(self.names, self.item.name)

    @cached_property
    def _others(self) -> BrickBoxes:
        return self._boxes_of(self.names - {self.item.name})

    def _boxes_of(self, names: Names) -> BrickBoxes:
        some = tuple(sorted(names))
        corners = [self.rules.boxes[name] for name in some]
        return BrickBoxes(some, np.array(corners).reshape(-1, 2, 3))

    def _blocked(self, press: Press) -> str | None:
        blocked = place_up_blocked if self.up else place_down_blocked
        return blocked(self.item, press, self._others)

    def _pressed(self, press: Press, holds: Sequence[Hold]) -> StabilityReport:
        return self.rules.structures.pressed(
            self.names, self.item.name, self._loads(press), holds
        )

    def _roomy_supports(
        self, press: Press
    ) -> Iterator[tuple[Support, tuple[Hold, ...]]]:
        """Yield the supports that touch a brick and have room.

        Those that keep clear of other bricks come first, then those nearest to the press.

        They are sought as the published code does: shifted by up to one stud along x and y, 2
        to 4 layers below the contact of the press for a support-bottom, 3 or 4 above it for a
        support-top; where there are plates, on the levels between as well. One that touches the
        inserted brick itself would only keep it from going in.
        """
        contact = press_cell(self.item.cell, self.item.brick, press, up=self.up)
        x, y = self._press_point(press)
        boxes = self._boxes_of(self.names)
        levels = self._support_levels(contact)
        found: list[tuple[bool, int, float, Support, tuple[Hold, ...]]] = []
        for level, dx, dy, turn in product(levels, _SHIFTS, _SHIFTS, ORIENTATIONS):
            at = Cell.at_level(contact.x + dx, contact.y + dy, level)
            support = Support(at.x, at.y, at.z, turn, at.raised)
            holds = self._holds(support)
            touched = {hold.brick for hold in holds}
            if not touched or self.item.name in touched:
                continue
            room = support_boxes(support, top=self.up)
            if blocking(room, boxes) is not None:
                continue
            tight = blocking(room, boxes.without(touched), clearance=_CLEARANCE)
            mid = [sum(h.point[k] for h in holds) / len(holds) for k in (0, 1)]
            away = round(abs(mid[0] - x) + abs(mid[1] - y), 9)
            rank = levels.index(level)
            found.append((tight is not None, rank, away, support, holds))
        for *_, support, holds in sorted(found, key=lambda f: f[:3]):
            yield support, holds

    def _support_levels(self, contact: Cell) -> list[int]:
        """Return the levels of a support's cell at which it may touch a brick."""
        faces = self.rules.faces[self.up]
        offset = 0 if self.up else BRICK_LEVELS
        levels = (contact.level + d for d in (_ABOVE if self.up else _BELOW))
        return [k for k in levels if k >= 0 and k + offset in faces]

    def _ordered_presses(self) -> list[Press]:
        """Return all presses, those near the middle of what they press onto first."""
        onto: tuple[str | None, ...] = self._above if self.up else self._below
        studs = set(covered_studs(self.item.cell, self.item.brick))
        if None not in onto:
            bricks = [self.rules.structures.bricks[name] for name in onto if name]
            studs &= frozenset().union(
                *(covered_studs(other.cell, other.brick) for other in bricks)
            )
        mx = sum(x + 0.5 for x, _ in studs) / len(studs) * STUD_PITCH
        my = sum(y + 0.5 for _, y in studs) / len(studs) * STUD_PITCH

        def off(press: Press) -> float:
            x, y = self._press_point(press)
            return round(abs(x - mx) + abs(y - my), 9)

        return sorted(presses(self.item.brick), key=off)

    def _press_point(self, press: Press) -> tuple[float, float]:
        loads = self._loads(press)
        n = len(loads)
        return sum(v.point[0] for v in loads) / n, sum(v.point[1] for v in loads) / n

    def _loads(self, press: Press) -> tuple[Load, ...]:
        """Return the insertion force, shared by the pressed studs of the brick itself."""
        item, up, force = self.item, self.up, self.rules.force
        contact = press_cell(item.cell, item.brick, press, up=up)
        dx, dy = (1, 0) if contact.turned else (0, 1)
        nx, ny = footprint(item.cell, item.brick)
        pressed = [
            (x, y)
            for x, y in ((contact.x, contact.y), (contact.x + dx, contact.y + dy))
            if 0 <= x - item.cell.x < nx and 0 <= y - item.cell.y < ny
        ]
        each = (force if up else -force) / len(pressed)
        height = level_height(item.cell.level + (0 if up else item.brick.height))
        return tuple(
            Load(
                item.name,
                (0.0, 0.0, each),
                ((x + 0.5) * STUD_PITCH, (y + 0.5) * STUD_PITCH, height),
            )
            for x, y in pressed
        )

    def _holds(self, support: Support) -> tuple[Hold, ...]:
        """Return where a supporting tool touches bricks: the corners of what they share."""
        top = self.up
        low, high = support_face(support, top=top)
        face = support.cell.level + (0 if top else BRICK_LEVELS)
        level, height = face - 1 if top else face, level_height(face)
        xs = range(int(low[0] // STUD_PITCH), int(high[0] // STUD_PITCH) + 1)
        ys = range(int(low[1] // STUD_PITCH), int(high[1] // STUD_PITCH) + 1)
        touched = {
            self.rules.structures.filled.get((x, y, level)) for x, y in product(xs, ys)
        }
        out = []
        for name in sorted(n for n in touched if n is not None and n in self.names):
            span = self.rules.spans[name]
            if face != (span.top if top else span.bottom):
                continue
            box = self.rules.boxes[name]
            x0, y0 = (max(float(low[k]), float(box[0, k])) for k in (0, 1))
            x1, y1 = (min(float(high[k]), float(box[1, k])) for k in (0, 1))
            if x1 - x0 > _LEAST_TOUCH and y1 - y0 > _LEAST_TOUCH:
                out += [
                    Hold(name, -1 if top else 1, (x, y, height))
                    for x, y in product((x0, x1), (y0, y1))
                ]
        return tuple(out)


def _name(brick: str | None) -> str:
    return "the plate" if brick is None else f"brick {brick!r}"
