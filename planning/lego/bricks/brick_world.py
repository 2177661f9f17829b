"""The bricks of an assembly as a collision world: the stock, and the goals of the steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

from planning.cell.shape import box_shape
from planning.cell.workcell import Attachment, CellObject, Workcell
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.lego.bricks.assembly import (
    BrickType,
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    Press,
    StockBrick,
)
from planning.lego.bricks.grid import (
    BrickTiles,
    GridSpan,
    box_pose,
    box_size,
    bricks_above,
    occupied_span,
    top_pose,
)
from planning.lego.bricks.grips import MOST_OFFSETS, presses
from planning.lego.bricks.objects import source_of
from planning.transforms import Transform, readonly

Placed = tuple[CellObject, Attachment]


def goal_name(step: int) -> str:
    """Return the name of a step's brick before one of the stock is chosen for it."""
    return f"the brick of step {step}"


def grasp_number(press: Press) -> int:
    """Return the number of a grip among the 4 x 7 there can be."""
    return (press.side - 1) * MOST_OFFSETS + press.offset


def press_of(grasp: int) -> Press:
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
        """All stock bricks where they stand at the start, a station's under its name."""
        out = {}
        for item in self.cell.objects:
            name = source_of(item.name, self.stations)
            out[name] = (replace(item, name=name), Attachment(None, item.start))
        return out

    @cached_property
    def stations(self) -> frozenset[str]:
        """Names of the feeding stations."""
        return frozenset(k for k, item in self.stock.items() if item.station)

    @cached_property
    def loose_stock(self) -> frozenset[str]:
        """Stock bricks that are gone once they have been used."""
        return frozenset(
            k for k, item in self.stock.items() if not item.fixed and not item.station
        )

    def stock_on(self, plate: Plate) -> dict[str, tuple[Cell, BrickType]]:
        """Return cell and type of each stock brick on a plate."""
        return {
            k: (s.cell, s.brick)
            for k, s in self.stock.items()
            if self.assembly.plate_of(s) is plate
        }

    def stock_beside(self, stock: str) -> dict[str, tuple[Cell, BrickType]]:
        """Return cell and type of the other stock bricks within two studs of one on its plate."""
        near = self.cells_near_stock(stock, number=1)
        near.pop(stock)
        return near

    @cached_property
    def _stock_tiles(self) -> Mapping[str, BrickTiles]:
        """For each stock brick the tiles of its plate, on which goals stand as well."""
        stored = BrickTiles(
            (0, k, s.cell, s.brick)
            for k, s in self.stock.items()
            if self.assembly.plate_of(s) is not self.assembly.plate
        )
        return {
            k: self._tiles
            if self.assembly.plate_of(s) is self.assembly.plate
            else stored
            for k, s in self.stock.items()
        }

    @cached_property
    def _tiles(self) -> BrickTiles:
        """The structure's plate: the stock, then the goals by their steps."""
        stock = [
            (0, k, *brick) for k, brick in self.stock_on(self.assembly.plate).items()
        ]
        steps = enumerate(self.assembly.steps, start=1)
        goals = [(k, goal_name(k), step.cell, step.brick) for k, step in steps]
        return BrickTiles([*stock, *goals])

    @cached_property
    def _goals(self) -> tuple[Placed, ...]:
        goals = []
        for number, step in enumerate(self.assembly.steps, start=1):
            name, size = goal_name(number), box_size(step.brick)
            pose = readonly(box_pose(self.assembly.plate, step.cell, step.brick))
            item = CellObject(name, step.brick.name, box_shape(name, size), pose)
            goals.append((item, Attachment(None, pose)))
        return tuple(goals)

    def step(self, number: int) -> LegoStep:
        """Return a step, counted from 1."""
        return self.assembly.steps[number - 1]

    def frames(self, robot: str) -> Mapping[str, Transform]:
        """Return a robot's tool frames in its flange frame."""
        return self.cell.robot(robot).model.frames

    def goal(self, number: int) -> Placed:
        """Return the brick of a step in its place."""
        return self._goals[number - 1]

    def goals(self, numbers: Iterable[int]) -> dict[str, Placed]:
        """Return the bricks of some steps in their places, by name."""
        return {goal_name(k): self.goal(k) for k in numbers}

    @cached_property
    def goal_numbers(self) -> Mapping[str, int]:
        """The step of each goal by its name."""
        return {goal_name(k + 1): k + 1 for k in range(len(self.assembly.steps))}

    def goal_cells(self, numbers: Iterable[int]) -> dict[str, tuple[Cell, BrickType]]:
        """Return cell and type of the bricks of some steps in their places."""
        return {goal_name(k): (self.step(k).cell, self.step(k).brick) for k in numbers}

    def cells_near(
        self, span: GridSpan, number: int
    ) -> dict[str, tuple[Cell, BrickType]]:
        """Return the bricks near some room that may stand on the structure's plate in a step."""
        return self._tiles.near(span, before=number)

    def cells_near_stock(
        self, stock: str, number: int
    ) -> dict[str, tuple[Cell, BrickType]]:
        """Return the bricks within two studs of a stock brick that may stand on its plate in a step.

        It is among them.
        """
        item = self.stock[stock]
        span = occupied_span(item.cell, item.brick).widened(1)
        return self._stock_tiles[stock].near(span, before=number)

    def standing(self, number: int) -> StandingBoxes:
        """Return the fixtures, the stock at rest and the goals of the steps before one."""
        done = len(self._goals) - number + 1
        boxes = self.all_standing
        return boxes.first(len(boxes.names) - done)

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
        plate = self.assembly.plate_of(item)
        return top_pose(plate, item.cell, item.brick)

    def goal_top(self, number: int) -> Transform:
        """Return the pose of the top face of a step's brick in its place."""
        step = self.step(number)
        return top_pose(self.assembly.plate, step.cell, step.brick)

    def above(self, stock: str) -> frozenset[str]:
        """Return the stock bricks that stand on a stock brick, however high."""
        known = self._above.get(stock)
        if known is None:
            item, others = self.stock[stock], self.stock_beside(stock)
            upper = bricks_above(item.cell, item.brick, others)
            known = frozenset(upper).union(*map(self.above, upper))
            self._above[stock] = known
        return known

    @cached_property
    def _above(self) -> dict[str, frozenset[str]]:
        return {}

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
        """Return the grips of a step to choose from, the prescribed one alone, or all."""
        step = self.step(number)
        some = step.presses or presses(step.brick)
        return [grasp_number(press) for press in some]

    def go_together(self, number: int, grasp: int, support: int) -> bool:
        """Tell whether a step allows a grip together with one of its supports.

        Every grip goes with the first support, and every support with the first grip.
        """
        press = self.step(number).press
        return support == 0 or press is None or grasp == grasp_number(press)
