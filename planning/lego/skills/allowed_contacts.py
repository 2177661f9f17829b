"""Allowed contacts of the LEGO skills: what touches by the nature of the skill.

Never arm and arm, never tool and tool. Everything is an unordered pair of names: the robot's
tool, a brick, the plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planning.cell.workcell import Fixture
from planning.geometry.robot_bodies import entity
from planning.lego.bricks.assembly import LAYER_HEIGHT, BrickType, Cell, Support
from planning.lego.bricks.grid import occupied_studs
from planning.lego.skills.support import supported_cell
from planning.skills.contacts import Pairs, gripped, touching
from planning.transforms import Transform, inverse

_TOUCH = 0.001
"""A fixture whose top is this near to a brick's bottom carries it [m]."""

Bricks = Mapping[str, tuple[Cell, BrickType]]

Seat = tuple[Cell, BrickType, Transform]
"""Where a brick sits: cell, type, and pose of the centre of its box in the world."""


def contacts_at_rest(
    robot: str, brick: str, seat: Seat, others: Bricks, fixtures: Iterable[Fixture]
) -> Pairs:
    """Return the allowed contacts of a brick, and of the tool on it, at its pick or place.

    That is each other; the bricks around; the fixtures that the brick stands on, plate, and
    table if level; for the tool the bricks beside: its lever wall reaches down along the gripped
    edge, and turns against what stands there.

    Args:
        robot: who picks or places.
        brick: its name.
        seat: where it is then.
        others: all other bricks at rest.
        fixtures: of the cell.
    """
    cell, kind, pose = seat
    studs = occupied_studs(cell, kind)
    around = [name for name in _bordering(studs, (-1, 0, 1), others) if name != brick]
    under = [item.name for item in fixtures if _carries(item, pose)]
    beside = _bordering(studs, (0,), others)
    return (
        gripped(robot, brick)
        | touching(brick, [*around, *under])
        | touching(entity(robot, "tool"), beside)
    )


def supporting(robot: str, support: Support, bricks: Bricks) -> Pairs:
    """Return the contacts of a supporting tool with the bricks it holds, and those beside it.

    Args:
        robot: who supports.
        support: where; a support-top presses on layer z - 1, a support-bottom on z + 1.
        bricks: all bricks, the one being placed included.
    """
    tip = frozenset((c.x, c.y, c.z) for c in supported_cell(support))
    return touching(entity(robot, "tool"), _bordering(tip, (-1, 0, 1), bricks))


def _bordering(
    places: frozenset[tuple[int, int, int]], layers: tuple[int, ...], bricks: Bricks
) -> list[str]:
    """Return the bricks with a face, an edge or a corner on some places of the grid.

    Edges and corners count because bricks are a fifth of a millimetre apart, less than the
    margin that planning keeps.
    """
    border = {
        (x + i, y + j, z + k)
        for x, y, z in places
        for i in (-1, 0, 1)
        for j in (-1, 0, 1)
        for k in layers
    }
    return [
        name
        for name, (cell, kind) in bricks.items()
        if not border.isdisjoint(occupied_studs(cell, kind))
    ]


def _carries(fixture: Fixture, pose: Transform) -> bool:
    bottom = pose[:3, 3] - pose[:3, 2] * LAYER_HEIGHT / 2
    away = inverse(fixture.pose)
    local = away[:3, :3] @ bottom + away[:3, 3]
    half = fixture.size / 2
    inside = bool((abs(local[:2]) <= half[:2]).all())
    return inside and bool(abs(local[2] - half[2]) <= _TOUCH)
