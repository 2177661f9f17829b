"""Bricks of an assembly as objects, fixtures and a collision world, and names of bricks at feeding stations.

A feeding station holds one brick at a time. Each of its bricks is an object of the cell, numbered in the order of
picks: ``"feed.1"`` is there at the start, and ``"feed.2"`` is supplied once ``"feed.1"`` was picked, or lost in the
pick. No step uses the last brick supplied. In the assignment, a station is one object that is never used up; its name
is that of the station in the stock.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import Attachment, CellObject, Fixture, Workcell
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.lego.bricks.assembly import (
    STUD_PITCH,
    BrickType,
    GridSpan,
    LegoAssembly,
    LegoStep,
    PlacedBrick,
    Plate,
    Press,
    StockBrick,
)
from planning.lego.bricks.brick_grips import MOST_OFFSETS, legal_presses
from planning.lego.bricks.brick_tiles import BrickTiles
from planning.lego.bricks.grid import box_pose, box_size, bricks_above, top_pose
from planning.transforms import Transform, read_only_copy, translation

STORAGE = "storage-plate"
"""Name of the fixture on which the stock stands, where it is not the plate of the structure, ``"plate"``."""

_PLATE_THICKNESS = 0.005
"""Thickness of a base plate's box below the surface that bricks rest on [m]."""

_COLOURS_BY_STUDS: dict[tuple[int, int], tuple[int, int, int]] = {
    (1, 1): (242, 205, 55),
    (1, 2): (0, 133, 43),
    (1, 4): (245, 134, 36),
    (1, 6): (144, 31, 118),
    (1, 8): (107, 63, 34),
    (2, 2): (250, 200, 10),
    (2, 4): (180, 0, 0),
    (2, 6): (0, 87, 168),
}
_OTHER_COLOUR = (160, 165, 169)
_FIXED_COLOUR = (100, 103, 101)
"""Colours (r, g, b) of bricks in pictures: by studs, of any other size, and of those that stay in place."""

Placed = tuple[CellObject, Attachment]
"""An object and its pose."""


def copy_name(station: str, number: int) -> str:
    """Return the name of a station's brick, counted from 1 in the order of picks."""
    return f"{station}.{number}"


def station_of(name: str, stations: Collection[str]) -> str:
    """Return the station that an object comes from; for other objects their own name."""
    station, _, number = name.rpartition(".")
    return station if number.isdecimal() and station in stations else name


def next_copy(item: CellObject, station: str, number: int) -> CellObject:
    """Return the next brick that a station supplies after another one."""
    return replace(item, name=copy_name(station, number), later=True)


def brick_colour(brick: BrickType) -> tuple[int, int, int]:
    """Return the colour (r, g, b) that pictures give a brick of this type."""
    low, high = sorted(brick.studs)
    return _COLOURS_BY_STUDS.get((low, high), _OTHER_COLOUR)


def stock_objects(assembly: LegoAssembly) -> tuple[CellObject, ...]:
    """Return the bricks of the stock as objects of the cell, in the order of the stock.

    A feeding station is represented by its first brick.
    """
    return tuple(
        CellObject(
            name=copy_name(item.name, 1) if item.station else item.name,
            kind=item.brick.name,
            shape=box_shape(item.name, box_size(item.brick)),
            start=read_only_copy(box_pose(assembly.plate_of(item), item)),
            mass=item.brick.mass,
            fixed=item.fixed,
            colour=_FIXED_COLOUR if item.fixed else brick_colour(item.brick),
        )
        for item in assembly.stock
    )


def plate_fixture(plate: Plate, name: str = "plate") -> Fixture:
    """Return the base plate as a box whose top face is the surface that bricks rest on."""
    size = np.array([*(n * STUD_PITCH for n in plate.studs), _PLATE_THICKNESS])
    pose = plate.pose @ translation(0.0, 0.0, -_PLATE_THICKNESS / 2)
    return Fixture(name, box_shape(name, size), read_only_copy(pose))


def goal_name(step: int) -> str:
    """Return the name of a step's brick before a stock brick is chosen for it."""
    return f"the brick of step {step}"


def grasp_number(press: Press) -> int:
    """Return the number of a grip among the 4 x 7 possible ones."""
    return (press.side - 1) * MOST_OFFSETS + press.offset


