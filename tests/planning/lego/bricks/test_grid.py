"""Cells, poses and contact on the stud grid, grips of bricks; bricks and plate as things of the cell."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    LegoAssembly,
    LegoStep,
    PlacedBrick,
    Plate,
    Press,
    StockBrick,
)
from planning.lego.bricks.brick_grips import (
    check_press,
    grip_pose,
    legal_offsets,
    legal_presses,
    press_cell,
    side_studs,
)
from planning.lego.bricks.brick_tiles import BrickTiles
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.brick_world import plate_fixture, stock_objects
from planning.lego.bricks.grid import (
    box_from_top,
    box_pose,
    box_size,
    bricks_above,
    plate_corner,
    top_pose,
)
from planning.lego.skills.targets import BrickGrip
from planning.transforms import (
    Array,
    Transform,
    from_rpy,
    inverse,
    rotation,
    translation,
)
from tests.planning.lego.structures import CELLS, TOPS, grips

near_cells = st.builds(
    Cell,
    st.integers(0, 6),
    st.integers(0, 6),
    st.integers(1, 3),
    st.booleans(),
    st.integers(0, 2),
)


def placed(cells: st.SearchStrategy[Cell]) -> st.SearchStrategy[PlacedBrick]:
    """Return bricks of any type in some cells."""
    kinds = st.sampled_from(sorted(BRICKS)).map(BRICKS.__getitem__)
    return st.builds(PlacedBrick, st.just(""), kinds, cells)


plates = st.builds(Plate, TOPS)


def cell_at(plate: Plate, top: Transform, brick: BrickType) -> Cell:
    """Return the cell of a brick whose top face has a pose on the grid."""
    local = inverse(plate_corner(plate)) @ top
    turned = round(np.arctan2(local[1, 0], local[0, 0]) / (np.pi / 2)) % 2 == 1
    nx, ny = brick.studs[::-1] if turned else brick.studs
    x, y, z = local[:3, 3] / (STUD_PITCH, STUD_PITCH, LAYER_HEIGHT / 3)
    level = round(z) - brick.height
    return Cell.at_level(round(x - nx / 2), round(y - ny / 2), level, turned=turned)


def test_a_brick_at_the_corner_stands_on_the_corner() -> None:
    plate = Plate(np.eye(4), (10, 20))
    pose = top_pose(plate, PlacedBrick("", BRICKS["2x4"], Cell(0, 0, 1)))
    np.testing.assert_allclose(pose[:3, 3], [-0.04 + 0.008, -0.08 + 0.016, 0.0096])
    turned = top_pose(plate, PlacedBrick("", BRICKS["2x4"], Cell(0, 0, 1, True)))
    np.testing.assert_allclose(turned[:3, 3], [-0.04 + 0.016, -0.08 + 0.008, 0.0096])
    np.testing.assert_allclose(turned[:3, 0], [0, 1, 0], atol=1e-15)


@given(plates, placed(CELLS))
def test_from_cell_to_pose_and_back_also_by_half_a_turn(
    plate: Plate, item: PlacedBrick
) -> None:
    top = top_pose(plate, item)
    for pose in (top, top @ rotation("z", np.pi)):
        assert cell_at(plate, pose, item.brick) == item.cell


@given(plates, placed(CELLS))
def test_the_box_hangs_half_its_height_below_the_top(
    plate: Plate, item: PlacedBrick
) -> None:
    top, box, height = top_pose(plate, item), box_pose(plate, item), item.brick.height
    np.testing.assert_allclose(
        top[:3, 3] - box[:3, 3], [0, 0, height * LAYER_HEIGHT / 6], atol=1e-12
    )
    np.testing.assert_allclose(box_from_top(top, item.brick), box, atol=1e-12)


def _bounds(item: PlacedBrick) -> tuple[Array, Array]:
    """Return the box's least and greatest corner from its pose and size."""
    pose = box_pose(Plate(np.eye(4)), item)
    half = np.abs(pose[:3, :3]) @ box_size(item.brick) / 2
    return pose[:3, 3] - half, pose[:3, 3] + half


@given(placed(near_cells), placed(near_cells))
def test_contact_on_the_grid_is_contact_of_the_boxes(
    a: PlacedBrick, b: PlacedBrick
) -> None:
    low_a, high_a = _bounds(a)
    low_b, high_b = _bounds(b)
    gap = np.maximum(low_b - high_a, low_a - high_b)
    overlap = bool(np.all(gap < -1e-6))
    assert bool(a.places & b.places) == overlap
    if overlap:  # two bricks in one place have no neighbours to speak of
        return
    over = bool(np.all(gap[:2] < -1e-6))
    above = over and abs(low_b[2] - high_a[2]) < 1e-6
    assert bool(bricks_above(a, {"other": b})) == above


def test_footprints_turn_with_the_brick() -> None:
    for turned, size in ((False, (2, 6)), (True, (6, 2))):
        item = PlacedBrick("", BRICKS["2x6"], Cell(0, 0, 1, turned))
        assert item.span.size == size


numbered = st.tuples(
    st.integers(0, 3),
    st.builds(
        Cell, st.integers(-9, 30), st.integers(-9, 30), st.integers(1, 4), st.booleans()
    ),
    st.sampled_from(["1x1", "1x8", "2x4"]),
)


