"""Who may touch whom in the LEGO skills: what is in contact by the nature of the skill.

Never arm and arm, never tool and tool. Everything is an unordered pair of names: the robot's
tool, a brick, the plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from planning.cell.workcell import Fixture
from planning.geometry.scene_checker import entity
from planning.lego.bricks.assembly import LAYER_HEIGHT, BrickType, Cell, Support
from planning.lego.bricks.grid import occupied_studs
from planning.lego.skills.support import supported_cell
from planning.skills.joint_paths import Pairs
from planning.transforms import Transform, inverse

_TOUCH = 0.001
"""A fixture whose top is this near to a brick's bottom carries it [m]."""

Bricks = Mapping[str, tuple[Cell, BrickType]]


def pair(first: str, second: str) -> frozenset[str]:
    """Return an unordered pair."""
    return frozenset((first, second))


def tool_of(robot: str) -> str:
    """Return the name of a robot's tool among the entities."""
    return entity(robot, "tool")


def gripped(robot: str, brick: str) -> Pairs:
    """Return the contact of a tool with the brick it handles."""
    return frozenset({pair(tool_of(robot), brick)})


def seated(brick: str, cell: Cell, kind: BrickType, others: Bricks) -> Pairs:
    """Return the contacts of a brick with the bricks around it where it sits.

    Args:
        brick: its name.
        cell: where it sits.
        kind: its type.
        others: all other bricks at rest.
    """
    around = _bordering(occupied_studs(cell, kind), (-1, 0, 1), others)
    return frozenset(pair(brick, other) for other in around if other != brick)


def grounded(brick: str, pose: Transform, fixtures: Iterable[Fixture]) -> Pairs:
    """Return the contacts of a brick with the fixtures it stands on: plate, and table if level.

    Args:
        brick: its name.
        pose: of the centre of its box in the world.
        fixtures: of the cell.
    """
    bottom = pose[:3, 3] - pose[:3, 2] * LAYER_HEIGHT / 2
    out = set()
    for fixture in fixtures:
        away = inverse(fixture.pose)
        local = away[:3, :3] @ bottom + away[:3, 3]
        half = fixture.size / 2
        inside = bool((abs(local[:2]) <= half[:2]).all())
        if inside and abs(local[2] - half[2]) <= _TOUCH:
            out.add(pair(brick, fixture.name))
    return frozenset(out)


def beside_tool(robot: str, cell: Cell, kind: BrickType, others: Bricks) -> Pairs:
    """Return the contacts of a tool with the bricks beside the one it grips or places.

    Its lever wall reaches down along the gripped edge, and turns against what stands there.
    """
    around = _bordering(occupied_studs(cell, kind), (0,), others)
    return frozenset(pair(tool_of(robot), name) for name in around)


def supporting(robot: str, support: Support, bricks: Bricks) -> Pairs:
    """Return the contacts of a supporting tool with the bricks it holds, and those beside it.

    Args:
        robot: who supports.
        support: where; a support-top presses on layer z - 1, a support-bottom on z + 1.
        bricks: all bricks, the one being placed included.
    """
    tip = {(c.x, c.y, c.z) for c in supported_cell(support)}
    around = _bordering(frozenset(tip), (-1, 0, 1), bricks)
    return frozenset(pair(tool_of(robot), name) for name in around)


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
