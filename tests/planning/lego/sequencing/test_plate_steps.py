"""Plates in sequences: where the tool's wall would stand on knobs there is no room for it."""

from __future__ import annotations

import numpy as np
import pytest

from planning.errors import InfeasibleStepError
from planning.lego.bricks.assembly import BRICKS, Cell, PlacedBrick, Plate, Press
from planning.lego.bricks.grid import (
    box_pose,
    box_size,
    grip_pose,
    lever_cell,
    presses,
    top_pose,
)
from planning.lego.sequencing.sequencing import sequence_structure
from planning.lego.skills.allowed_contacts import contacts_at_rest

POST = PlacedBrick("post", BRICKS["2x8"], Cell(20, 20, 1))


def plate(x: int, y: int, z: int, raised: int = 0) -> PlacedBrick:
    return PlacedBrick("top", BRICKS["2x4-plate"], Cell(x, y, z, raised=raised))


def test_a_plate_goes_on_a_brick_by_the_edges_that_are_flush() -> None:
    """A 2x4 plate on one end of a 2x8 brick: three edges are flush, beside the fourth are knobs."""
    found = sequence_structure([POST, plate(20, 20, 2)])
    step = found.steps[-1]
    assert step.brick == BRICKS["2x4-plate"]
    assert {p.side for p in step.presses} == {1, 3, 4}
    for press in presses(step.brick):
        beside = PlacedBrick("wall", BRICKS["1x2"], lever_cell(step, press))
        assert (press in step.presses) == beside.studs.isdisjoint(POST.studs)


def test_a_plate_on_the_base_plate_has_no_room_for_the_tool() -> None:
    with pytest.raises(InfeasibleStepError, match="the plate is in its way"):
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
    item = PlacedBrick("", BRICKS["2x4-plate"], Cell(5, 5, 3, turned, 1))
    found = lever_cell(item, press)
    assert (found.x, found.y) == at
    assert (found.z, found.raised) == (3, 1)
    assert found.turned == ((press.side in (2, 3)) != turned)


OTHERS = {
    "post": POST,
    "row": PlacedBrick("row", BRICKS["2x8"], Cell(18, 20, 1)),
    "wall": PlacedBrick("wall", BRICKS["2x4"], Cell(22, 20, 2)),
    "high": PlacedBrick("high", BRICKS["2x4-plate"], Cell(18, 24, 2)),
    "far": PlacedBrick("far", BRICKS["2x4"], Cell(30, 30, 1)),
}


@pytest.mark.parametrize("press", presses(BRICKS["2x4-plate"]))
def test_the_wall_touches_what_ends_beside_it_and_no_knobs(press: Press) -> None:
    """Which bricks around a plate may touch the tool, against the box of its wall."""
    item, grid = plate(20, 20, 2), Plate(np.eye(4))
    pose = box_pose(grid, item)
    pairs = contacts_at_rest("r", item, pose, press, OTHERS, ())
    tool = {next(iter(pair - {"r/tool"})) for pair in pairs if "r/tool" in pair}
    top = top_pose(grid, item)
    grip = grip_pose(top, item.brick, press)
    corners = np.array([[-0.008, -0.008, 0.0], [0.0, 0.008, 0.0032]])
    wall = np.sort(corners @ grip[:3, :3].T + grip[:3, 3], axis=0)
    expected = {"top", "wall", "high"}  # beside the plate, as for any brick
    for name, other in OTHERS.items():
        centre = box_pose(grid, other)
        half = np.abs(centre[:3, :3]) @ box_size(other.brick) / 2
        low, high = centre[:3, 3] - half, centre[:3, 3] + half
        gap = np.maximum(low - wall[1], wall[0] - high)
        if (gap < 0.0003).all() and (gap[:2] > 0.0).any():
            expected.add(name)
    assert tool == expected
    assert "far" not in tool
