"""LEGO assemblies as data: plate, brick types, stock and steps, on the stud grid.

The grid of a base plate counts studs from its corner: x and y from 0, layer z from 1 (on the plate).
Heights are measured in levels of a third of a brick, since LEGO plates, which are also brick types, are a third as
high as a brick. A brick of layer z extends from level 3 (z - 1) to level 3 z; ``raised`` levels are added to both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

from planning.transforms import Transform

STUD_PITCH = 0.008
"""Distance between studs [m]."""

LAYER_HEIGHT = 0.0096
"""Height of a brick without its studs [m]."""

BRICK_LEVELS = 3
"""Height of a brick in levels; the brick types called plates are one level high."""

GridPlace = tuple[int, int, int]
"""A place on the grid: stud in x and y from 0, level from 0 on the plate."""


@dataclass(frozen=True)
class BrickType:
    """A type of brick.

    Attributes:
        name: such as ``"2x4"``, or the number a published library gives it.
        studs: studs along the brick's own x and y.
        mass: [kg].
        height: without its studs [levels]: 3 for a brick, 1 for a plate.
        bare: the studs (x, y) in its own axes that have no knob on top.
    """

    name: str
    studs: tuple[int, int]
    mass: float
    height: int = BRICK_LEVELS
    bare: frozenset[tuple[int, int]] = frozenset()


@dataclass(frozen=True)
class Plate:
    """A base plate.

    Attributes:
        pose: of the centre of the surface that bricks rest on, in the world.
        studs: studs along x and y.
    """

    pose: Transform
    studs: tuple[int, int] = (48, 48)


@dataclass(frozen=True)
class Cell:
    """Position of a brick on the grid: the stud of its least x and y, its layer, and whether it is turned.

    Attributes:
        x, y: stud of the least corner, from 0.
        z: layer in which its bottom is, 1 on the plate.
        turned: True when the brick is turned by +90 degrees about z.
        raised: levels from the bottom of the layer to the bottom of the brick, 0 to 2.
    """

    x: int
    y: int
    z: int
    turned: bool = False
    raised: int = 0

    @classmethod
    def at_level(cls, x: int, y: int, level: int, *, turned: bool = False) -> Cell:
        """Return the cell of a brick whose bottom is at a level."""
        layers, raised = divmod(level, BRICK_LEVELS)
        return cls(x, y, layers + 1, turned, raised)

    @property
    def level(self) -> int:
        """Level of the brick's bottom, 0 on the plate."""
        return BRICK_LEVELS * (self.z - 1) + self.raised

    @property
    def entry(self) -> dict[str, Any]:
        """The cell as a scenario file writes it."""
        raised = {"raised": self.raised} if self.raised else {}
        turned = {"turned": True} if self.turned else {}
        return {"at": [self.x, self.y, self.z], **raised, **turned}

    @property
    def words(self) -> str:
        """Place in words, such as ``"[3, 4, 1]"`` or ``"[3, 4, 1] raised 2"``."""
        raised = f" raised {self.raised}" if self.raised else ""
        return f"[{self.x}, {self.y}, {self.z}]{raised}"


class GridSpan(NamedTuple):
    """Block of grid places as half-open ranges: x0 to x1 and y0 to y1 in studs, bottom to top in levels."""

    x0: int
    x1: int
    y0: int
    y1: int
    bottom: int
    top: int

    @property
    def size(self) -> tuple[int, int]:
        """Studs along the grid's x and y."""
        return self.x1 - self.x0, self.y1 - self.y0

    @property
    def studs(self) -> frozenset[tuple[int, int]]:
        """The (x, y) of every stud that the block covers."""
        return frozenset(product(range(self.x0, self.x1), range(self.y0, self.y1)))

    @property
    def places(self) -> frozenset[GridPlace]:
        """The (x, y, level) of every grid place in the block."""
        xs, ys = range(self.x0, self.x1), range(self.y0, self.y1)
        return frozenset(product(xs, ys, range(self.bottom, self.top)))

    def widened(self, studs: int) -> GridSpan:
        """Return the block extended by some studs along x and y."""
        x0, x1, y0, y1, *heights = self
        return GridSpan(x0 - studs, x1 + studs, y0 - studs, y1 + studs, *heights)

    def shared(self, other: GridSpan) -> GridSpan:
        """Return the intersection of two blocks, without extent along the axis where they only touch."""
        ends = enumerate(zip(self, other, strict=True))
        return GridSpan(*(min(pair) if k % 2 else max(pair) for k, pair in ends))

    def near(self, other: GridSpan, *, levels: int) -> bool:
        """Tell whether another block begins within one stud sideways and a number of levels above or below."""
        return (
            self.x0 <= other.x1
            and other.x0 <= self.x1
            and self.y0 <= other.y1
            and other.y0 <= self.y1
            and self.bottom < other.top + levels
            and other.bottom < self.top + levels
        )

    def carries(self, other: GridSpan) -> bool:
        """Tell whether another brick stands on this one."""
        return other.bottom == self.top and self.shares_studs(other)

    def shares_studs(self, other: GridSpan) -> bool:
        """Tell whether another block is above or below this one, or overlaps it."""
        return (
            self.x0 < other.x1
            and other.x0 < self.x1
            and self.y0 < other.y1
            and other.y0 < self.y1
        )


