"""Rules of an assembly sequence: allowed insertion methods, temporary supports, and loads to bear."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from functools import cached_property

from planning.lego.bricks.assembly import BrickType, PlacedBrick, Press

_TOOLS_APART = 0.095
"""Distance of the axes of two upright tools below which their force sensors collide [m]."""

Grip = tuple[str, Press, bool]
"""Name of a brick, its grip, and whether it is inserted from below."""

NO_ARM = "the reach of all arms"
"""Placeholder for the obstacle of a grip that no arm of the cell can reach in any scene."""


class InsertionMethod(Enum):
    """Method of pressing a brick on, in order of preference."""

    DOWN = "from above"
    DOWN_HELD_BELOW = "from above, the structure held from below"
    UP = "from below, the structure held from above"
    DOWN_HELD_ABOVE = "from above, the structure held down beside it"

    @property
    def up(self) -> bool:
        """True when the brick is inserted from below."""
        return self is InsertionMethod.UP

    @property
    def holds_from_above(self) -> bool:
        """True when the other arm supports the structure from above."""
        return self in (InsertionMethod.UP, InsertionMethod.DOWN_HELD_ABOVE)

    @property
    def apart(self) -> float:
        """Distance of the other arm's tool from the press [m]."""
        return _TOOLS_APART if self is InsertionMethod.DOWN_HELD_ABOVE else 0.0

    @property
    def held(self) -> bool:
        """True when the other arm supports the structure."""
        return self is not InsertionMethod.DOWN


@dataclass(frozen=True)
class ArmLimits:
    """Grips that no arm of a cell can reach, though the tool has room.

    Attributes:
        reaches: tells whether some arm, alone in its cell, reaches a brick with a grip.
        blocking: sets of bricks next to which no arm was found to reach a grip.
    """

    reaches: Callable[[PlacedBrick, Press, bool], bool]
    blocking: Mapping[Grip, tuple[frozenset[str], ...]] = field(default_factory=dict)

    def blocker(
        self, item: PlacedBrick, press: Press, names: frozenset[str], *, up: bool
    ) -> str | None:
        """Return what blocks a grip for all arms in a partial structure, None for nothing."""
        for bricks in self.blocking.get((item.name, press, up), ()):
            if bricks <= names:
                return min(bricks, default=NO_ARM)
        return None if self.reaches(item, press, up) else NO_ARM


@dataclass(frozen=True)
class SequencingRules:
    """Rules of an assembly sequence: allowed insertions, and loads the structure must bear.

    Attributes:
        support: a second robot may hold the structure from below.
        place_up: a brick may be handed over and pressed on from below, a second robot pressing
            against it from above.
        hold_down: a second robot may hold the structure down from above, next to the press.
        scaffold: temporary bricks may carry what cannot go in otherwise.
        removable: temporary bricks must be such that they can be taken out again.
        plinth: layers by which the structure is raised on temporary bricks.
        force: force at which the skill stops pressing, however many knobs engage [N]; the
            published skills stop at 15 N (APEX-MR App. C).
        margin: force that presses a knob in over the friction that then holds it: what pushing
            in takes more than holding, and tolerances of worn bricks.
        unsupported: names of bricks that must go in without the other arm, as it does not get there.
        search_limit: how many partial structures to look at beyond one for each brick.
        robot: the registered robot whose tool it is.
        types: of bricks that scaffolding may be made of; the built-in ones where empty.
        ground: studs of the plate that scaffolding may cover beside what it carries.
        arms: what the arms of the cell cannot do; None where only the tool is looked at.
    """

    support: bool = True
    place_up: bool = True
    hold_down: bool = False
    scaffold: bool = False
    removable: bool = False
    plinth: int = 0
    force: float = 15.0
    margin: float = 1.5
    unsupported: frozenset[str] = frozenset()
    search_limit: int = 2000
    robot: str = "gp4"
    types: tuple[BrickType, ...] = ()
    ground: frozenset[tuple[int, int]] = frozenset()
    arms: ArmLimits | None = None

    @cached_property
    def allowed(self) -> tuple[InsertionMethod, ...]:
        """The allowed methods of pressing a brick on, in order of preference."""
        choices = {
            InsertionMethod.DOWN: True,
            InsertionMethod.DOWN_HELD_BELOW: self.support,
            InsertionMethod.UP: self.place_up,
            InsertionMethod.DOWN_HELD_ABOVE: self.hold_down,
        }
        return tuple(method for method in InsertionMethod if choices[method])

    def methods_of(self, brick: str) -> tuple[InsertionMethod, ...]:
        """Return the allowed methods for one brick."""
        if brick not in self.unsupported:
            return self.allowed
        return tuple(method for method in self.allowed if not method.held)

    def press_force(self, engaged: float) -> float:
        """Return the force that presses a brick on [N].

        A knob that goes into a cavity rubs at the same contacts that hold it afterwards.

        Args:
            engaged: friction of all contacts that the brick makes with what it goes onto [N].
        """
        return min(self.force, self.margin * engaged)
