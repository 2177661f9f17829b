"""Plates in sequences: where the tool's wall would stand on knobs there is no room for it."""

from __future__ import annotations

import pytest

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import BRICKS, Cell, PlacedBrick, Press
from planning.lego.bricks.grid import occupied_places
from planning.lego.bricks.grips import lever_cell, presses
from planning.lego.sequencing.sequencing import sequence_structure

POST = PlacedBrick("post", BRICKS["2x8"], Cell(20, 20, 1))


def plate(x: int, y: int, z: int, raised: int = 0) -> PlacedBrick:
    return PlacedBrick("top", BRICKS["2x4-plate"], Cell(x, y, z, raised=raised))


def test_a_plate_goes_on_a_brick_by_the_edges_that_are_flush() -> None:
    """A 2x4 plate on one end of a 2x8 brick: three edges are flush, beside the fourth are knobs."""
    found = sequence_structure([POST, plate(20, 20, 2)])
    step = found.steps[-1]
    assert step.brick == BRICKS["2x4-plate"]
    assert {p.side for p in step.presses} == {1, 3, 4}
    under = {place[:2] for place in occupied_places(POST.cell, POST.brick)}
    for press in presses(step.brick):
        beside = lever_cell(step.cell, step.brick, press)
        on = {p[:2] for p in occupied_places(beside, BRICKS["1x2"])} & under
        assert (press in step.presses) == (not on)


def test_a_plate_on_the_base_plate_has_no_room_for_the_tool() -> None:
    with pytest.raises(InfeasibleStepError, match="'the plate' is in its way"):
        sequence_structure([plate(20, 20, 1)])


def test_plates_between_layers_carry_bricks() -> None:
    brick = PlacedBrick("lid", BRICKS["2x4"], Cell(20, 20, 2, raised=2))
    plates = [
        PlacedBrick(f"p{k}", BRICKS["2x4-plate"], Cell(20, 20, 2, raised=k))
        for k in range(2)
    ]
    found = sequence_structure([brick, POST, *plates[::-1]])
    assert [s.name for s in found.sequence] == ["post", "p0", "p1", "lid"]
    assert "at [20, 20, 2] raised 2" in found.steps[-1].words


@pytest.mark.parametrize(
    ("press", "turned", "at"),
    [
        (Press(1, 0), False, (4, 5)),
        (Press(4, 2), False, (7, 7)),
        (Press(2, 0), False, (5, 9)),
        (Press(3, 0), False, (5, 4)),
        (Press(1, 0), True, (7, 4)),
        (Press(4, 0), True, (7, 7)),
        (Press(2, 0), True, (4, 5)),
        (Press(3, 0), True, (9, 5)),
    ],
)
def test_the_wall_stands_beside_the_pressed_edge(
    press: Press, turned: bool, at: tuple[int, int]
) -> None:
    """A 2x4 at [5, 5]: the least stud of the cell beside each of its edges."""
    found = lever_cell(Cell(5, 5, 3, turned, 1), BRICKS["2x4-plate"], press)
    assert (found.x, found.y) == at
    assert (found.z, found.raised) == (3, 1)
    assert found.turned == ((press.side in (2, 3)) != turned)
