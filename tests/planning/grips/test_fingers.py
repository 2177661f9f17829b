"""Fingers: pads bear what friction bears, by sums over the area of contact, and meet what stands beside a part as they close."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Box, Cylinder, Element, box_shape, shape_of
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.grips.fingers import (
    _middle_and_radius,
    finger_obstacles,
    firm_grips,
    load_on_pads,
    swept_fingers,
)
from planning.grips.grip import Grip
from planning.grips.pads import pads_at
from planning.handling.skill_contacts import grip_contact
from planning.kinematics.kinematics import frame_pose
from planning.parts.part_skills import held_pose
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.statics.equilibrium import STANDARD_GRAVITY
from planning.steps.skill import Obstruction
from planning.transforms import (
    Array,
    Transform,
    from_rpy,
    identity,
    inverse,
    rotation,
    translation,
)
from tests.planning.grips.test_pads import DOWN, grip_from_above, hand

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
    assert load.moment_arm == pytest.approx(0.1)
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
        assert pad.travel is not None
        faces = ConvexHull(room.body.vertices).equations
        for share in (0.0, 0.37, 1.0):
            at = own.body.vertices + share * sign * pad.travel * tip[:3, 1]
            assert np.max(at @ faces[:, :3].T + faces[:, 3]) < 1e-9
        size = np.prod(own.body.high - own.body.low)
        thick = np.ptp(own.body.vertices @ tip[:3, 1])
        volume = size * (1.0 + pad.travel / thick)
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
    scene = cell, world, grip_contact("arm", "peg")
    return finger_obstacles(placed, "tool", (peg, grip), model.home, scene)


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
    scene = cell, state, grip_contact("arm", "peg")
    found = finger_obstacles(placed, "tool", (peg, DOWN), model.home, scene)
    assert found is not None
    assert found.by == "slat"
