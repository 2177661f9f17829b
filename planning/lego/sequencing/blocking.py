"""Proof that a structure cannot be assembled: a set of bricks of which none can be inserted last.

Bricks are removed one after another as long as one is *perhaps insertable* (see ``planning.lego.insertion``); the
order of removals is irrelevant. If bricks remain, no assembly order exists, because one of them would have to be
inserted last.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from textwrap import indent
from typing import TypeVar

from planning.errors import format_faults
from planning.lego.insertion.insertion import Insertions
from planning.lego.insertion.rules import NO_ARM, InsertionMethod
from planning.lego.stability.partial_structures import Names

Part = TypeVar("Part")


def blocked_parts(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return the parts that remain after removing all that are possibly insertable, repeatedly.

    Args:
        parts: to begin with, those that are tried first come first.
        perhaps: tells whether a part might be inserted last, given all parts with it. What
            is true for some parts must be true for fewer of them.
    """
    order = list(parts)
    left = frozenset(order)
    while True:
        before = left
        for part in order:
            if part in left and perhaps(left, part):
                left -= {part}
        if left == before:
            return left


def smallest_blocking_set(
    parts: Iterable[Part], perhaps: Callable[[frozenset[Part], Part], bool]
) -> frozenset[Part]:
    """Return a smallest set of parts of which none can be inserted last; empty if there is none.

    Args:
        parts: of the finished product, those first that should rather not be named.
        perhaps: see ``blocked_parts``.
    """
    order = list(parts)
    core = blocked_parts(order, perhaps)
    for part in order:
        if part in core:
            core = (
                blocked_parts((p for p in order if p in core and p != part), perhaps)
                or core
            )
    return core


class Refusal:
    """Explains why bricks of a design cannot be inserted.

    Args:
        insertions: of the design.
    """

    def __init__(self, insertions: Insertions) -> None:
        self._insertions, self._structures = insertions, insertions.structures
        self._rules, self._fixed = insertions.rules, insertions.fixed

    def place(self, name: str) -> str:
        """Return a brick's name, type and place in words."""
        item = self._structures.bricks[name]
        return f"{name!r} ({item.brick.name} at {item.cell.words})"

    def blocked(self, core: Names) -> str:
        """Return the reason why bricks block each other: none of them can be inserted last."""
        lines = self._lines(
            (self._structural_refusal(core, name), name) for name in core
        )
        if len(core) == 1:
            return f"no order of assembly exists: this brick cannot go in\n{lines}"
        return (
            f"no order of assembly exists: of these {len(core)} bricks none can go in after the "
            f"others\n{lines}"
        )

    def dead_end(self, parts: Names) -> str:
        """Return the reason why no brick of a partial structure can be inserted last."""
        names = parts | self._fixed
        return self._lines((self._refusal_reason(names, name), name) for name in parts)

    def _lines(self, whys: Iterable[tuple[tuple[int, str], str]]) -> str:
        """Return one line per brick, those that others wait for first."""
        bricks = self._structures.bricks

        def order(item: tuple[tuple[int, str], str]) -> tuple[int, int, str]:
            (rank, _), name = item
            return rank, -bricks[name].cell.level, name

        ordered = sorted(whys, key=order)
        lines = [f"{self.place(name)}: {reason}" for (_, reason), name in ordered]
        return indent(format_faults(lines), "  ")

    def _structural_refusal(self, core: Names, name: str) -> tuple[int, str]:
        """Return the reason why a brick cannot be inserted next to others in any structure."""
        names, design = core | self._fixed, frozenset(self._structures.bricks)
        below, above = self._structures.below, self._structures.above
        reasons, waits = [], 0
        for up, onto, over in ((False, below, above), (True, above, below)):
            if not onto(design, name):
                way, nothing = ("below", "above") if up else ("above", "below")
                reason = f"there is nothing {nothing} it to press it onto from {way}"
            elif over(names, name):
                reason = str(self._insertions.at(names, name, up=up).obstacle())
                waits += 1
            elif up and not self._rules.place_up:
                reason = "placing from below is not allowed"
            else:
                reason = self._explain_overload(names, name, up=up)
            reasons.append(reason)
        return waits, "; ".join(reasons)

    def _explain_overload(self, names: Names, name: str, *, up: bool) -> str:
        way = "from below" if up else "from above"
        site = self._insertions.at(names, name, up=up)
        if not site.roomy:
            return f"{way} {_no_room(site.blocker())}"
        alternatives = [each for each in self._rules.methods_of(name) if each.up == up]
        bearings = [b for b in map(site.prospect, alternatives) if b is not None]
        if not bearings:
            return f"{way} no spot for the other arm has room"
        best = max(bearings, key=lambda b: b.bears)
        alone = len(bearings) == 1 and not up
        held = "" if alone else ", held at any spot"
        return (
            f"pressed {way} with {best.needed:.1f} N the structure gives way: it bears "
            f"{max(best.bears, 0.0):.1f} N at most, wherever it is pressed{held}"
        )

    def _refusal_reason(self, names: Names, name: str) -> tuple[int, str]:
        """Return the reason why a brick cannot be inserted last, after the rank of the reason."""
        rest = names - {name}
        if not self._structures.stands(rest):
            report = self._structures.weakness(rest)
            what = self.place(report.body or "")
            held = "nothing holds {}" if math.isinf(report.score) else "{} gives way"
            return 2, f"without it {held.format(what)}"
        from_above, from_below = (
            self._insertions.at(names, name, up=up).obstacle() for up in (False, True)
        )
        if from_above and from_below:
            return 1, f"{from_above} and {from_below}"
        up = from_above is not None
        if up and not self._rules.place_up:
            return 0, f"{from_above}, and placing from below is not allowed"
        site = self._insertions.at(names, name, up=up)
        if not site.roomy_presses:
            return 0, _no_room(site.blocker())
        if up:
            return (
                0,
                "no supporting tool above has room and keeps the structure standing",
            )
        best = max((site.bears(p) for p in site.roomy_presses), key=lambda b: b.bears)
        gives = (
            f"the structure gives way under the press of {best.needed:.1f} N (it bears "
            f"{max(best.bears, 0.0):.1f} N)"
        )
        if InsertionMethod.DOWN_HELD_BELOW not in self._rules.methods_of(name):
            return 0, f"{gives}, and support is not allowed"
        return 0, f"{gives}, and no supporting tool below has room and helps"


def _no_room(blocker: str) -> str:
    """Return the reason why the tool does not fit."""
    if blocker == NO_ARM:
        return "no arm of the cell gets there with a grip that has room"
    thing = blocker if blocker == "the plate" else f"brick {blocker!r}"
    return f"the tool has no room: {thing} is in its way"
