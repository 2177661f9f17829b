"""Rules of an assembly sequence: which ways and remedies it may use, and what must be borne."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from planning.lego.bricks.assembly import BrickType
from planning.lego.insertion.insertion import Way
from planning.lego.insertion.press_force import INSERTION_FORCE, PRESS_MARGIN


@dataclass(frozen=True)
class SequencingRules:
    """Rules of an assembly sequence: allowed insertions, and loads the structure must bear.

    Attributes:
        support: a second robot may hold the structure from below.
        place_up: a brick may be handed over and pressed on from below, a second robot pressing
            against it from above.
        hold_down: a second robot may hold the structure down from above, beside the press.
        scaffold: temporary bricks may carry what cannot go in otherwise.
        plinth: layers by which the structure is raised on temporary bricks.
        force: force at which the skill stops pressing [N].
        margin: force that presses a knob in over the friction that then holds it.
        alone: names of bricks that must go in without the other arm, as it does not get there.
        search_limit: how many partial structures to look at beyond one for each brick.
        robot: the registered robot whose tool it is.
        types: of bricks that scaffolding may be made of; the built-in ones where empty.
    """

    support: bool = True
    place_up: bool = True
    hold_down: bool = False
    scaffold: bool = False
    plinth: int = 0
    force: float = INSERTION_FORCE
    margin: float = PRESS_MARGIN
    alone: frozenset[str] = frozenset()
    search_limit: int = 2000
    robot: str = "gp4"
    types: tuple[BrickType, ...] = ()

    @cached_property
    def ways(self) -> tuple[Way, ...]:
        """The ways to press a brick on that are allowed, the preferred ones first."""
        allowed = {
            Way.DOWN: True,
            Way.DOWN_HELD_BELOW: self.support,
            Way.UP: self.place_up,
            Way.DOWN_HELD_ABOVE: self.hold_down,
        }
        return tuple(way for way in Way if allowed[way])

    def ways_of(self, brick: str) -> tuple[Way, ...]:
        """The ways that are allowed for one brick."""
        if brick not in self.alone:
            return self.ways
        return tuple(way for way in self.ways if not way.held)
