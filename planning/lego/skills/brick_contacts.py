"""Allowed contacts in picks, places and supports of bricks.

Only contacts that a skill requires are allowed; two arms or two tools may never touch. A contact is an unordered pair
of names: a tool of a robot, a brick, or the plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planning.cell.workcell import Fixture
from planning.geometry.robot_bodies import entity_name
from planning.handling.skill_contacts import grip_contact
from planning.lego.bricks.assembly import (
    BrickType,
    GridSpan,
    OnGrid,
    PlacedBrick,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import lever_cell
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import brick_height
from planning.lego.skills.support_targets import LEVER_WALL, STUD_HEIGHT, supported_span
from planning.steps.skill import Pairs, contacts_with
from planning.transforms import Transform, inverse

_TOUCH = 0.001
"""Distance from the bottom of a brick to the top of a fixture below which the fixture carries it [m]."""

PRESSED = 0.003
"""How deep a tool may go into bricks that it is allowed to touch: the audit lets pass as much [m]."""

Bricks = Mapping[str, OnGrid]


def lever_reaches_below(brick: BrickType) -> bool:
    """Tell whether the wall next to the tool's grip reaches the knobs below the brick."""
    return brick_height(brick) < LEVER_WALL + STUD_HEIGHT


def resting_contacts(
    robot: str,
    item: PlacedBrick,
    pose: Transform,
    press: Press,
    others: Bricks,
    fixtures: Iterable[Fixture],
) -> Pairs:
    """Return the allowed contacts of a brick, and of the tool on it, at its pick or place.

    These are with each other; the bricks around; the fixtures that the brick stands on, plate, and
    table if level; for the tool the adjacent bricks: its lever wall reaches down along the gripped
    edge, and turns against what stands there. Along the edge of a plate it reaches to the bottom,
    where it touches what ends beside it: what the plate stands on, if that ends at the edge.

    Args:
        robot: the robot that picks or places.
        item: the brick where it is then.
        pose: of the centre of its box in the world.
        press: the grip.
        others: all other bricks at rest near ``resting_room``, or more.
        fixtures: of the cell.
    """
    name, span = item.name, item.span
    around = [other for other in _bordering(span, others, levels=1) if other != name]
    under = [one.name for one in fixtures if _carries(one, item.brick, pose)]
    neighbours = _bordering(span, others, levels=0)
    if lever_reaches_below(item.brick):
        lever = PlacedBrick("", BRICKS["1x2"], lever_cell(item, press)).span
        neighbours += [
            other
            for other in _bordering(lever, others, levels=1)
            if not lever.shares_studs(others[other].span)
        ]
    return (
        grip_contact(robot, name)
        | contacts_with(name, [*around, *under])
        | contacts_with(entity_name(robot, "tool"), neighbours)
    )


def neighbours_leaned_on(item: OnGrid, others: Bricks) -> frozenset[str]:
    """Return the bricks next to a picked brick, one stud away from it.

    The tool reaches one stud over the edge that it grips: it stands a tenth of a millimetre beside
    them, and the twist that loosens the brick leans it onto their upper edge, by 2.1 mm for 16
    degrees, and by some tenths more on the way where joints turn evenly. Published tasks pick bricks
    that stand so.
    """
    near = _bordering(item.span, others, levels=0)
    around = _bordering(item.span.widened(1), others, levels=0)
    return frozenset(around) - frozenset(near)


def resting_room(item: OnGrid) -> GridSpan:
    """Return the block of a brick at its pick or place, the tool's wall next to a plate included.

    Whatever resting_contacts names is near to it.
    """
    return item.span.widened(1) if lever_reaches_below(item.brick) else item.span


def support_contacts(robot: str, support: Support, bricks: Bricks) -> Pairs:
    """Return the contacts of a supporting tool with the supported bricks, and with their neighbours.

    A support-top presses on layer z - 1, a support-bottom on z + 1.
    """
    tip = supported_span(support)
    return contacts_with(entity_name(robot, "tool"), _bordering(tip, bricks, levels=1))


def _bordering(span: GridSpan, bricks: Bricks, *, levels: int) -> list[str]:
    """Return the bricks that share a face, an edge or a corner with a block of the grid.

    Edges and corners count because bricks are a fifth of a millimetre apart, less than the
    margin that planning keeps. Those above and below count where ``levels`` is 1.
    """
    return [
        name for name, item in bricks.items() if span.near(item.span, levels=levels)
    ]


def _carries(fixture: Fixture, brick: BrickType, pose: Transform) -> bool:
    bottom = pose[:3, 3] - pose[:3, 2] * brick_height(brick) / 2
    away = inverse(fixture.pose)
    local = away[:3, :3] @ bottom + away[:3, 3]
    half = fixture.size / 2
    inside = bool((abs(local[:2]) <= half[:2]).all())
    return inside and bool(abs(local[2] - half[2]) <= _TOUCH)
