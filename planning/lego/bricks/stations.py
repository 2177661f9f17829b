"""Feeding stations: places at which there is always another brick.

A station holds one brick at a time. Its bricks are objects of their own, numbered in the order in
which they are picked: ``"feed.1"`` stands there at the start, ``"feed.2"`` comes up once the pick
of ``"feed.1"`` is complete, and so on; one more than steps use is left over. To the assignment a
station is one object without end, named as in the stock.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable
from dataclasses import replace

from planning.cell.workcell import CellObject


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
