"""The force that it takes to press a brick on, and where the tool presses.

A knob that goes into a cavity rubs at the same contacts that hold it afterwards. StableLego (Liu
et al. 2024) measured what one of them holds: 0.98 N. Pressing it on takes that much again and
again for every contact that engages; the margin stands for what pushing in takes more than
holding, and for tolerances of worn bricks. The published skills stop at 15 N however many knobs
engage (APEX-MR App. C), so no brick ever gets more.
"""

from __future__ import annotations

from collections.abc import Iterator

from planning.lego.bricks.assembly import (
    STUD_PITCH,
    PlacedBrick,
    Press,
)
from planning.lego.bricks.grid import footprint, level_height
from planning.lego.bricks.grips import press_cell
from planning.lego.stability.stability import Load

INSERTION_FORCE = 15.0
"""Force at which the published skills stop pressing (APEX-MR App. C) [N]."""

PRESS_MARGIN = 1.5
"""Force that presses a contact in over the friction with which it holds."""

_STUD_EDGE = ((0.3, 0.0), (0.0, 0.3), (-0.3, 0.0), (0.0, -0.3))
"""Points on the edge of a stud, from its axis [studs]."""


def press_force(engaged: float, *, most: float, margin: float) -> float:
    """Return the force that presses a brick on [N].

    Args:
        engaged: friction of all contacts that the brick makes with what it goes onto [N].
        most: force at which the skill stops [N].
        margin: force that presses a contact in over its friction.
    """
    return min(most, margin * engaged)


def press_load(item: PlacedBrick, *presses: Press, up: bool, force: float) -> Load:
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
    points = (p for press in presses for p in _pressed_points(item, press, up=up))
    every = tuple(dict.fromkeys(points))
    return Load(item.name, (0.0, 0.0, force if up else -force), every)


def _pressed_points(
    item: PlacedBrick, press: Press, *, up: bool
) -> Iterator[tuple[float, float, float]]:
    """Yield points on the edges of the studs that a press holds."""
    contact = press_cell(item.cell, item.brick, press, up=up)
    dx, dy = (1, 0) if contact.turned else (0, 1)
    nx, ny = footprint(item.cell, item.brick)
    height = level_height(item.cell.level + (0 if up else item.brick.height))
    for x, y in ((contact.x, contact.y), (contact.x + dx, contact.y + dy)):
        if 0 <= x - item.cell.x < nx and 0 <= y - item.cell.y < ny:
            for i, j in _STUD_EDGE:
                yield (x + 0.5 + i) * STUD_PITCH, (y + 0.5 + j) * STUD_PITCH, height
