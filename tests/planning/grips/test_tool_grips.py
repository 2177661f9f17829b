"""Grips on boxes keep the rules; each tool holds what it can, and is named where it cannot."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Box, Cylinder, Element, Shape, box_shape, shape_of
from planning.cell.workcell import PlacedRobot
from planning.grips.grip import GripRules, box_grips, part_grips
from planning.grips.tool_grips import (
    beyond_part,
    own_grips,
    robot_grips,
    tool_grips,
    why_no_grip,
)
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.transforms import from_rpy, identity, translation

FINGERS = ToolGrip((0.01, 0.085), "two_finger")
CUP = ToolGrip(None, "cup")
DRIVER = ToolGrip((0.0, 0.0), "driver")
RULES = GripRules(opening=0.04, depth=0.03)


def robot(name: str, grip: ToolGrip | None) -> PlacedRobot:
    model = replace(robot_model("panda"), grip=grip)
    return PlacedRobot(name, model, identity(), model.home)


@pytest.mark.parametrize(
    ("size", "held"),
    [
        ((0.2, 0.06, 0.1), (False, True, True, False)),
        ((0.2, 0.1, 0.1), (False, False, True, False)),
        ((0.009, 0.009, 0.009), (True, False, False, False)),
    ],
)
def test_every_tool_has_its_own_grips(
    size: tuple[float, ...], held: tuple[bool, ...]
) -> None:
    tools = (None, FINGERS, CUP, DRIVER)
    robots = [robot(str(k), grip) for k, grip in enumerate(tools)]
    every = tool_grips(robots, box_shape("box", size), identity(), identity(), RULES)
    assert tuple(bool(list(own_grips(r, every))) for r in robots) == held


@pytest.mark.parametrize(
    ("grip", "rules"),
    [(None, RULES), (FINGERS, replace(RULES, opening=0.085, least_opening=0.01))],
)
def test_grips_of_one_tool_are_those_of_the_rules_it_has(
    grip: ToolGrip | None, rules: GripRules
) -> None:
    """Without a word of the tool the rules of the assembly hold, as they are."""
    box = box_shape("box", (0.1, 0.03, 0.04))
    ours = tool_grips([robot("r", grip)], box, identity(), identity(), RULES)
    plain = part_grips(box, identity(), identity(), rules)
    assert [g.words for g in ours] == [g.words for g in plain]
    for a, b in zip(ours, plain, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)


def test_a_cup_is_on_the_face_and_upright() -> None:
    rules = replace(RULES, tilts=(0.0, 0.3))
    box = box_shape("box", (0.2, 0.3, 0.1))
    grips = tool_grips([robot("r", CUP)], box, identity(), identity(), rules)
    for grip in grips:
        assert grip.pose[2, 3] == pytest.approx(0.05)
        assert np.allclose(grip.pose[:3, 2], (0, 0, -1))


@pytest.mark.parametrize(
    ("grip", "size", "words"),
    [
        (
            FINGERS,
            (0.1, 0.1, 0.1),
            "two_finger opens to 85.0 mm, and the shortest edge is 100.0",
        ),
        (FINGERS, (0.005, 0.005, 0.005), "two_finger closes to 10.0 mm"),
        (DRIVER, (0.1, 0.1, 0.1), "driver holds nothing"),
        (None, (0.1, 0.1, 0.1), "the tool opens to 40.0 mm"),
        (FINGERS, (0.05, 0.05, 0.05), "no face can be gripped both"),
    ],
)
def test_the_tool_is_named_where_it_cannot_hold(
    grip: ToolGrip | None, size: tuple[float, ...], words: str
) -> None:
    assert words in why_no_grip(robot("r", grip), box_shape("box", size), RULES)


def _with_fingers(ahead: float) -> PlacedRobot:
    """Return a robot whose fingers end so far beyond the tcp [m]."""
    fingers = (
        Element(Box((0.02, 0.01, 0.1)), translation(0, y, 0.05)) for y in (-0.04, 0.04)
    )
    hand = Tool(name="hand", shapes=tuple(fingers), tcp=translation(0, 0, 0.1 - ahead))
    model = robot_model("ur5e", None, Fitting(tool=hand))
    return PlacedRobot("arm", model, identity(), model.home)


@pytest.mark.parametrize("form", ["box", "peg"])
@pytest.mark.parametrize("thick_mm", [8, 14, 20, 45])
@pytest.mark.parametrize("ahead_mm", [0, 5, 12, 30])
def test_fingers_that_reach_beyond_a_part_are_told_with_a_depth_that_helps(
    form: str, thick_mm: int, ahead_mm: int
) -> None:
    ahead, thick = 1e-3 * ahead_mm, 1e-3 * thick_mm
    arm = _with_fingers(ahead)
    part: Shape = box_shape("part", (0.05, 0.03, thick))
    if form == "peg":
        part = shape_of("part", [Element(Cylinder(0.01, thick), identity())])
    rules = replace(RULES, depth=0.03)
    grips = robot_grips(arm, part, identity(), identity(), rules)
    assert grips
    for grip in grips:
        words = beyond_part(arm, part, grip, "tool")
        below = 0.5 * thick + grip.pose[2, 3]
        assert bool(words) == (ahead > below + 1e-9), words
        if not words:
            continue
        assert f"{ahead_mm}.0 mm beyond its tcp, the part {1e3 * below:.1f} mm" in words
        told = re.search(r"depth_m: ([0-9.]+)", words)
        if told is None:
            assert thick - ahead < 5e-3
            continue
        higher = replace(rules, depth=float(told[1]))
        for other in robot_grips(arm, part, identity(), identity(), higher):
            assert beyond_part(arm, part, other, "tool") == ""


ROD = np.array([0.3, 0.024, 0.024])
edges = st.floats(0.01, 0.4)
angles = st.floats(-np.pi, np.pi)


def test_a_flat_rod_is_gripped_from_above_both_ways_round_at_every_place() -> None:
    rules = GripRules(positions=5, end_margin=0.02)
    found = box_grips(ROD, identity(), from_rpy((0.5, 0, 0), (0, 0, 1.0)), rules)
    assert len(found) == 5 * 2
    places = [g.pose[0, 3] for g in found]
    assert sorted(set(places)) == pytest.approx([-0.13, -0.065, 0, 0.065, 0.13])
    assert places[:2] == [0.0, 0.0]
    for grip in found:
        np.testing.assert_allclose(grip.pose[:3, 2], [0, 0, -1], atol=1e-12)
        np.testing.assert_allclose(np.abs(grip.pose[:3, 1]), [0, 1, 0], atol=1e-12)


def test_a_rod_that_is_rolled_over_has_no_grip_but_one_turned_a_quarter_has() -> None:
    rules = GripRules(steepest=np.radians(60))
    over = from_rpy((0, 0, 0), (np.pi, 0, 0))
    assert box_grips(ROD, identity(), over, rules) == []
    leaning = from_rpy((0, 0, 0), (np.radians(50), 0, 0))
    assert box_grips(ROD, identity(), leaning, rules)


def test_the_tool_leans_about_the_axis_along_which_it_closes() -> None:
    tilts = (0.0, np.radians(25))
    found = box_grips(ROD, identity(), identity(), GripRules(positions=1, tilts=tilts))
    leanings = {round(float(np.degrees(np.arccos(-g.pose[2, 2])))) for g in found}
    assert leanings == {0, 25}
    for grip in found:
        assert abs(grip.pose[1, 1]) == pytest.approx(1.0)


def test_a_deep_box_is_gripped_near_the_face_that_the_tool_comes_from() -> None:
    size = np.array([0.2, 0.03, 0.12])
    for grip in box_grips(size, identity(), identity(), GripRules(depth=0.03)):
        assert grip.pose[2, 3] == pytest.approx(0.06 - 0.03)


@given(edges, edges, edges, angles, angles)
def test_every_grip_keeps_the_rules(
    x: float, y: float, z: float, yaw: float, roll: float
) -> None:
    size = np.array([x, y, z])
    start, goal = from_rpy((0, 0, 0), (0, 0, yaw)), from_rpy((0, 0, 0), (roll, 0, 0))
    rules = GripRules(tilts=(0.0, 0.4, -0.4), steepest=1.0)
    found = box_grips(size, start, goal, rules)
    for grip in found:
        rotation = grip.pose[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
        width = float(np.abs(rotation[:, 1]) @ size)
        assert width <= rules.opening + 1e-9
        assert (np.abs(grip.pose[:3, 3]) <= size / 2 + 1e-9).all()
        for pose in (start, goal):
            pointing = (pose[:3, :3] @ rotation)[:, 2]
            assert np.arccos(np.clip(-pointing[2], -1, 1)) <= rules.steepest + 1e-6
    if size.min() > rules.opening:
        assert found == []
    assert len({g.pose.round(9).tobytes() for g in found}) == len(found)
