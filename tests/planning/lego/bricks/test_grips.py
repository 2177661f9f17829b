"""Symmetries of the grips, and the contact cell against the grip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICKS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    PlacedBrick,
    Plate,
    Press,
)
from planning.lego.bricks.grid import (
    check_press,
    grip_pose,
    offsets,
    press_cell,
    presses,
    side_contact_pose,
    side_studs,
    top_pose,
)
from planning.transforms import Transform, rotation, translation
from tests.planning.lego.structures import CELLS, TOPS

OPPOSITE = {1: 4, 4: 1, 2: 3, 3: 2}


@st.composite
def gripped(draw: st.DrawFn) -> tuple[BrickType, Press]:
    wide = [brick for brick in BRICKS.values() if brick.studs != (1, 1)]
    brick = draw(st.sampled_from(wide))
    return brick, draw(st.sampled_from(presses(brick)))


@given(TOPS, gripped())
def test_the_tool_stands_on_the_edge_and_looks_down(
    top: Transform, grip: tuple[BrickType, Press]
) -> None:
    brick, press = grip
    local = np.linalg.inv(top) @ grip_pose(top, brick, press)
    np.testing.assert_allclose(local[:3, 2], [0, 0, -1], atol=1e-12)
    assert local[2, 3] == pytest.approx(0.0, abs=1e-12)
    outward = {1: [-1, 0, 0], 4: [1, 0, 0], 2: [0, 1, 0], 3: [0, -1, 0]}[press.side]
    np.testing.assert_allclose(local[:3, 0], -np.array(outward), atol=1e-12)
    half = np.array([*brick.studs, 0]) * STUD_PITCH / 2
    assert np.dot(local[:3, 3], outward) == pytest.approx(np.abs(outward) @ half)


@given(TOPS, gripped())
def test_half_a_turn_swaps_opposite_sides(
    top: Transform, grip: tuple[BrickType, Press]
) -> None:
    brick, press = grip
    mirrored = Press(
        OPPOSITE[press.side], side_studs(brick, press.side) - 2 - press.offset
    )
    np.testing.assert_allclose(
        grip_pose(top @ rotation("z", np.pi), brick, mirrored),
        grip_pose(top, brick, press),
        atol=1e-12,
    )


@given(TOPS, gripped())
def test_the_next_offset_is_one_stud_along_the_edge(
    top: Transform, grip: tuple[BrickType, Press]
) -> None:
    brick, press = grip
    moved = Press(press.side, press.offset + 1)
    if moved.offset in offsets(brick, press.side):
        along = {1: (0, 1), 4: (0, 1), 2: (1, 0), 3: (1, 0)}[press.side]
        shift = translation(along[0] * STUD_PITCH, along[1] * STUD_PITCH, 0.0)
        np.testing.assert_allclose(
            grip_pose(top @ shift, brick, press),
            grip_pose(top, brick, moved),
            atol=1e-12,
        )


def contact_press(contact: Cell, press: Press) -> Press:
    """Return the grip on a 1 x 2 contact cell that a press of a brick corresponds to.

    The tool stands on a long edge of the cell: the one that faces out of the pressed brick.

    Args:
        contact: the 1 x 2 cell, its ``turned`` being the press orientation.
        press: the press of the brick itself.
    """
    low = (1, 3) if contact.turned else (1, 2)
    return Press(1 if press.side in low else 4, 0)


@given(CELLS, gripped(), st.booleans())
def test_the_contact_cell_is_where_the_tool_presses(
    cell: Cell, grip: tuple[BrickType, Press], up: bool
) -> None:
    brick, press = grip
    plate, item = Plate(np.eye(4)), PlacedBrick("", brick, cell)
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


@given(TOPS, gripped())
def test_the_side_studs_hold_level_from_outside(
    top: Transform, grip: tuple[BrickType, Press]
) -> None:
    brick, press = grip
    down, level = grip_pose(top, brick, press), side_contact_pose(top, brick, press)
    # The tool's side studs are a brick's height below the frame.
    bottom = down[:3, 3] + down[:3, 2] * brick.height * LAYER_HEIGHT / 3
    below = level[:3, 3] - top[:3, 2] * LAYER_HEIGHT
    np.testing.assert_allclose(below, bottom, atol=1e-12)
    np.testing.assert_allclose(level[:3, 2], down[:3, 0], atol=1e-12)
    np.testing.assert_allclose(level[:3, 0], [0, 0, -1], atol=1e-12)


def test_the_number_of_grips() -> None:
    assert len(presses(BRICKS["2x4"])) == 2 * 3 + 2 * 1
    assert len(presses(BrickType("8x8", (8, 8), 0.01))) == 28
    assert len(presses(BRICKS["1x8"])) == 2 * 7
    # A single stud can only be gripped half beside it.
    assert len(presses(BRICKS["1x1"])) == 4


@pytest.mark.parametrize("press", [Press(1, 3), Press(1, -1), Press(2, 1), Press(5, 0)])
def test_a_grip_beside_the_brick_is_refused(press: Press) -> None:
    with pytest.raises(ScenarioError) as caught:
        check_press(BRICKS["2x4"], press)
    assert caught.value.choices
