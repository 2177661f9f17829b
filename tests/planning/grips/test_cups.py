"""Cups by the shapes of tools: a face takes a cup that is no wider, of whatever form both are."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Box, Cylinder, Element, Form, box_shape, shape_of
from planning.cell.workcell import PlacedRobot
from planning.grips.cups import cup_width, describe_too_wide_cups
from planning.grips.grip import GripRules
from planning.grips.tool_grips import explain_missing_grip, robot_grips, robot_rules
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.transforms import identity, translation

HERE = identity()
RULES = GripRules(positions=1)


def sucker(*cups: tuple[Form, float, float], suction: bool = True) -> PlacedRobot:
    """Return a robot whose tool has cups 0.06 long at some places (x, y) under a plate."""
    shapes = [Element(Box((0.15, 0.15, 0.01)), translation(0, 0, 0.005))]
    shapes += [Element(form, translation(x, y, 0.04)) for form, x, y in cups]
    grip = ToolGrip(None if suction else (0.0, 0.1), "sucker")
    tool = Tool(
        name="sucker", shapes=tuple(shapes), tcp=translation(0, 0, 0.07), grip=grip
    )
    model = robot_model("ur5e", None, Fitting(tool=tool))
    return PlacedRobot("arm", model, identity(), model.home, tool="sucker")


ROUND = sucker((Cylinder(0.012, 0.06), 0.0, 0.0))


@settings(max_examples=25, deadline=None)
@given(st.floats(0.004, 0.03), st.booleans())
def test_a_face_takes_a_cup_that_is_no_wider(radius: float, disc: bool) -> None:
    """A disc, and a plate as wide as that, but for a hair's breadth."""
    form: Form = Cylinder(radius, 0.02)
    if not disc:
        form = Box((2.0 * radius, 2.0 * radius, 0.02))
    shape = shape_of("part", [Element(form, HERE)])
    found = robot_grips(ROUND, shape, HERE, HERE, RULES)
    if abs(radius / 0.012 - 1.0) > 0.02:
        assert bool(found) == (radius > 0.012)
    if radius < 0.0115:
        words = describe_too_wide_cups(shape, HERE, HERE, robot_rules(RULES, ROUND))
        assert words is not None
        assert "24.0 mm wide (by the shapes of the tool)" in words
        told = float(words.rpartition(" takes is ")[2].removesuffix(" mm"))
        assert told == pytest.approx(2e3 * radius, abs=1.1)
        assert words in explain_missing_grip(ROUND, shape, RULES, (HERE,))


def test_rules_that_say_how_wide_a_cup_is_are_followed() -> None:
    pin = shape_of("pin", [Element(Cylinder(0.008, 0.04), HERE)])
    assert not robot_grips(ROUND, pin, HERE, HERE, RULES)
    assert robot_grips(ROUND, pin, HERE, HERE, GripRules(positions=1, cup=0.005))


@pytest.mark.parametrize(
    ("size", "there"),
    [
        ((0.12, 0.05, 0.02), True),
        ((0.07, 0.05, 0.02), False),
        ((0.12, 0.018, 0.02), False),
    ],
    ids=["both on it", "both beside it", "too narrow"],
)
def test_each_of_two_cups_must_be_on_the_part(
    size: tuple[float, float, float], there: bool
) -> None:
    two = sucker((Cylinder(0.01, 0.06), 0.04, 0.0), (Cylinder(0.01, 0.06), -0.04, 0.0))
    assert bool(robot_grips(two, box_shape("b", size), HERE, HERE, RULES)) == there
    assert cup_width(robot_rules(RULES, two)) == pytest.approx(0.1, abs=1e-3)


def test_a_bar_of_rubber_lies_along_a_bar() -> None:
    """Turned by a quarter it would be beside it."""
    long = sucker((Box((0.06, 0.01, 0.06)), 0.0, 0.0))
    grips = robot_grips(long, box_shape("b", (0.1, 0.02, 0.02)), HERE, HERE, RULES)
    assert grips
    assert all(abs(grip.pose[0, 0]) == pytest.approx(1.0) for grip in grips)


def test_what_tells_no_cup_asks_for_the_usual_spot() -> None:
    fingers = sucker((Cylinder(0.03, 0.06), 0.0, 0.0), suction=False)
    assert robot_rules(RULES, fingers).lips == ()
    panda = robot_model("panda")
    plain = PlacedRobot("arm", panda, identity(), panda.home)
    rules = robot_rules(GripRules(suction=True), plain)
    assert rules.lips == ()
    assert cup_width(rules) == pytest.approx(0.02)
    assert math.isinf(robot_rules(RULES, ROUND).opening)
