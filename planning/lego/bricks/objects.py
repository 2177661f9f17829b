"""LEGO bricks and plate as objects and fixtures of the cell."""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from planning.cell.cover import box_body
from planning.cell.workcell import CellObject, Fixture
from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    STUD_PITCH,
    BrickType,
    Cell,
    LegoAssembly,
    Plate,
    StockBrick,
)
from planning.lego.bricks.catalogue import brick_type
from planning.lego.bricks.grid import box_pose, box_size, on_plate, overlapping
from planning.lego.bricks.stations import copy_name
from planning.transforms import readonly, translation

STORAGE = "storage-plate"
"""Name of the plate of the stock as a fixture, where it is another than ``"plate"``."""

PLATE_THICKNESS = 0.005
"""Thickness of a base plate's box below the surface that bricks rest on [m]."""

_COLOURS: dict[tuple[int, int], tuple[int, int, int]] = {
    (1, 1): (242, 205, 55),
    (1, 2): (0, 133, 43),
    (1, 4): (245, 134, 36),
    (1, 6): (144, 31, 118),
    (1, 8): (107, 63, 34),
    (2, 2): (250, 200, 10),
    (2, 4): (180, 0, 0),
    (2, 6): (0, 87, 168),
}
_OTHER = (160, 165, 169)
_FIXED = (100, 103, 101)


def brick_colour(brick: BrickType) -> tuple[int, int, int]:
    """Return the colour (r, g, b) that pictures give a brick of this type."""
    low, high = sorted(brick.studs)
    return _COLOURS.get((low, high), _OTHER)


def stock_objects(assembly: LegoAssembly) -> tuple[CellObject, ...]:
    """Return the bricks of the stock as objects of the cell, in the order of the stock.

    Of a feeding station it is the first brick.

    Raises:
        ScenarioError: a type is unknown, a name is used twice, a brick lies off the plate, or
            two bricks overlap.
    """
    on: dict[int, dict[str, tuple[Cell, BrickType]]] = defaultdict(dict)
    for item in assembly.stock:
        brick = brick_type(item.brick, assembly.bricks)
        plate = assembly.plate_of(item)
        placed = on[id(plate)]
        if any(item.name in bricks for bricks in on.values()):
            raise ScenarioError(f"two stock bricks are called {item.name!r}")
        if not on_plate(plate, item.cell, brick):
            nx, ny = plate.studs
            raise ScenarioError(
                f"stock brick {item.name!r} at {_place(item.cell)} is not on the plate of "
                f"{nx} x {ny} studs"
            )
        if clash := overlapping(item.cell, brick, placed):
            raise ScenarioError(
                f"stock brick {item.name!r} at {_place(item.cell)} overlaps {clash[0]!r}"
            )
        placed[item.name] = (item.cell, brick)
    return tuple(stock_object(assembly, item) for item in assembly.stock)


def stock_object(assembly: LegoAssembly, item: StockBrick) -> CellObject:
    """Return one stock brick as an object of the cell."""
    brick = brick_type(item.brick, assembly.bricks)
    size = box_size(brick)
    return CellObject(
        name=copy_name(item.name, 1) if item.station else item.name,
        kind=item.brick,
        size=readonly(size),
        start=readonly(box_pose(assembly.plate_of(item), item.cell, brick)),
        body=box_body(item.name, size),
        mass=brick.mass,
        fixed=item.fixed,
        colour=_FIXED if item.fixed else brick_colour(brick),
    )


def plate_fixture(plate: Plate, name: str = "plate") -> Fixture:
    """Return the base plate as a box whose top face is the surface that bricks rest on."""
    size = np.array([*(n * STUD_PITCH for n in plate.studs), PLATE_THICKNESS])
    pose = plate.pose @ translation(0.0, 0.0, -PLATE_THICKNESS / 2)
    return Fixture(name, readonly(size), readonly(pose), box_body(name, size))


def _place(cell: Cell) -> str:
    turned = " turned" if cell.turned else ""
    return f"[{cell.x}, {cell.y}, {cell.z}]{turned}"
