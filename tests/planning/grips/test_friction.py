"""Pads bear what friction bears: against sums over the area of contact, and arithmetic of levers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Box, Cylinder, Element, box_shape, shape_of
from planning.cell.workcell import CellObject, PlacedRobot
from planning.grips.fingers import _middle_and_radius, firm_grips, load_on_pads
from planning.grips.grip import Grip
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.statics.equilibrium import STANDARD_GRAVITY
from planning.transforms import (
    Array,
    Transform,
    from_rpy,
    identity,
    rotation,
    translation,
)

PAD = 0.02
"""Width of the fingers, across [m]."""

FORCE, FRICTION, MASS = 40.0, 0.5, 1.0


def arm(force: float | None = FORCE) -> PlacedRobot:
    shapes = [Element(Box((0.05, 0.1, 0.1)), translation(0, 0, 0.05))]
    shapes += [
        Element(Box((PAD, 0.01, 0.05)), translation(0, y, 0.125))
        for y in (-0.035, 0.035)
    ]
    tool = Tool(name="hand", shapes=tuple(shapes), tcp=translation(0, 0, 0.15))
    model = robot_model("ur5e", None, Fitting(tool=tool))
    model = replace(model, grip=ToolGrip((0.0, 0.06), "hand", force))
    return PlacedRobot("arm", model, identity(), model.home)


BAR = CellObject(
    "bar", "bar", box_shape("bar", (0.3, 0.03, 0.04)), identity(), mass=MASS
)


def at(along: float) -> Grip:
    """Return a grip from above, in the middle of the bar's height, so far from its middle [m]."""
    return Grip(translation(along, 0.0, 0.0) @ rotation("x", np.pi), "grip")


def slip(points: Array, centre: Array) -> tuple[float, float]:
    """Return force and torque about the middle of friction on points that turn about a centre.

    Each point bears the same, against the way in which it slips; per unit of friction force.
    """
    away = points - centre
    way = np.stack([-away[:, 1], away[:, 0]], axis=1)
    way /= np.linalg.norm(way, axis=1)[:, None]
    force = way.mean(axis=0)
    torque = (points[:, 0] * way[:, 1] - points[:, 1] * way[:, 0]).mean()
    return float(np.linalg.norm(force)), float(torque)


def test_both_limits_are_sums_over_the_area_of_contact() -> None:
    load = load_on_pads(arm(), BAR, at(0.1), "tool", identity(), FRICTION)
    assert load is not None
    assert load.force == pytest.approx(MASS * STANDARD_GRAVITY)
    assert load.torque == pytest.approx(MASS * STANDARD_GRAVITY * 0.1)
    assert load.lever == pytest.approx(0.1)
    # Fingers reach to the middle of the bar: they touch 20 by 20 mm.
    rng = np.random.default_rng(1)
    points = rng.uniform(-0.5 * PAD, 0.5 * PAD, (200_000, 2))
    _, torque = slip(points, np.zeros(2))
    assert load.most_torque == pytest.approx(2.0 * FRICTION * FORCE * torque, rel=0.01)
    assert load.most_force == pytest.approx(2.0 * FRICTION * FORCE)
    for centre in (0.001, 0.003, 0.006, 0.01, 0.02, 0.05):
        pull, turn = slip(points, np.array([centre, 0.0]))
        assert np.hypot(pull, turn / torque) == pytest.approx(1.0, abs=0.1)


def test_a_part_is_held_up_to_the_lever_that_friction_bears() -> None:
    poses = [identity(), from_rpy((0, 0, 0), (0, 0, 1.0))]
    least = load_on_pads(arm(), BAR, at(0.0), "tool", poses[0], FRICTION)
    assert least is not None
    assert least.share == pytest.approx(
        MASS * STANDARD_GRAVITY / (2.0 * FRICTION * FORCE)
    )
    free = least.most_torque * np.sqrt(1.0 - least.share**2) / (MASS * STANDARD_GRAVITY)
    grips = {
        k: at(x) for k, x in enumerate((0.0, 0.98 * free, -0.98 * free, 1.02 * free))
    }
    firm = firm_grips(arm(), BAR, grips, "tool", poses, FRICTION)
    assert list(firm) == [0, 1, 2]
    far = {k: grips[k] for k in (3,)}
    assert (
        firm_grips(arm(), BAR, far, "tool", poses, FRICTION) == far
    )  # there is no better
    assert firm_grips(arm(None), BAR, grips, "tool", poses, FRICTION) == grips


@pytest.mark.parametrize(
    ("turned", "torque"),
    [((0.0, 0.0, 0.7), 0.1), ((0.0, 0.5, 0.0), 0.1 * np.cos(0.5) + 0.01 * np.sin(0.5)), ((0.0, np.pi / 2, 0.0), 0.01)],
)  # fmt: skip
def test_gravity_turns_a_part_about_the_axis_of_the_pads_alone(
    turned: tuple[float, float, float], torque: float
) -> None:
    """The fingers touch the upper half of the bar: the middle of that is 10 mm above its own."""
    pose: Transform = from_rpy((0, 0, 0), turned)
    load = load_on_pads(arm(), BAR, at(0.1), "tool", pose, FRICTION)
    assert load is not None
    assert load.torque == pytest.approx(MASS * STANDARD_GRAVITY * torque, abs=1e-6)


def test_a_round_peg_is_touched_along_lines() -> None:
    """Which bear less torque than faces do: a quarter of their length."""
    peg = CellObject(
        "peg", "peg", shape_of("peg", [Element(Cylinder(0.01, 0.04), identity())]), identity(), mass=0.1
    )  # fmt: skip
    load = load_on_pads(arm(), peg, at(0.0), "tool", identity(), FRICTION)
    assert load is not None
    lines = 2.0 * FRICTION * FORCE * 0.25 * 0.02
    assert lines <= load.most_torque < 1.2 * lines


@pytest.mark.parametrize("end", [(1, 0), (0, 1), (1, 1), (-1, 1), (-3, 4)])
def test_a_line_bears_as_much_torque_in_whatever_direction_it_lies(
    end: tuple[int, int],
) -> None:
    """Its points are a quarter of its length from its middle in the mean."""
    middle, radius = _middle_and_radius(np.outer([0.25, 0.0, 1.0], end))
    assert middle == pytest.approx(0.5 * np.array(end))
    assert radius == pytest.approx(0.25 * np.hypot(*end))
