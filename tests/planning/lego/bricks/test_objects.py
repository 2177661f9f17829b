"""Bricks and plate as things of the cell."""

from __future__ import annotations

import numpy as np
import pytest

from planning.lego.bricks.assembly import (
    BRICKS,
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    StockBrick,
)
from planning.lego.bricks.brick_world import plate_fixture, stock_objects
from planning.transforms import from_rpy

ASSEMBLY = LegoAssembly(
    plate=Plate(from_rpy((0.4, 0.0, 1.0), (0.0, 0.0, 0.2)), (32, 48)),
    stock=(
        StockBrick("a", BRICKS["2x4"], Cell(0, 0, 1)),
        StockBrick("b", BRICKS["1x2"], Cell(0, 0, 2, True), fixed=True),
    ),
    steps=(LegoStep(BRICKS["2x4"], Cell(9, 9, 1)),),
    twist={},
)


def test_bricks_become_boxes_where_they_stand() -> None:
    a, b = stock_objects(ASSEMBLY)
    assert (a.name, a.kind, a.fixed, a.mass) == ("a", "2x4", False, 0.0022)
    assert (b.name, b.kind, b.fixed) == ("b", "1x2", True)
    np.testing.assert_allclose(a.size, [0.0158, 0.0318, 0.0096])
    # The box reaches from the plate to the underside of the brick above it.
    assert a.start[2, 3] - a.size[2] / 2 == pytest.approx(1.0)
    assert b.start[2, 3] - b.size[2] / 2 == pytest.approx(a.start[2, 3] + 0.0048)
    # The turned one is turned by a quarter against the other.
    quarter = np.linalg.inv(a.start) @ b.start
    np.testing.assert_allclose(quarter[:3, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(
        np.abs(a.shape.pieces[0].vertices), np.tile(a.size / 2, (8, 1)), atol=1e-12
    )
    assert a.colour != b.colour


def test_the_plate_lies_below_the_bricks() -> None:
    plate = plate_fixture(ASSEMBLY.plate)
    np.testing.assert_allclose(plate.size[:2], [32 * 0.008, 48 * 0.008])
    assert plate.pose[2, 3] + plate.size[2] / 2 == pytest.approx(1.0)