class OnGrid:
    """A brick of a type at a position on the grid.

    Attributes:
        brick: its type.
        cell: where it is.
    """

    brick: BrickType
    cell: Cell

    @cached_property
    def span(self) -> GridSpan:
        """The block of grid places that it fills."""
        x, y, level = self.cell.x, self.cell.y, self.cell.level
        nx, ny = self.brick.studs[::-1] if self.cell.turned else self.brick.studs
        return GridSpan(x, x + nx, y, y + ny, level, level + self.brick.height)

    @cached_property
    def studs(self) -> frozenset[tuple[int, int]]:
        """The (x, y) of every stud that it covers."""
        return self.span.studs

    @cached_property
    def knobs(self) -> frozenset[tuple[int, int]]:
        """The (x, y) of every stud that it covers and has a knob on."""
        x, y, last = self.cell.x, self.cell.y, self.brick.studs[1] - 1
        bare = self.brick.bare
        if self.cell.turned:
            return self.studs - {(x + last - j, y + i) for i, j in bare}
        return self.studs - {(x + i, y + j) for i, j in bare}

    @cached_property
    def places(self) -> frozenset[GridPlace]:
        """The (x, y, level) of every place on the grid that it fills."""
        return self.span.places


@dataclass(frozen=True)
class PlacedBrick(OnGrid):
    """A brick of a structure.

    Attributes:
        name: unique in the structure.
        brick: its type.
        cell: where it is.
    """

    name: str
    brick: BrickType
    cell: Cell


@dataclass(frozen=True)
class Press:
    """Grip of the tool on a brick, with which it also presses the brick onto others.

    Attributes:
        side: 1 to 4. For a brick that is not turned: 1 = edge of least x, 2 = of greatest y,
            3 = of least y, 4 = of greatest x.
        offset: stud index along that edge; the tool covers studs offset and offset + 1.
    """

    side: int
    offset: int


@dataclass(frozen=True)
class Support:
    """Support of a structure: the 1 x 2 cell of the supporting tool.

    Attributes:
        cell: its least stud and its layer z.
        orientation: 0 = the tool comes from -x, 1 = from +y with J1 at -90 deg,
            2 = with J1 at +90 deg, 3 = from +x.
        from_above: True where the tool stands on the bricks of layer z - 1 instead of holding
            those of layer z + 1 from below.
    """

    cell: Cell
    orientation: int
    from_above: bool = False


@dataclass(frozen=True)
class StockBrick(PlacedBrick):
    """A brick that stands on a plate at the start; its name is unique in the scenario.

    Attributes:
        fixed: scaffolding that no step may use.
        station: a feeding station: once a brick has been picked there, the next one of this
            type stands at this cell.
    """

    fixed: bool = False
    station: bool = False


@dataclass(frozen=True)
class LegoStep(OnGrid):
    """One step of the assembly sequence.

    Attributes:
        brick: type that it places.
        cell: where the brick goes.
        up: True for a place-up from below (handover and support-top), False for a place-down.
        presses: grips to choose from, the preferred one first; the planner may choose any where
            there is none. Each goes with ``support``.
        supports: supports to choose from, the preferred one first; none where no support is
            needed. Each goes with ``press``.
        attack: +1 or -1, sign of the sideways offset of the place approach.
        stock: name of the prescribed stock brick, None when the planner may choose.
        temporary: True for a brick that is removed later: it is not part of the finished structure.
    """

    brick: BrickType
    cell: Cell
    up: bool = False
    presses: tuple[Press, ...] = ()
    supports: tuple[Support, ...] = ()
    attack: int = 1
    stock: str | None = None
    temporary: bool = False

    @property
    def press(self) -> Press | None:
        """The preferred grip, None where the planner may choose any."""
        return self.presses[0] if self.presses else None

    @property
    def support(self) -> Support | None:
        """The preferred support, None where no support is needed."""
        return self.supports[0] if self.supports else None

    @property
    def words(self) -> str:
        """Description of the step, such as ``"place-down of 2x4 at [3, 4, 1] turned"``."""
        turned = " turned" if self.cell.turned else ""
        how = "place-up" if self.up else "place-down"
        return f"{how} of {self.brick.name} at {self.cell.words}{turned}"


@dataclass(frozen=True)
class LegoAssembly:
    """A LEGO structure, its stock, and its steps in order.

    Attributes:
        plate: where the structure is built.
        stock: bricks that are there at the start.
        steps: assembly sequence.
        twist: twist angles by skill ("pick", "place-down", "place-up", "handover") [rad].
        storage: plate of the stock, None when it stands on ``plate``. Scaffolding is part of
            the structure and always stands on ``plate``.
    """

    plate: Plate
    stock: tuple[StockBrick, ...]
    steps: tuple[LegoStep, ...]
    twist: Mapping[str, float]
    storage: Plate | None = None

    @property
    def structure(self) -> tuple[PlacedBrick, ...]:
        """The bricks that the steps place, named ``"step 1"`` and so on."""
        return tuple(
            PlacedBrick(f"step {k}", step.brick, step.cell)
            for k, step in enumerate(self.steps, start=1)
        )

    @property
    def scaffold(self) -> tuple[PlacedBrick, ...]:
        """The stock bricks that are never moved."""
        return tuple(item for item in self.stock if item.fixed)

    def plate_of(self, item: StockBrick) -> Plate:
        """Return the plate that a stock brick stands on."""
        return self.plate if item.fixed or self.storage is None else self.storage
