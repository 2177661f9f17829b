"""What might be inserted at all: the relaxed question behind proofs that a structure is blocked.

See ``blocking_set`` for what is proved with it. To ask once instead of for every press and every
supporting spot, a brick is pressed at all its presses at once and held at all spots at once: what
the structure does not bear then, it bears with none of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from planning.lego.bricks.assembly import Press
from planning.lego.bricks.grips import presses
from planning.lego.insertion.insertion import InsertionRules, Way
from planning.lego.insertion.press_force import press_force, press_load
from planning.lego.stability.partial_structures import Bearing, Names
from planning.lego.stability.stability import Hold, Load

_Question = tuple[str, Way, tuple[Press, ...], tuple[Hold, ...]]


class Prospects:
    """Tells which bricks of a design might be the last one in beside which others.

    Args:
        rules: of the design.
        ways: gives those that are allowed for a brick.
        fixed: bricks that stand from the start.
    """

    def __init__(
        self,
        rules: InsertionRules,
        ways: Callable[[str], Sequence[Way]],
        fixed: Names,
    ) -> None:
        self._rules, self._ways, self._fixed = rules, ways, fixed
        self._structures = rules.structures
        self._design = frozenset(rules.structures.bricks)
        self._borne: dict[_Question, Bearing] = {}

    def perhaps(self, parts: Names, brick: str) -> bool:
        """Tell whether a brick might be the last one in beside others (and what is fixed)."""
        names = parts | self._fixed
        return any(
            bearing is not None and bearing.stable
            for way in self._ways(brick)
            for bearing in [self.bearing(names, brick, way)]
        )

    def bearing(self, names: Names, brick: str, way: Way) -> Bearing | None:
        """Return what any partial structure might bear at most of a press on a brick.

        Args:
            names: bricks that are in the way if they are.
            brick: the brick.
            way: how it goes in.

        Returns:
            None where it cannot go in that way for want of room, or of something to go onto.
        """
        onto, over = self._structures.below, self._structures.above
        if way.up:
            onto, over = over, onto
        if over(names, brick) or not onto(self._design, brick):
            return None
        roomy = tuple(self.roomy(names, brick, up=way.up))
        if not roomy:
            return None
        holds: tuple[Hold, ...] = ()
        if way.held:
            holds = self._rules.room.holds_anywhere(
                brick,
                sorted(self._design),
                names,
                from_above=way.holds_from_above,
                apart=way.apart,
            )
            if not holds:
                return None
        return self._could_bear((brick, way, roomy, holds))

    def roomy(self, names: Names, brick: str, *, up: bool) -> Iterator[Press]:
        """Yield the presses for which the tool has room among some bricks."""
        room = self._rules.room
        for press in presses(self._structures.bricks[brick].brick):
            if not room.in_the_way(brick, press, names, up=up):
                yield press

    def _could_bear(self, question: _Question) -> Bearing:
        known = self._borne.get(question)
        if known is None:
            brick, way, pressed, holds = question
            over = self._structures.below if way.up else self._structures.above
            there = self._design.difference(n for n in over(self._design, brick) if n)
            load = self._load(brick, way, pressed)
            known = self._structures.could_bear(there, load, holds)
            self._borne[question] = known
        return known

    def _load(self, brick: str, way: Way, pressed: tuple[Press, ...]) -> Load:
        """Return the least force that pressing can take: onto one other brick alone."""
        structures, rules = self._structures, self._rules
        onto = (structures.above if way.up else structures.below)(self._design, brick)
        engaged = min(structures.engaged(brick, (other,)) for other in onto)
        force = press_force(engaged, most=rules.force, margin=rules.margin)
        return press_load(structures.bricks[brick], *pressed, up=way.up, force=force)
