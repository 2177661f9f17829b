"""Reasons in words why bricks cannot go in: of a blocking set, or of a dead end of the search."""

from __future__ import annotations

import math
from collections.abc import Iterable

from planning.lego.insertion.insertion import InsertionRules, Way
from planning.lego.sequencing.prospects import Prospects
from planning.lego.sequencing.rules import SequencingRules
from planning.lego.stability.partial_structures import Bearing, Names

_MOST_REASONS = 6
"""How many bricks are named."""


class Refusal:
    """Says why bricks of a design cannot go in.

    Args:
        insertion: rules of the design.
        rules: what is allowed.
        prospects: what might be inserted.
        fixed: bricks that stand from the start.
    """

    def __init__(
        self,
        insertion: InsertionRules,
        rules: SequencingRules,
        prospects: Prospects,
        fixed: Names,
    ) -> None:
        self._insertion, self._rules = insertion, rules
        self._structures = insertion.structures
        self._prospects, self._fixed = prospects, fixed

    def place(self, name: str) -> str:
        """Return a brick's name, type and place in words."""
        item = self._structures.bricks[name]
        return f"{name!r} ({item.brick.name} at {item.cell.words})"

    def blocked(self, core: Names) -> str:
        """Return why bricks block each other: none of them can be the last one in."""
        lines = self._lines((self._why_never(core, name), name) for name in core)
        if len(core) == 1:
            return f"no order of assembly exists: this brick cannot go in\n{lines}"
        return (
            f"no order of assembly exists: of these {len(core)} bricks none can go in after the "
            f"others\n{lines}"
        )

    def dead_end(self, parts: Names) -> str:
        """Return why no brick of a partial structure can be the last one in."""
        names = parts | self._fixed
        return self._lines((self._why_not(names, name), name) for name in parts)

    def _lines(self, whys: Iterable[tuple[tuple[int, str], str]]) -> str:
        """Return a line for each brick, those that others wait for first."""
        bricks = self._structures.bricks

        def order(item: tuple[tuple[int, str], str]) -> tuple[int, int, str]:
            (rank, _), name = item
            return rank, -bricks[name].cell.level, name

        ordered = sorted(whys, key=order)
        shown = [
            f"  {self.place(name)}: {reason}"
            for (_, reason), name in ordered[:_MOST_REASONS]
        ]
        if len(ordered) > len(shown):
            shown.append(f"  and {len(ordered) - len(shown)} more")
        return "\n".join(shown)

    def _why_never(self, core: Names, name: str) -> tuple[int, str]:
        """Return why a brick cannot go in beside others, whatever else is there."""
        names = core | self._fixed
        design = frozenset(self._structures.bricks)
        below, above = self._structures.below, self._structures.above
        reasons = []
        for up, onto, over in ((False, below, above), (True, above, below)):
            way = "from below" if up else "from above"
            if not onto(design, name):
                nothing = "above" if up else "below"
                reasons.append(f"there is nothing {nothing} it to press it onto {way}")
                continue
            if over(names, name):
                reasons.append(str(self._insertion.at(names, name, up=up).obstacle()))
                continue
            if up and not self._rules.place_up:
                reasons.append("placing from below is not allowed")
                continue
            reasons.append(self._why_not_borne(names, name, up=up))
        waits = sum("is in the way" in reason for reason in reasons)
        return waits, "; ".join(reasons)

    def _why_not_borne(self, names: Names, name: str, *, up: bool) -> str:
        way = "from below" if up else "from above"
        site = self._insertion.at(names, name, up=up)
        if not any(self._prospects.roomy(names, name, up=up)):
            return f"{way} the tool has no room: {_thing(site.blocker())} is in its way"
        bearings: list[Bearing] = []
        for each in self._rules.ways_of(name):
            bearing = self._prospects.bearing(names, name, each)
            if each.up == up and bearing is not None:
                bearings.append(bearing)
        if not bearings:
            return f"{way} no spot for the other arm has room"
        best = max(bearings, key=lambda b: b.bears)
        alone = len(bearings) == 1 and not up
        held = "" if alone else ", held at any spot"
        return (
            f"pressed {way} with {best.needed:.1f} N the structure gives way: it bears "
            f"{max(best.bears, 0.0):.1f} N at most, wherever it is pressed{held}"
        )

    def _why_not(self, names: Names, name: str) -> tuple[int, str]:
        """Return why a brick cannot be the last one in, after the rank of the reason."""
        rest = names - {name}
        if not self._structures.stands(rest):
            report = self._structures.weakness(rest)
            what = self.place(report.body or "")
            held = "nothing holds {}" if math.isinf(report.score) else "{} gives way"
            return 2, f"without it {held.format(what)}"
        from_above, from_below = (
            self._insertion.at(names, name, up=up).obstacle() for up in (False, True)
        )
        if from_above and from_below:
            return 1, f"{from_above} and {from_below}"
        up = from_above is not None
        if up and not self._rules.place_up:
            return 0, f"{from_above}, and placing from below is not allowed"
        site = self._insertion.at(names, name, up=up)
        if not site.roomy_presses:
            return 0, f"the tool has no room: {_thing(site.blocker())} is in its way"
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
        if Way.DOWN_HELD_BELOW not in self._rules.ways_of(name):
            return 0, f"{gives}, and support is not allowed"
        return 0, f"{gives}, and no supporting tool below has room and helps"


def _thing(name: str) -> str:
    return name if name == "the plate" else f"brick {name!r}"
