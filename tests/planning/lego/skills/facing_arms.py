"""Two GP4 that face each other across a plate, with the stock of an assembly on it."""

from __future__ import annotations

import numpy as np

from planning.cell.workcell import Clearances, PlacedRobot, Workcell
from planning.lego.bricks.assembly import LegoAssembly
from planning.lego.bricks.brick_world import plate_fixture, stock_objects
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
