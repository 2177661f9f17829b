"""Grips of robots with different tools: each holds what it can, and is named where it cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import box_shape
from planning.cell.workcell import PlacedRobot
from planning.parts.assembly import GripRules
from planning.parts.grips import part_grips
from planning.parts.tool_grips import own_grips, tool_grips, why_no_grip
from planning.robots.registry import robot_model
from planning.transforms import identity

FINGERS = ToolGrip((0.01, 0.085), "two_finger")
CUP = ToolGrip(None, "cup")
DRIVER = ToolGrip((0.0, 0.0), "driver")
RULES = GripRules(opening=0.04, depth=0.03)


def robot(name: str, grip: ToolGrip | None) -> PlacedRobot:
    model = replace(robot_model("panda"), grip=grip)
    return PlacedRobot(name, model, identity(), model.home)


def found(size: tuple[float, ...], *grips: ToolGrip | None) -> dict[str, int]:
    """Return how many grips each robot has on a box."""
    robots = [robot(str(k), grip) for k, grip in enumerate(grips)]
    every = tool_grips(robots, box_shape("box", size), identity(), identity(), RULES)
    return {r.name: len(list(own_grips(r, every))) for r in robots}


def test_every_tool_has_its_own_grips() -> None:
    wide = found((0.2, 0.06, 0.1), None, FINGERS, CUP, DRIVER)
    assert wide["0"] == 0
    assert wide["1"] > 0
    assert wide["2"] > 0
    assert wide["3"] == 0
    huge = found((0.2, 0.1, 0.1), None, FINGERS, CUP)
    assert (huge["0"], huge["1"]) == (0, 0)
    assert huge["2"] > 0
    thin = found((0.009, 0.009, 0.009), None, FINGERS)
    assert thin["0"] > 0
    assert thin["1"] == 0


def test_grips_of_one_tool_are_those_of_the_rules_it_has() -> None:
    """Without a word of the tool the rules of the assembly hold, as they are."""
    box = box_shape("box", (0.1, 0.03, 0.04))
    for grip, rules in (
        (None, RULES),
        (FINGERS, replace(RULES, opening=0.085, least_opening=0.01)),
    ):
        ours = tool_grips([robot("r", grip)], box, identity(), identity(), RULES)
        plain = part_grips(box, identity(), identity(), rules)
        assert [g.words for g in ours] == [g.words for g in plain]
        assert all(
            np.array_equal(a.pose, b.pose) for a, b in zip(ours, plain, strict=True)
        )


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
