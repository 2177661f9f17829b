"""What stands between an open finger and the part is met by the finger as it closes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.grips.fingers import in_the_way_of_fingers, swept_fingers
from planning.grips.pads import pads_at
from planning.kinematics.kinematics import frame_pose
from planning.parts.part_skills import held_pose
from planning.robots.registry import robot_model
from planning.steps.skill import Obstruction, gripped
from planning.transforms import Transform, inverse, translation
from tests.planning.grips.test_pads import DOWN, grip_from_above, hand

PEG = box_shape("peg", (0.01, 0.02, 0.03))


@settings(max_examples=20, deadline=None)
@given(st.floats(0.004, 0.055), st.floats(0.0, 0.01), st.floats(-0.0015, 0.0015))
def test_fingers_sweep_all_places_between_open_and_closed(
    width: float, depth: float, off: float
) -> None:
    model, tip = hand(off=off)
    part = box_shape("part", (0.02, width, 0.03))
    grip = grip_from_above(depth)
    pads = pads_at(model, tip, part, grip)
    swept = swept_fingers(model, tip, part, grip)
    assert pads is not None
    assert swept is not None
    moved = 0
    for own, room in zip(model.parts, swept.parts, strict=True):
        if own.body is room.body:
            continue
        moved += 1
        y = ((own.body.vertices - tip[:3, 3]) @ tip[:3, :3])[:, 1]
        pad, sign = pads.sides[0 if y.min() >= 0 else 1], -1.0 if y.min() >= 0 else 1.0
        assert pad.way is not None
        faces = ConvexHull(room.body.vertices).equations
        for share in (0.0, 0.37, 1.0):
            at = own.body.vertices + share * sign * pad.way * tip[:3, 1]
            assert np.max(at @ faces[:, :3].T + faces[:, 3]) < 1e-9
        size = np.prod(own.body.high - own.body.low)
        thick = np.ptp(own.body.vertices @ tip[:3, 1])
        volume = size * (1.0 + pad.way / thick)
        assert ConvexHull(room.body.vertices).volume == pytest.approx(volume)
    assert moved == 2


def met(beside: CellObject | None, robot: str = "panda") -> Obstruction | None:
    """Return what fingers meet that close on a peg, with something beside it."""
    model = robot_model(robot)
    placed = PlacedRobot("arm", model, np.eye(4), model.home)
    grip: Transform = DOWN
    tool = frame_pose(placed, model.home, "tool")
    peg = CellObject("peg", "peg", PEG, tool @ inverse(grip))
    state = {"peg": Attachment(None, peg.start)}
    objects = [peg]
    if beside is not None:
        at = peg.start @ beside.start
        objects.append(CellObject(beside.name, "beside", beside.shape, at))
        state[beside.name] = Attachment(None, at)
    cell = Workcell((placed,), (), tuple(objects))
    world = WorldState({"arm": model.home}, state)
    scene = cell, world, gripped("arm", "peg")
    return in_the_way_of_fingers(placed, "tool", (peg, grip), model.home, scene)


def slat(y: float, thick: float = 0.004) -> CellObject:
    shape = box_shape("slat", (0.03, thick, 0.03))
    return CellObject("slat", "slat", shape, translation(0.0, y, 0.0))


def test_nothing_is_in_the_way_of_a_peg_that_stands_alone() -> None:
    assert met(None) is None


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("away", "hit"), [(0.013, True), (0.02, True), (0.06, False)])
def test_a_slat_between_finger_and_part_is_named(
    side: float, away: float, *, hit: bool
) -> None:
    found = met(slat(side * away))
    assert (found is not None) == hit
    if found is not None:
        assert found.by == "slat"
        assert "as the fingers close on peg, or open from it" in found.words


def test_what_is_flush_with_the_part_is_not_in_the_way() -> None:
    """A finger that is wider than the part touches its neighbour when it touches the part."""
    flush = CellObject(
        "slat",
        "slat",
        box_shape("slat", (0.02, 0.02, 0.03)),
        translation(0.0151, 0.0, 0.0),
    )
    proud = CellObject(
        "slat",
        "slat",
        box_shape("slat", (0.02, 0.026, 0.03)),
        translation(0.0151, 0.0, 0.0),
    )
    assert met(flush) is None
    assert met(proud) is not None


def test_in_hand_the_part_goes_with_the_robot() -> None:
    """Where the part is in its place, still held, the same slat is in the way."""
    model = robot_model("panda")
    placed = PlacedRobot("arm", model, np.eye(4), model.home)
    tool = frame_pose(placed, model.home, "tool")
    peg = CellObject("peg", "peg", PEG, np.eye(4))
    beside = slat(0.02)
    at = tool @ inverse(DOWN) @ beside.start
    held = Attachment("arm", held_pose(placed, "tool", DOWN))
    state = WorldState({"arm": model.home}, {"peg": held, "slat": Attachment(None, at)})
    cell = Workcell((placed,), (), (peg, CellObject("slat", "slat", beside.shape, at)))
    scene = cell, state, gripped("arm", "peg")
    found = in_the_way_of_fingers(placed, "tool", (peg, DOWN), model.home, scene)
    assert found is not None
    assert found.by == "slat"
