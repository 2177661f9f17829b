"""A small case with everything in it: two GP4 on scaffolding that leans out over nothing.

Layers 1 to 8 are fixed. Three bricks go on: two held from below, by the left and then by the
right robot, and one pushed up from below under the edge of the second.
"""

from functools import cache

import numpy as np

from planning.cell.workcell import Clearances, PlacedRobot, Workcell
from planning.lego.bricks.assembly import (
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    Press,
    StockBrick,
    Support,
)
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.brick_world import plate_fixture, stock_objects
from planning.lego.skills.candidates import LegoCandidates, find_candidates
from planning.lego.skills.targets import DEFAULT_TWIST
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, translation


def facing_arms(
    assembly: LegoAssembly,
    clearances: Clearances = Clearances(),  # noqa: B008 - frozen
) -> Workcell:
    """Return the cell."""
    gp4 = robot_model("gp4")
    right = from_rpy((0.88, 0, 0.9246), (0, 0, np.pi))
    robots = (
        PlacedRobot("left", gp4, translation(0, 0, 0.9246), gp4.home),
        PlacedRobot("right", gp4, right, gp4.home),
    )
    plate = plate_fixture(assembly.plate)
    return Workcell(robots, (plate,), stock_objects(assembly), clearances)


TOWER = (
    StockBrick("f1", BRICKS["2x6"], Cell(23, 14, 1), fixed=True),
    *(
        StockBrick(f"f{z}", BRICKS["2x4"], Cell(23, 15, z), fixed=True)
        for z in range(2, 7)
    ),
    StockBrick("f7", BRICKS["2x4"], Cell(23, 16, 7), fixed=True),
    StockBrick("f8", BRICKS["2x4"], Cell(23, 18, 8), fixed=True),
)
STOCK = (
    StockBrick("near_left", BRICKS["2x4"], Cell(6, 30, 1)),
    StockBrick("near_right", BRICKS["2x4"], Cell(40, 30, 1)),
    StockBrick("upper", BRICKS["2x4"], Cell(40, 36, 2)),
    StockBrick("lower", BRICKS["2x4"], Cell(40, 36, 1)),
    StockBrick("small", BRICKS["2x2"], Cell(10, 34, 1)),
)
STEPS = (
    LegoStep(
        BRICKS["2x4"],
        Cell(23, 20, 9),
        presses=(Press(1, 0),),
        supports=(Support(Cell(23, 21, 7), 0),),
    ),
    LegoStep(
        BRICKS["2x4"],
        Cell(23, 22, 10),
        presses=(Press(4, 0),),
        supports=(Support(Cell(24, 23, 8), 3),),
    ),
    LegoStep(
        BRICKS["2x2"],
        Cell(23, 24, 9),
        up=True,
        presses=(Press(4, 0),),
        supports=(Support(Cell(23, 25, 11), 2, from_above=True),),
    ),
)


@cache
def found_overhang() -> LegoCandidates:
    """Return the candidates of all three steps."""
    return find_candidates(*overhang())


def overhang(
    *, stock: tuple[StockBrick, ...] = STOCK, steps: tuple[LegoStep, ...] = STEPS
) -> tuple[Workcell, LegoAssembly]:
    """Return the cell and the assembly."""
    plate = Plate(translation(0.44, 0.0, 1.1145))
    assembly = LegoAssembly(plate, TOWER + stock, steps, DEFAULT_TWIST)
    return facing_arms(assembly), assembly
