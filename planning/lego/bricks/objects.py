"""LEGO bricks and plate as objects and fixtures of the cell, and the names of feeding stations' bricks.

A station holds one brick at a time. Its bricks are objects of their own, numbered in the order in
which they are picked: ``"feed.1"`` stands there at the start, ``"feed.2"`` comes up once the pick
of ``"feed.1"`` is complete, and so on; one more than steps use is left over. To the assignment a
station is one object without end, named as in the stock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, Fixture
from planning.lego.bricks.assembly import (
    STUD_PITCH,
    BrickType,
    LegoAssembly,
    Plate,
    StockBrick,
)
from planning.lego.bricks.grid import box_pose, box_size
from planning.transforms import readonly, translation


def copy_name(station: str, number: int) -> str:
    """Return the name of a station's brick, counted from 1 in the order of their picks."""
    return f"{station}.{number}"


def source_of(name: str, stations: Collection[str]) -> str:
    """Return the station that an object comes from; for any other object its own name."""
    station, _, number = name.rpartition(".")
    return station if number.isdecimal() and station in stations else name


def object_names(sources: Iterable[str], stations: Collection[str]) -> list[str]:
    """Return the objects that steps use, given the stock bricks and stations they draw on.

    Args:
        sources: names in the stock, in the order of the steps.
        stations: names of the stations among them.
    """
    picked: Counter[str] = Counter()
    names = []
    for source in sources:
        picked[source] += 1
        copy = copy_name(source, picked[source])
        names.append(copy if source in stations else source)
    return names


def next_copy(item: CellObject, station: str, number: int) -> CellObject:
    """Return a brick that comes up at a station, made after another one of it."""
    return replace(item, name=copy_name(station, number), later=True)


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
    """
    return tuple(_stock_object(assembly, item) for item in assembly.stock)


def _stock_object(assembly: LegoAssembly, item: StockBrick) -> CellObject:
    brick, size = item.brick, box_size(item.brick)
    return CellObject(
        name=copy_name(item.name, 1) if item.station else item.name,
        kind=brick.name,
        shape=box_shape(item.name, size),
        start=readonly(box_pose(assembly.plate_of(item), item.cell, brick)),
        mass=brick.mass,
        fixed=item.fixed,
        colour=_FIXED if item.fixed else brick_colour(brick),
    )


def plate_fixture(plate: Plate, name: str = "plate") -> Fixture:
    """Return the base plate as a box whose top face is the surface that bricks rest on."""
    size = np.array([*(n * STUD_PITCH for n in plate.studs), PLATE_THICKNESS])
    pose = plate.pose @ translation(0.0, 0.0, -PLATE_THICKNESS / 2)
    return Fixture(name, box_shape(name, size), readonly(pose))
