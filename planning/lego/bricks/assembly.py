"""LEGO assemblies as data: plate, brick types (with the built-in ones), stock and steps, on the stud grid.

The grid of a plate counts studs from its corner: x and y from 0, layer z from 1 (on the plate).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from planning.transforms import Transform

STUD_PITCH = 0.008
"""Distance between studs [m]."""

LAYER_HEIGHT = 0.0096
"""Height of a brick without its studs [m]."""


@dataclass(frozen=True)
class BrickType:
    """A type of brick.

    Attributes:
        name: such as ``"2x4"``, or the number a published library gives it.
        studs: studs along the brick's own x and y.
        mass: [kg].
    """

    name: str
    studs: tuple[int, int]
    mass: float


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
    """Cell of a brick: the stud of its least x and y, its layer, and whether it is turned.

    Attributes:
        x, y: stud of the least corner, from 0.
        z: layer, 1 on the plate.
        turned: True when the brick is turned by +90 degrees about z.
    """

    x: int
    y: int
    z: int
    turned: bool = False


@dataclass(frozen=True)
class PlacedBrick:
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
    """Grip of the tool on a brick, by which it also presses.

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
        x, y, z: stud and layer of the cell.
        orientation: 0 = the tool comes from -x, 1 = from +y with J1 at -90 deg,
            2 = with J1 at +90 deg, 3 = from +x.
    """

    x: int
    y: int
    z: int
    orientation: int


@dataclass(frozen=True)
class StockBrick:
    """A brick that stands on a plate at the start.

    Attributes:
        name: unique in the scenario.
        brick: its type.
        cell: where it stands.
        fixed: scaffolding that no step may use.
        station: a feeding station: once a brick has been picked there, the next one of this
            type stands at this cell.
    """

    name: str
    brick: BrickType
    cell: Cell
    fixed: bool = False
    station: bool = False


@dataclass(frozen=True)
class LegoStep:
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
    """

    brick: BrickType
    cell: Cell
    up: bool = False
    presses: tuple[Press, ...] = ()
    supports: tuple[Support, ...] = ()
    attack: int = 1
    stock: str | None = None

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
        at = f"[{self.cell.x}, {self.cell.y}, {self.cell.z}]"
        return f"{how} of {self.brick.name} at {at}{turned}"


@dataclass(frozen=True)
class LegoAssembly:
    """A LEGO structure, what it is built from, and in which order.

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
        """The stock bricks that stay where they are."""
        return tuple(
            PlacedBrick(item.name, item.brick, item.cell)
            for item in self.stock
            if item.fixed
        )

    def plate_of(self, item: StockBrick) -> Plate:
        """Return the plate that a stock brick stands on."""
        return self.plate if item.fixed or self.storage is None else self.storage


_MASSES: dict[tuple[int, int], float] = {
    (1, 1): 0.00044,
    (1, 2): 0.0008,
    (1, 4): 0.0016,
    (1, 6): 0.0023,
    (1, 8): 0.00308,
    (2, 2): 0.0012,
    (2, 4): 0.0022,
    (2, 6): 0.00328,
}

BRICKS: Mapping[str, BrickType] = MappingProxyType(
    {
        f"{short}x{long}": BrickType(f"{short}x{long}", (short, long), mass)
        for (short, long), mass in _MASSES.items()
    }
)
"""Types every scenario may use, by name such as ``"2x4"``."""
