"""Insertions of a brick into a structure: from above or from below, alone or supported by the other arm.

An insertion is possible if the structure bears the pressing force and the tools have clearance. These are pruning
criteria of APEX-MR App. A, applied to one brick.

A brick is called *perhaps insertable* into a set of bricks if a fast necessary test does not exclude it: the other
bricks block neither the brick nor the tool, and the complete design, without its weight, bears the press. A brick
that fails the test also fails it among more bricks. One calculation covers all presses and supports: all presses act
simultaneously, and all supports are present. If the structure fails even then, it fails for each press and support.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, islice, product

import numpy as np

from planning.lego.bricks.assembly import (
    STUD_PITCH,
    LegoStep,
    PlacedBrick,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import legal_presses, press_cell
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import level_height
from planning.lego.insertion.design_room import (
    DesignRoom,
    Point,
    SupportSpot,
    SupportSpots,
)
from planning.lego.insertion.rules import InsertionMethod, SequencingRules
from planning.lego.insertion.tool_room import PLATE
from planning.lego.stability.contacts import ToolHold
from planning.lego.stability.partial_structures import (
    Names,
    PartialStructures,
    PressBearing,
)
from planning.statics.equilibrium import Load, StabilityReport

_Question = tuple[str, InsertionMethod, tuple[Press, ...], tuple[ToolHold, ...]]

MOST_SPOTS = 40
"""Greatest number of supporting spots for one press."""

_STUD_EDGE = ((0.3, 0.0), (0.0, 0.3), (-0.3, 0.0), (0.0, -0.3))
"""Points on the edge of a stud, from its axis [studs]."""


@dataclass(frozen=True)
class Insertion:
    """An insertion of a brick into a structure.

    Attributes:
        method: the insertion method.
        press: the grip.
        support: the supporting tool, None without one.
        bearing: the force that it takes, and what of it the structure bears.
    """

    method: InsertionMethod
    press: Press
    support: Support | None
    bearing: PressBearing


@dataclass(frozen=True)
class Insertions:
    """Finds insertions of the bricks of one design.

    Attributes:
        structures: the partial structures of the design.
        rules: what is allowed, and what must be borne.
        fixed: bricks that stand from the start.
    """

    structures: PartialStructures
    rules: SequencingRules
    fixed: Names = frozenset()

    @staticmethod
    def of(
        bricks: Iterable[PlacedBrick],
        fixed: Iterable[PlacedBrick],
        rules: SequencingRules,
    ) -> Insertions:
        """Return the insertions of a design from its new bricks and those present from the start."""
        fixed = tuple(fixed)
        names = frozenset(item.name for item in fixed)
        return Insertions(PartialStructures([*bricks, *fixed]), rules, names)

    @cached_property
    def room(self) -> DesignRoom:
        """Room of the tool among the bricks of the design."""
        structures = self.structures
        return DesignRoom(structures.bricks, structures.filled, self.rules.robot)

    @cached_property
    def borne(self) -> dict[_Question, PressBearing]:
        """Loads that the whole design, taken as weightless, bears under presses, by request."""
        return {}

    def last(
        self, names: Names, brick: str, method: InsertionMethod
    ) -> Insertion | None:
        """Return the insertion of a brick of a partial structure as its last one, None if there is none."""
        site = self.at(names, brick, up=method.up)
        if site.obstacle() is not None or not site.roomy:
            return None
        if not self.structures.stands(names - {brick}):
            return None
        return site.insertion(method)

    def perhaps(self, parts: Names, brick: str) -> bool:
        """Tell whether a brick might be the last one inserted next to others (and fixed bricks)."""
        names = parts | self.fixed
        bearings = (
            self.at(names, brick, up=method.up).prospect(method)
            for method in self.rules.methods_of(brick)
        )
        return any(bearing is not None and bearing.stable for bearing in bearings)

    def force_onto(self, brick: str, others: Iterable[str | None]) -> float:
        """Return the force that presses a brick onto others, None for the plate [N]."""
        return self.rules.press_force(self.structures.engaged(brick, others))

    def at(self, names: Names, brick: str, *, up: bool) -> InsertionSite:
        """Return the insertion site of a brick in a partial structure that contains it."""
        return InsertionSite(self, names, self.structures.bricks[brick], up)


@dataclass(frozen=True)
class InsertionSite:
    """A brick to insert into a partial structure, from above or from below.

    Attributes:
        design: knows all its insertions.
        names: the partial structure with the brick in place.
        item: the brick.
        up: True for a place-up.
    """

    design: Insertions
    names: Names
    item: PlacedBrick
    up: bool

    def insertion(self, method: InsertionMethod) -> Insertion | None:
        """Return the first sufficient insertion, by the order of presses and spots."""
        if method.held and not self._bears_all_presses(method):
            return None
        for press in self.roomy_presses:
            found = next(self.insertions(press, method), None)
            if found is not None:
                return found
        return None

    def insertions(self, press: Press, method: InsertionMethod) -> Iterator[Insertion]:
        """Yield the insertions with one press: alone, or supported at each sufficient spot."""
        if not method.held:
            bearing = self.bears(press)
            if bearing.stable:
                yield Insertion(method, press, None, bearing)
            return
        spots = list(self.spots(press, method))
        every = tuple(dict.fromkeys(hold for spot in spots for hold in spot.holds))
        # What the structure does not bear held at all spots together, it bears held at none.
        if not every or not self._pressed(press, every).stable:
            return
        for spot in spots:
            bearing = self._pressed(press, spot.holds)
            if bearing.stable:
                yield Insertion(method, press, spot.support, bearing)

    def prospect(self, method: InsertionMethod) -> PressBearing | None:
        """Return an upper bound of the press load borne by any structure with at most these bricks.

        Its force is the least that pressing can take: onto one other brick alone.

        Returns:
            None where the brick cannot go in that way for want of room, or of something to go onto.
        """
        design, name = self.design, self.item.name
        whole = replace(self, names=frozenset(design.structures.bricks))
        if self._over or not whole._onto or not self.roomy:
            return None
        holds = self._possible_holds(method, whole.names)
        if method.held and not holds:
            return None
        question = (name, method, self.roomy, holds)
        if question not in design.borne:
            force = min(design.force_onto(name, (k,)) for k in whole._onto)
            load = _press_load(self.item, *self.roomy, up=self.up, force=force)
            there = whole.names.difference(whole._over)
            bearing = design.structures.could_bear(there, load, holds)
            design.borne[question] = bearing
        return design.borne[question]

    def bears(self, press: Press, support: Support | None = None) -> PressBearing:
        """Tell whether the structure bears a press, ignoring room for the tools.

        A support that touches no brick is as good as none.
        """
        return self._pressed(press, self.holds(support))

    def weakness(self, press: Press, support: Support | None = None) -> StabilityReport:
        """Return the friction demand of a press, and where the structure fails first."""
        load, holds = self.load(press), self.holds(support)
        return self.design.structures.weakness(self.names, load, holds)

    def obstacle(self) -> str | None:
        """Return the reason why the brick cannot be inserted by this method, None if it can."""
        over, onto = ("below", "above") if self.up else ("above", "below")
        if self._over:
            return f"{_name(self._over[0])} is in the way {over} it"
        return None if self._onto else f"there is nothing {onto} it to press it onto"

    @cached_property
    def force(self) -> float:
        """Force needed to press the brick on [N]."""
        return self.design.force_onto(self.item.name, self._onto)

    @cached_property
    def roomy(self) -> tuple[Press, ...]:
        """The presses of the brick with room for the tool."""
        return tuple(
            p for p in legal_presses(self.item.brick) if self._blocker(p) is None
        )

    @cached_property
    def roomy_presses(self) -> tuple[Press, ...]:
        """The presses of the brick with room for the tool, central ones first."""
        onto: tuple[str | None, ...] = self._onto
        studs = self.item.studs
        if onto and None not in onto:
            bricks = [self.design.structures.bricks[name] for name in onto if name]
            studs &= frozenset().union(*(other.studs for other in bricks))
        mx = sum(x + 0.5 for x, _ in studs) / len(studs) * STUD_PITCH
        my = sum(y + 0.5 for _, y in studs) / len(studs) * STUD_PITCH

        def off(press: Press) -> float:
            x, y = self._press_point(press)
            return round(abs(x - mx) + abs(y - my), 9)

        return tuple(sorted(self.roomy, key=off))

    def blocker(self) -> str:
        """Return the obstacle to the first press of the brick."""
        found = map(self._blocker, legal_presses(self.item.brick))
        return next((name for name in found if name is not None), "nothing")

    def load(self, *presses: Press) -> Load:
        """Return the insertion force with a press, or with any of several."""
        return _press_load(self.item, *presses, up=self.up, force=self.force)

    def step(self, chosen: Insertion) -> LegoStep:
        """Return an insertion as a step of an assembly, with all its alternatives."""
        item, press = self.item, chosen.press
        others = (
            other
            for other in self.roomy_presses
            if other != press and self.bears(other, chosen.support).stable
        )
        held = self.insertions(press, chosen.method) if chosen.method.held else ()
        return LegoStep(
            brick=item.brick,
            cell=item.cell,
            up=self.up,
            presses=(press, *others),
            supports=tuple(i.support for i in held if i.support is not None),
            attack=self.design.room.attack(item.name, press, self.names, up=self.up),
        )

    def spots(self, press: Press, method: InsertionMethod) -> Iterator[SupportSpot]:
        """Yield support positions of the other arm, a bounded number of them."""
        contact = press_cell(self.item, press, up=self.up)
        spots = SupportSpots(self.design.room, self.names, self.item.name)
        return islice(
            spots.found(method, contact, self._press_point(press)), MOST_SPOTS
        )

    @property
    def _onto(self) -> tuple[str | None, ...]:
        """The brick that it is pressed onto, None for the plate."""
        structures = self.design.structures
        blocking = structures.above if self.up else structures.below
        return blocking(self.names, self.item.name)

    @property
    def _over(self) -> tuple[str | None, ...]:
        """The bricks on the side of its approach, which block it."""
        structures = self.design.structures
        blocking = structures.below if self.up else structures.above
        return blocking(self.names, self.item.name)

    def _blocker(self, press: Press) -> str | None:
        """Return the first brick that blocks a press, or the plate, or NO_ARM."""
        room, arms = self.design.room, self.design.rules.arms
        found = room.press_obstacles(self.item.name, press, self.names, up=self.up)
        if arms is not None and not found:
            return arms.blocker(self.item, press, self.names, up=self.up)
        return PLATE if PLATE in found else min(found, default=None)

    def _possible_holds(
        self, method: InsertionMethod, touchable: Names
    ) -> tuple[ToolHold, ...]:
        """Return all pushes by which the other arm may support some bricks, none without it."""
        if not method.held:
            return ()
        room, name = self.design.room, self.item.name
        return room.possible_holds(name, sorted(touchable), self.names, method)

    def _bears_all_presses(self, method: InsertionMethod) -> bool:
        """Tell whether the structure bears all presses together, supported wherever possible."""
        holds = self._possible_holds(method, self.names) if self.roomy else ()
        load = self.load(*self.roomy_presses)
        pressed = self.design.structures.pressed
        return bool(holds) and pressed(self.names, load, holds).stable

    def _pressed(self, press: Press, holds: tuple[ToolHold, ...]) -> PressBearing:
        return self.design.structures.pressed(self.names, self.load(press), holds)

    def holds(self, support: Support | None) -> tuple[ToolHold, ...]:
        """Return the contacts of a supporting tool with the present bricks; none without a tool."""
        if support is None:
            return ()
        touches = self.design.room.support(support).touches
        return tuple(
            h for n, holds in touches.items() if n in self.names for h in holds
        )

    def _press_point(self, press: Press) -> Point:
        x, y, _ = np.mean(self.load(press).points, axis=0)
        return float(x), float(y)


def _name(brick: str | None) -> str:
    return "the plate" if brick is None else f"brick {brick!r}"


def _press_load(item: PlacedBrick, *presses: Press, up: bool, force: float) -> Load:
    """Return the force of the tool on a brick that it presses on.

    The tool has hold of the brick by one or two studs and keeps it from turning, so its force
    acts where the brick resists: anywhere between the edges of the studs that it holds. That of
    several presses acts wherever that of any of them does: what a structure does not bear then,
    it bears with none of them.

    Args:
        item: the brick in its place.
        presses: the grip, or several.
        up: True for a place-up, where the tool presses from below.
        force: its amount [N].
    """
    pair, height = (
        BRICKS["1x2"],
        level_height(item.span.bottom if up else item.span.top),
    )
    cells = (press_cell(item, press, up=up) for press in presses)
    pressed = (PlacedBrick("", pair, cell).studs & item.studs for cell in cells)
    studs = dict.fromkeys(chain.from_iterable(map(sorted, pressed)))
    points = tuple(
        ((x + 0.5 + i) * STUD_PITCH, (y + 0.5 + j) * STUD_PITCH, height)
        for (x, y), (i, j) in product(studs, _STUD_EDGE)
    )
    return Load(item.name, (0.0, 0.0, force if up else -force), points)
