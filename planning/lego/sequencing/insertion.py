"""Ways to put a brick into a structure: from above, with a support, or from below.

This is the pruning of APEX-MR App. A for one brick: the structure must bear the pressing force,
and the tools must have room.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    LegoStep,
    Press,
    Support,
)
from planning.lego.bricks.contacts import PlacedBrick
from planning.lego.bricks.grid import footprint, occupied_studs
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
from planning.lego.stability.partial_structures import Names, PartialStructures
from planning.lego.stability.stability import Hold, Load, StabilityReport

PLAIN, SUPPORTED, FROM_BELOW = "plain", "supported", "from below"
WAYS = (PLAIN, SUPPORTED, FROM_BELOW)
"""Ways to insert a brick, the preferred ones first: place-down; place-down with a
support-bottom; handover, then place-up with a support-top."""

INSERTION_FORCE = 15.0
"""Force at which the published skills stop pressing (APEX-MR App. C) [N]."""

_BELOW = (-3, -2, -4)
_ABOVE = (3, 4)
_SHIFTS = (0, -1, 1)
_LEAST_TOUCH = 0.002
_CLEARANCE = 0.001


@dataclass(frozen=True)
class Insertion:
    """One way to put a brick into a structure.

    Attributes:
        way: one of ``WAYS``.
        press: the grip.
        support: the supporting tool, None without one.
        score: bound of the structure's stability score while the brick is pressed.
    """

    way: str
    press: Press
    support: Support | None
    score: float


class InsertionRules:
    """Finds the ways to insert bricks of one design.

    Args:
        structures: the partial structures of the design.
        force: insertion force [N].
    """

    def __init__(
        self,
        structures: PartialStructures,
        *,
        force: float = INSERTION_FORCE,
    ) -> None:
        self.structures = structures
        self._force = force
        self._boxes = {n: brick_box(item) for n, item in structures.bricks.items()}

    def insertions(self, names: Names, brick: str, way: str) -> Iterator[Insertion]:
        """Yield the ways of one kind to insert a brick, the preferred ones first.

        Args:
            names: the partial structure with the brick in place.
            brick: the brick.
            way: one of ``WAYS``.
        """
        if self.obstacle(names, brick, way) is None:
            for press in self.roomy_presses(names, brick, up=way == FROM_BELOW):
                yield from self.supported(names, brick, way, press)

    def supported(
        self, names: Names, brick: str, way: str, press: Press
    ) -> Iterator[Insertion]:
        """Yield the ways to insert a brick with one press: one for each support that does."""
        up = way == FROM_BELOW
        loads = self._loads(brick, press, up=up)
        if way == PLAIN:
            report = self.structures.pressed(names, brick, loads)
            if report.stable:
                yield Insertion(way, press, None, report.score)
            return
        for support, holds in self._roomy_supports(names, brick, press, up=up):
            report = self.structures.pressed(names, brick, loads, holds)
            if report.stable:
                yield Insertion(way, press, support, report.score)

    def bears(
        self,
        names: Names,
        brick: str,
        press: Press,
        support: Support | None = None,
        *,
        up: bool = False,
    ) -> StabilityReport:
        """Return whether a structure bears a press, room for the tools set aside.

        Args:
            names: the partial structure with the brick in place.
            brick: the brick that is pressed.
            press: the grip.
            support: the supporting tool; one that touches no brick is as good as none.
            up: True for a place-up.
        """
        holds = () if support is None else self._holds(names, support, top=up)
        loads = self._loads(brick, press, up=up)
        return self.structures.pressed(names, brick, loads, holds)

    def presses_with(
        self, names: Names, brick: str, insertion: Insertion
    ) -> tuple[Press, ...]:
        """Return the presses that do with the same support, the given one first."""
        up = insertion.way == FROM_BELOW
        others = [
            press
            for press in self.roomy_presses(names, brick, up=up)
            if press != insertion.press
            and self.bears(names, brick, press, insertion.support, up=up).stable
        ]
        return (insertion.press, *others)

    def obstacle(self, names: Names, brick: str, way: str) -> str | None:
        """Return why a brick can in no case be inserted this way, None if it may be."""
        above = self.structures.above(names, brick)
        below = self.structures.below(names, brick)
        if way == FROM_BELOW:
            if below:
                return f"{_name(below[0])} is in the way below it"
            return None if above else "there is nothing above it to press it onto"
        if above:
            return f"{_name(above[0])} is in the way above it"
        return None if below else "there is nothing below it to press it onto"

    def roomy_presses(self, names: Names, brick: str, *, up: bool) -> tuple[Press, ...]:
        """Return the presses of a brick that leave the tool room, the central ones first."""
        item = self.structures.bricks[brick]
        others = self._boxes_of(names - {brick})
        blocked = place_up_blocked if up else place_down_blocked
        return tuple(
            press
            for press in self._ordered_presses(names, item, up=up)
            if blocked(item, press, others) is None
        )

    def blocker(self, names: Names, brick: str, *, up: bool) -> str:
        """Return what leaves no room for the first press of a brick."""
        item = self.structures.bricks[brick]
        others = self._boxes_of(names - {brick})
        blocked = place_up_blocked if up else place_down_blocked
        found = (blocked(item, p, others) for p in presses(item.brick))
        return next((name for name in found if name is not None), "nothing")

    def _roomy_supports(
        self, names: Names, brick: str, press: Press, *, up: bool
    ) -> Iterator[tuple[Support, tuple[Hold, ...]]]:
        """Yield the supports that touch a brick and have room.

        Those that keep clear of other bricks come first, then those nearest to the press.

        They are sought as the published code does: shifted by up to one stud along x and y, 2
        to 4 layers below the contact of the press for a support-bottom, 3 or 4 above it for a
        support-top. One that touches the inserted brick itself would only keep it from going
        in.
        """
        item = self.structures.bricks[brick]
        contact = press_cell(item.cell, item.brick, press, up=up)
        x, y = self._press_point(item, press, up=up)
        boxes = self._boxes_of(names)
        layers = _ABOVE if up else _BELOW
        found: list[tuple[bool, int, float, Support, tuple[Hold, ...]]] = []
        for dz, dx, dy, turn in product(layers, _SHIFTS, _SHIFTS, ORIENTATIONS):
            support = Support(contact.x + dx, contact.y + dy, contact.z + dz, turn)
            holds = self._holds(names, support, top=up)
            touched = {hold.brick for hold in holds}
            if support.z < 1 or not touched or brick in touched:
                continue
            room = support_boxes(support, top=up)
            if blocking(room, boxes) is not None:
                continue
            tight = blocking(room, boxes.without(touched), clearance=_CLEARANCE)
            mid = [sum(h.point[k] for h in holds) / len(holds) for k in (0, 1)]
            away = round(abs(mid[0] - x) + abs(mid[1] - y), 9)
            found.append((tight is not None, layers.index(dz), away, support, holds))
        for *_, support, holds in sorted(found, key=lambda f: f[:3]):
            yield support, holds

    def step(self, names: Names, brick: str, insertion: Insertion) -> LegoStep:
        """Return an insertion as a step of an assembly."""
        item = self.structures.bricks[brick]
        up = insertion.way == FROM_BELOW
        return LegoStep(
            brick=item.brick.name,
            cell=item.cell,
            up=up,
            press=insertion.press,
            press_cell=(
                press_cell(item.cell, item.brick, insertion.press, up=True)
                if up
                else None
            ),
            support=insertion.support,
            attack=attack_side(
                item,
                insertion.press,
                self._boxes_of(names - {brick}),
                up=up,
            ),
        )

    def _boxes_of(self, names: Names) -> BrickBoxes:
        some = tuple(sorted(names))
        corners = [self._boxes[name] for name in some]
        return BrickBoxes(some, np.array(corners).reshape(-1, 2, 3))

    def _ordered_presses(
        self, names: Names, item: PlacedBrick, *, up: bool
    ) -> list[Press]:
        """Return all presses, those near the middle of what they press onto first."""
        onto = (
            self.structures.above(names, item.name)
            if up
            else self.structures.below(names, item.name)
        )
        studs = {(x, y) for x, y, _ in occupied_studs(item.cell, item.brick)}
        if None not in onto:
            bricks = [self.structures.bricks[name] for name in onto if name]
            studs &= {
                (x, y)
                for other in bricks
                for x, y, _ in occupied_studs(other.cell, other.brick)
            }
        mx = sum(x + 0.5 for x, _ in studs) / len(studs) * STUD_PITCH
        my = sum(y + 0.5 for _, y in studs) / len(studs) * STUD_PITCH

        def off(press: Press) -> float:
            x, y = self._press_point(item, press, up=up)
            return round(abs(x - mx) + abs(y - my), 9)

        return sorted(presses(item.brick), key=off)

    def _press_point(
        self, item: PlacedBrick, press: Press, *, up: bool
    ) -> tuple[float, float]:
        loads = self._loads(item.name, press, up=up)
        n = len(loads)
        return sum(v.point[0] for v in loads) / n, sum(v.point[1] for v in loads) / n

    def _loads(self, brick: str, press: Press, *, up: bool) -> tuple[Load, ...]:
        """Return the insertion force, shared by the pressed studs of the brick itself."""
        item = self.structures.bricks[brick]
        contact = press_cell(item.cell, item.brick, press, up=up)
        dx, dy = (1, 0) if contact.turned else (0, 1)
        nx, ny = footprint(item.cell, item.brick)
        pressed = [
            (x, y)
            for x, y in ((contact.x, contact.y), (contact.x + dx, contact.y + dy))
            if 0 <= x - item.cell.x < nx and 0 <= y - item.cell.y < ny
        ]
        each = (self._force if up else -self._force) / len(pressed)
        height = (item.cell.z - up) * LAYER_HEIGHT
        return tuple(
            Load(
                brick,
                (0.0, 0.0, each),
                ((x + 0.5) * STUD_PITCH, (y + 0.5) * STUD_PITCH, height),
            )
            for x, y in pressed
        )

    def _holds(self, names: Names, support: Support, *, top: bool) -> tuple[Hold, ...]:
        """Return where a supporting tool touches bricks: the corners of what they share."""
        low, high = support_face(support, top=top)
        layer = support.z - 1 if top else support.z + 1
        height = (support.z - 1 if top else support.z) * LAYER_HEIGHT
        xs = range(int(low[0] // STUD_PITCH), int(high[0] // STUD_PITCH) + 1)
        ys = range(int(low[1] // STUD_PITCH), int(high[1] // STUD_PITCH) + 1)
        touched = {self._filled.get((x, y, layer)) for x, y in product(xs, ys)}
        out = []
        for name in sorted(n for n in touched if n is not None and n in names):
            box = self._boxes[name]
            x0, y0 = (max(float(low[k]), float(box[0, k])) for k in (0, 1))
            x1, y1 = (min(float(high[k]), float(box[1, k])) for k in (0, 1))
            if x1 - x0 > _LEAST_TOUCH and y1 - y0 > _LEAST_TOUCH:
                out += [
                    Hold(name, -1 if top else 1, (x, y, height))
                    for x, y in product((x0, x1), (y0, y1))
                ]
        return tuple(out)

    @cached_property
    def _filled(self) -> dict[tuple[int, int, int], str]:
        return {
            place: name
            for name, item in self.structures.bricks.items()
            for place in occupied_studs(item.cell, item.brick)
        }


def _name(brick: str | None) -> str:
    return "the plate" if brick is None else f"brick {brick!r}"
