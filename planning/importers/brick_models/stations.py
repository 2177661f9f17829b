"""Feeding stations of a chosen cell: one for each type near each robot, where it reaches them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from planning.cell.workcell import PlacedRobot
from planning.errors import ScenarioError
from planning.lego.bricks.assembly import BRICK_LEVELS, BrickType, Cell, Plate
from planning.lego.bricks.grid import GridSpan, occupied_span, top_pose
from planning.lego.bricks.grips import presses
from planning.lego.skills.targets import lever_reaches_below, pick_targets
from planning.steps.skill import SkillPath, skill_postures

APART = 2
"""Studs between two stations."""

AWAY = 3
"""Studs between a station and the structure."""


@dataclass(frozen=True)
class Station:
    """A feeding station.

    Attributes:
        brick: the type it feeds.
        cell: where its bricks come up.
        stand: type of the fixed brick below it, None where it is on the plate.
    """

    brick: BrickType
    cell: Cell
    stand: BrickType | None


def stations(
    robot: PlacedRobot,
    plate: Plate,
    structure: GridSpan,
    kinds: Sequence[BrickType],
    *,
    far: bool,
) -> list[Station]:
    """Return a station for each type on a robot's side of the plate.

    Columns fill from the edge of the plate, each from its middle to its ends, the largest types
    first. A plate's station stands on a brick: beside it the tool needs the room below.

    Args:
        robot: who is to reach them.
        plate: of the structure.
        structure: where the structure will be; nothing comes near.
        kinds: the types.
        far: on the side of the plate's greatest x, turned by half a turn against the other side.

    Raises:
        ScenarioError: there is no room within reach for one of them.
    """
    out: list[Station] = []
    taken: list[GridSpan] = []
    for kind in sorted(kinds, key=lambda k: (-k.height, -k.studs[0] * k.studs[1])):
        for cell in _places(plate, structure, kind, far=far):
            span = occupied_span(cell, kind)
            if any(_near(span, other, APART) for other in taken):
                continue
            station = _station(kind, cell)
            if _reaches(robot, plate, station):
                taken.append(span)
                out.append(station)
                break
        else:
            side = "right" if far else "left"
            raise ScenarioError(
                f"no room for a feeding station of {kind.name} within reach of the {side} robot: "
                f"the structure of {structure.x1 - structure.x0} x "
                f"{structure.y1 - structure.y0} studs and {len(out)} stations take it;"
                " give a cell of your own (--cell)"
            )
    return out


def _places(
    plate: Plate, structure: GridSpan, kind: BrickType, *, far: bool
) -> Iterator[Cell]:
    """Yield the cells of a station in the order in which they are tried."""
    wide, deep = plate.studs
    nx, ny = kind.studs
    middle = (deep - ny) // 2
    room = (wide - structure.x1 if far else structure.x0) - AWAY - nx
    rows = sorted(range(APART, deep - ny - APART + 1), key=lambda y: abs(y - middle))
    for x in range(APART, room + 1):
        for y in rows:
            yield Cell(wide - x - nx, deep - y - ny, 1) if far else Cell(x, y, 1)


def _station(kind: BrickType, cell: Cell) -> Station:
    if not lever_reaches_below(kind):
        return Station(kind, cell, None)
    stand = BrickType(f"{kind.studs[0]}x{kind.studs[1]}", kind.studs, 0.0)
    at = Cell.at_level(cell.x, cell.y, BRICK_LEVELS, turned=cell.turned)
    return Station(kind, at, stand)


def _near(a: GridSpan, b: GridSpan, studs: int) -> bool:
    """Tell whether there are fewer studs than these between two rooms, along x and along y."""
    return (
        a.x0 < b.x1 + studs
        and b.x0 < a.x1 + studs
        and a.y0 < b.y1 + studs
        and b.y0 < a.y1 + studs
    )


def _reaches(robot: PlacedRobot, plate: Plate, station: Station) -> bool:
    """Tell whether a robot reaches a station with every grip."""
    top = top_pose(plate, station.cell, station.brick)
    frames = robot.model.frames
    return all(
        any(
            isinstance(found, SkillPath)
            for found in skill_postures(
                robot, pick_targets(frames, station.brick, top, press)
            )
        )
        for press in presses(station.brick)
    )
