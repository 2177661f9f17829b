"""The bricks that a scenario may name, and the places on the grid that they fill."""

from __future__ import annotations

from collections.abc import Mapping

from planning.lego.bricks.assembly import BrickType, Cell
from planning.lego.bricks.grid import Stud, occupied_studs
from twin.scenario.sections.lego import (
    LegoSection,
    PressCellSection,
    StepSection,
    StockSection,
)


def brick_types(assembly: LegoSection) -> dict[str, BrickType]:
    """Return the brick types by name: the library, then those of the scenario."""
    from planning.lego.bricks.assembly import BRICKS

    own = {
        name: BrickType(name, (brick.studs[0], brick.studs[1]), brick.mass_kg)
        for name, brick in assembly.bricks.items()
    }
    return {**BRICKS, **own}


def cell_of(item: StockSection | StepSection | PressCellSection) -> Cell:
    """Return the cell of a brick of the stock or of a step."""
    x, y, z = item.at
    return Cell(x, y, z, item.turned)


def studs_of(
    item: StockSection | StepSection, types: Mapping[str, BrickType]
) -> frozenset[Stud]:
    """Return the places on the grid that a brick of the stock or of a step fills."""
    return occupied_studs(cell_of(item), types[item.brick])