@given(st.lists(numbered, max_size=40), numbered, st.integers(0, 4))
def test_tiles_find_all_neighbours_in_their_order(
    items: list[tuple[int, Cell, str]], one: tuple[int, Cell, str], before: int
) -> None:
    every = [
        (number, PlacedBrick(f"b{k}", BRICKS[kind], cell))
        for k, (number, cell, kind) in enumerate(items)
    ]
    span = PlacedBrick("", BRICKS[one[2]], one[1]).span
    near = [
        (item.name, item)
        for number, item in sorted(every, key=lambda e: (e[0], e[1].name))
        if number < before and span.near(item.span, levels=1)
    ]
    assert list(BrickTiles(every).near(span, before).items()) == near


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


OPPOSITE = {1: 4, 4: 1, 2: 3, 3: 2}


@given(grips())
def test_the_tool_stands_on_the_edge_and_looks_down(grip: BrickGrip) -> None:
    side, local = grip.press.side, np.linalg.inv(grip.top) @ grip.tool
    np.testing.assert_allclose(local[:3, 2], [0, 0, -1], atol=1e-12)
    assert local[2, 3] == pytest.approx(0.0, abs=1e-12)
    outward = {1: [-1, 0, 0], 4: [1, 0, 0], 2: [0, 1, 0], 3: [0, -1, 0]}[side]
    np.testing.assert_allclose(local[:3, 0], -np.array(outward), atol=1e-12)
    half = np.array([*grip.brick.studs, 0]) * STUD_PITCH / 2
    assert np.dot(local[:3, 3], outward) == pytest.approx(np.abs(outward) @ half)


@given(grips())
def test_half_a_turn_swaps_opposite_sides(grip: BrickGrip) -> None:
    side, offset = grip.press.side, grip.press.offset
    mirrored = Press(OPPOSITE[side], side_studs(grip.brick, side) - 2 - offset)
    turned = replace(grip, top=grip.top @ rotation("z", np.pi), press=mirrored)
    np.testing.assert_allclose(turned.tool, grip.tool, atol=1e-12)


@given(grips())
def test_the_next_offset_is_one_stud_along_the_edge(grip: BrickGrip) -> None:
    side, offset = grip.press.side, grip.press.offset + 1
    if offset in legal_offsets(grip.brick, side):
        x, y = {1: (0, 1), 4: (0, 1), 2: (1, 0), 3: (1, 0)}[side]
        shifted = grip.top @ translation(x * STUD_PITCH, y * STUD_PITCH, 0.0)
        moved = replace(grip, press=Press(side, offset))
        one = replace(grip, top=shifted)
        np.testing.assert_allclose(one.tool, moved.tool, atol=1e-12)


def contact_press(contact: Cell, press: Press) -> Press:
    """Return the grip on a 1 x 2 contact cell that a press of a brick corresponds to.

    The tool stands on a long edge of the cell: the one that faces out of the pressed brick.

    Args:
        contact: the 1 x 2 cell, its ``turned`` being the press orientation.
        press: the press of the brick itself.
    """
    low = (1, 3) if contact.turned else (1, 2)
    return Press(1 if press.side in low else 4, 0)


@given(CELLS, grips(), st.booleans())
def test_the_contact_cell_is_where_the_tool_presses(
    cell: Cell, grip: BrickGrip, up: bool
) -> None:
    brick, press, plate = grip.brick, grip.press, Plate(np.eye(4))
    item = PlacedBrick("", brick, cell)
    contact = press_cell(item, press, up=up)
    assert contact.level == cell.level + (-3 if up else brick.height)
    level = replace(contact, z=cell.z, raised=cell.raised)
    pair = PlacedBrick("", replace(BRICKS["1x2"], height=brick.height), level)
    pressed = contact_press(contact, press)
    np.testing.assert_allclose(
        grip_pose(top_pose(plate, pair), pair.brick, pressed),
        grip_pose(top_pose(plate, item), brick, press),
        atol=1e-12,
    )


@given(grips())
def test_the_side_studs_hold_level_from_outside(grip: BrickGrip) -> None:
    down, level = grip.tool, grip.alt
    # The tool's side studs are a brick's height below the frame.
    bottom = down[:3, 3] + down[:3, 2] * grip.brick.height * LAYER_HEIGHT / 3
    below = level[:3, 3] - grip.top[:3, 2] * LAYER_HEIGHT
    np.testing.assert_allclose(below, bottom, atol=1e-12)
    np.testing.assert_allclose(level[:3, 2], down[:3, 0], atol=1e-12)
    np.testing.assert_allclose(level[:3, 0], [0, 0, -1], atol=1e-12)


def test_the_number_of_grips() -> None:
    assert len(legal_presses(BRICKS["2x4"])) == 2 * 3 + 2 * 1
    assert len(legal_presses(BrickType("8x8", (8, 8), 0.01))) == 28
    assert len(legal_presses(BRICKS["1x8"])) == 2 * 7
    # A single stud can only be gripped half beside it.
    assert len(legal_presses(BRICKS["1x1"])) == 4


@pytest.mark.parametrize("press", [Press(1, 3), Press(1, -1), Press(2, 1), Press(5, 0)])
def test_a_grip_beside_the_brick_is_refused(press: Press) -> None:
    with pytest.raises(ScenarioError) as caught:
        check_press(BRICKS["2x4"], press)
    assert caught.value.choices
