"""Allowed contacts of the LEGO skills: what touches by the nature of the skill.

Never arm and arm, never tool and tool. Everything is an unordered pair of names: the robot's
tool, a brick, the plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planning.cell.workcell import Fixture
from planning.geometry.robot_bodies import entity
from planning.lego.bricks.assembly import (
    BRICKS,
    BrickType,
    GridSpan,
    OnGrid,
    PlacedBrick,
    Press,
    Support,
)
from planning.lego.bricks.grid import brick_height, lever_cell
from planning.lego.skills.targets import lever_reaches_below, supported_span
from planning.steps.skill import Pairs, gripped, touching
from planning.transforms import Transform, inverse

_TOUCH = 0.001
"""A fixture whose top is this near to a brick's bottom carries it [m]."""

PRESSED = 0.003
"""How deep a tool may go into bricks that it is allowed to touch: the audit lets pass as much [m]."""

Bricks = Mapping[str, OnGrid]


def contacts_at_rest(
    robot: str,
    item: PlacedBrick,
    pose: Transform,
    press: Press,
    others: Bricks,
    fixtures: Iterable[Fixture],
) -> Pairs:
    """Return the allowed contacts of a brick, and of the tool on it, at its pick or place.

    That is each other; the bricks around; the fixtures that the brick stands on, plate, and
    table if level; for the tool the bricks beside: its lever wall reaches down along the gripped
    edge, and turns against what stands there. Along the edge of a plate it reaches to the bottom,
    where it touches what ends beside it: what the plate stands on, if that ends at the edge.

    Args:
        robot: who picks or places.
        item: the brick where it is then.
        pose: of the centre of its box in the world.
        press: the grip.
        others: all other bricks at rest near ``room_at_rest``, or more.
        fixtures: of the cell.
    """
    name, span = item.name, item.span
    around = [other for other in _bordering(span, others, levels=1) if other != name]
    under = [one.name for one in fixtures if _carries(one, item.brick, pose)]
    beside = _bordering(span, others, levels=0)
    if lever_reaches_below(item.brick):
        lever = PlacedBrick("", BRICKS["1x2"], lever_cell(item, press)).span
        beside += [
            other
            for other in _bordering(lever, others, levels=1)
            if not lever.shares_studs(others[other].span)
        ]
    return (
        gripped(robot, name)
        | touching(name, [*around, *under])
        | touching(entity(robot, "tool"), beside)
    )


def leaned_on(item: OnGrid, others: Bricks) -> frozenset[str]:
    """Return the bricks beside a brick that is picked, one stud away from it.

    The tool reaches one stud over the edge that it grips: it stands a tenth of a millimetre beside
    them, and the twist that loosens the brick leans it onto their upper edge, by 2.1 mm for 16
    degrees, and by some tenths more on the way where joints turn evenly. Published tasks pick bricks
    that stand so.
    """
    near = _bordering(item.span, others, levels=0)
    around = _bordering(item.span.widened(1), others, levels=0)
    return frozenset(around) - frozenset(near)


def room_at_rest(item: OnGrid) -> GridSpan:
    """Return the room of a brick at its pick or place, the tool's wall beside a plate included.

    Whatever contacts_at_rest names is near to it.
    """
    return item.span.widened(1) if lever_reaches_below(item.brick) else item.span


def supporting(robot: str, support: Support, bricks: Bricks) -> Pairs:
    """Return the contacts of a supporting tool with the bricks it holds, and those beside it.

    A support-top presses on layer z - 1, a support-bottom on z + 1.
    """
    tip = supported_span(support)
    return touching(entity(robot, "tool"), _bordering(tip, bricks, levels=1))


def _bordering(span: GridSpan, bricks: Bricks, *, levels: int) -> list[str]:
    """Return the bricks with a face, an edge or a corner on some room of the grid.

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