def press_from_number(grasp: int) -> Press:
    """Return the grip of a number: the inverse of ``grasp_number``."""
    return Press(grasp // MOST_OFFSETS + 1, grasp % MOST_OFFSETS)


@dataclass(frozen=True)
class BrickWorld:
    """Objects and poses of an assembly's bricks: the stock at the start, the goals of the steps.

    Attributes:
        cell: the cell, whose objects are the stock.
        assembly: the steps and the stock.
    """

    cell: Workcell
    assembly: LegoAssembly

    @cached_property
    def stock(self) -> Mapping[str, StockBrick]:
        """Stock bricks by name."""
        return {item.name: item for item in self.assembly.stock}

    @cached_property
    def stock_at_rest(self) -> Mapping[str, Placed]:
        """All stock bricks at their start poses; the brick of a station has the name of the station."""
        out = {}
        for item in self.cell.objects:
            name = station_of(item.name, self.stations)
            out[name] = (replace(item, name=name), Attachment(None, item.start))
        return out

    @cached_property
    def stations(self) -> frozenset[str]:
        """Names of the feeding stations."""
        return frozenset(k for k, item in self.stock.items() if item.station)

    @cached_property
    def loose_stock(self) -> frozenset[str]:
        """Stock bricks whose place is empty once they are used: neither fixed nor of a station."""
        return frozenset(
            k for k, item in self.stock.items() if not item.fixed and not item.station
        )

    def stock_neighbours(self, stock: str) -> dict[str, PlacedBrick]:
        """Return the other stock bricks on the plate of a stock brick within two studs of it."""
        near = self.bricks_near_stock(stock, number=1)
        near.pop(stock)
        return near

    @cached_property
    def _tiles(self) -> BrickTiles:
        """Index of the structure's plate: the stock, then the goals by their steps."""
        stock = [
            (0, item)
            for item in self.assembly.stock
            if self._is_on_structure_plate(item)
        ]
        return BrickTiles([*stock, *enumerate(self.goal_bricks, start=1)])

    @cached_property
    def _storage_tiles(self) -> BrickTiles:
        """Index of the stock's plate, where it is a separate one."""
        stock = self.assembly.stock
        return BrickTiles(
            (0, item) for item in stock if not self._is_on_structure_plate(item)
        )

    def _is_on_structure_plate(self, item: StockBrick) -> bool:
        """Tell whether a stock brick stands on the structure's plate."""
        return self.assembly.plate_of(item) is self.assembly.plate

    @cached_property
    def goal_bricks(self) -> tuple[PlacedBrick, ...]:
        """The bricks of the steps in their places, by the names of goals."""
        return tuple(
            PlacedBrick(goal_name(k), step.brick, step.cell)
            for k, step in enumerate(self.assembly.steps, start=1)
        )

    @cached_property
    def _goals(self) -> tuple[Placed, ...]:
        goals = []
        for item in self.goal_bricks:
            pose = read_only_copy(box_pose(self.assembly.plate, item))
            shape = box_shape(item.name, box_size(item.brick))
            thing = CellObject(item.name, item.brick.name, shape, pose)
            goals.append((thing, Attachment(None, pose)))
        return tuple(goals)

    def step(self, number: int) -> LegoStep:
        """Return a step, counted from 1."""
        return self.assembly.steps[number - 1]

    def goal(self, number: int) -> Placed:
        """Return the brick of a step in its place."""
        return self._goals[number - 1]

    @cached_property
    def goal_numbers(self) -> Mapping[str, int]:
        """The step of each goal by its name."""
        return {goal_name(k + 1): k + 1 for k in range(len(self.assembly.steps))}

    def bricks_near(self, span: GridSpan, number: int) -> dict[str, PlacedBrick]:
        """Return the bricks that may stand on the structure's plate in a step, near some cells of the grid."""
        return self._tiles.near(span, before=number)

    def bricks_near_stock(self, stock: str, number: int) -> dict[str, PlacedBrick]:
        """Return the bricks that may stand within two studs of a stock brick in a step, itself included."""
        item = self.stock[stock]
        tiles = (
            self._tiles if self._is_on_structure_plate(item) else self._storage_tiles
        )
        return tiles.near(item.span.widened(1), before=number)

    def standing(self, number: int) -> StandingBoxes:
        """Return the fixtures, the stock at rest and the goals of the steps before one."""
        if number not in self._latest_standing:
            boxes, done = self.all_standing, len(self._goals) - number + 1
            self._latest_standing.clear()
            self._latest_standing[number] = boxes.first(len(boxes.names) - done)
        return self._latest_standing[number]

    @cached_property
    def _latest_standing(self) -> dict[int, StandingBoxes]:
        """What stands in the step that was asked for last, which all skills of the step share."""
        return {}

    @cached_property
    def all_standing(self) -> StandingBoxes:
        """The fixtures, the stock at rest and the goals of all steps."""
        return stand_boxes(
            self.cell.fixtures,
            [
                piece
                for item, at in (*self.stock_at_rest.values(), *self._goals)
                for piece in item.shape.placed(item.name, at.pose)
            ],
        )

    def start_top(self, stock: str) -> Transform:
        """Return the pose of the top face of a stock brick at the start."""
        item = self.stock[stock]
        return top_pose(self.assembly.plate_of(item), item)

    def goal_top(self, number: int) -> Transform:
        """Return the pose of the top face of a step's brick in its place."""
        return top_pose(self.assembly.plate, self.step(number))

    @cached_property
    def above(self) -> Mapping[str, frozenset[str]]:
        """Bricks stacked on each stock brick, at any height."""
        above: dict[str, frozenset[str]] = {}
        for item in sorted(self.assembly.stock, key=lambda item: -item.cell.level):
            upper = bricks_above(item, self.stock_neighbours(item.name))
            above[item.name] = frozenset(upper).union(*(above[k] for k in upper))
        return above

    def usable_stock(self, number: int) -> list[str]:
        """Return the stock bricks and stations of the right type for a step (delta^t, App. B)."""
        step = self.step(number)
        return [
            item.name
            for item in self.assembly.stock
            if item.brick == step.brick
            and not item.fixed
            and step.stock in (None, item.name)
        ]

    def grasps(self, number: int) -> list[int]:
        """Return the candidate grips of a step, the prescribed one alone, or all."""
        step = self.step(number)
        some = step.presses or legal_presses(step.brick)
        return [grasp_number(press) for press in some]

    def are_compatible(self, number: int, grasp: int, support: int) -> bool:
        """Tell whether a step allows a grip in combination with one of its supports.

        Every grip goes with the first support, and every support with the first grip.
        """
        press = self.step(number).press
        return support == 0 or press is None or grasp == grasp_number(press)
