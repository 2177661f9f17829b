"""What a run is to come to, as its scenario says: places of objects, and what holds them there.

The audit takes nothing of this from the plan that it judges.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planning.transforms import Transform

TOUCH = 0.002
"""What is nearer than this touches, where the scenario says nothing else [m]."""

Hold = Literal["weight", "studs", "joints"]
"""What keeps an object at rest: it lies on others, its studs hold it from either side, or
whatever it touches."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where an object is to stand at the end.

    Attributes:
        words: what it is, for people.
        pose: of the object's centre in the world.
        kind: of the object.
        object: its name; None if any of its kind will do, turned by half a turn or not.
        held: whether another robot must hold what it is put on or under meanwhile.
    """

    words: str
    pose: Transform
    kind: str
    object: str | None = None
    held: bool = False


@dataclass(frozen=True)
class Wanted:
    """What a scenario says of the end of a run, and of the way there.

    Attributes:
        places: of all that is put somewhere; any order.
        hold: what keeps objects at rest.
        touch_m: what is nearer than this touches, between named objects in their places and
            fixtures; ``TOUCH`` for others, and at least [m].
        opening_m: how far fingers stand open in the geometry of tools: they close on what they
            hold from there; 0 for tools that do not close [m].
        helpers: whether further objects may stay where they only help, such as temporary bricks.
    """

    places: tuple[Place, ...] = ()
    hold: Hold = "joints"
    touch_m: float = TOUCH
    opening_m: float = 0.0
    helpers: bool = False
