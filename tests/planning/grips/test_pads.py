"""Pads come to parts as linear programs say; what they do not touch is not held, and is told by direction.

Grips on boxes keep the rules; each tool holds what it can, and is named where it cannot.
"""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog, nnls

from planning.cell.body import ConvexBody
from planning.cell.robot_model import RobotModel, ToolGrip
from planning.cell.shape import Box, Cylinder, Element, Shape, box_shape, shape_of
from planning.cell.workcell import PlacedRobot
from planning.grips.grip import GripRules, box_grips
from planning.grips.pads import BESIDE, cup_at, explain_not_held, finger_sides, pads_at
from planning.grips.shape_grips import part_grips
from planning.grips.tool_grips import (
    describe_tool_overhang,
    explain_missing_grip,
    own_grips,
    robot_grips,
    tool_grips,
)
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.transforms import (
    Array,
    Transform,
    from_rpy,
    identity,
    inverse,
    rotation,
    translation,
)

TIPS = 0.15
"""Fingers end so far in front of the mount [m]."""

DOWN = rotation("x", np.pi)


def fitted(tool: Tool, grip: ToolGrip) -> tuple[RobotModel, Transform]:
    model = replace(robot_model("ur5e", None, Fitting(tool=tool)), grip=grip)
    return model, model.frame_in_last_joint("tool")


def hand_shapes(fingers: int = 2) -> tuple[Element, ...]:
    """Return a palm with fingers 60 mm apart, 20 mm wide, 50 mm long."""
    palm = Element(Box((0.05, 0.1, 0.1)), translation(0, 0, 0.05))
    sides = [
        Element(Box((0.02, 0.01, 0.05)), translation(0, y, TIPS - 0.025))
        for y in (-0.035, 0.035)
    ]
    return (palm, *sides[:fingers])


def cup_shapes(ring: bool = False) -> tuple[Element, ...]:
    """Return what a cup of suction is drawn as: a cylinder, or four posts around its middle."""
    if not ring:
        return (Element(Cylinder(0.02, 0.1), translation(0, 0, 0.05)),)
    return tuple(
        Element(Box((0.01, 0.01, 0.1)), translation(x, y, 0.05))
        for x in (-0.02, 0.02)
        for y in (-0.02, 0.02)
    )


def hand(
    *, tcp: float = TIPS, off: float = 0.0, aside: float = 0.0, bodies: int = 2
) -> tuple[RobotModel, Transform]:
    """Return an arm with a hand of two fingers, and its tool frame."""
    at = translation(aside, off, tcp)
    tool = Tool(name="hand", shapes=hand_shapes(bodies), tcp=at)
    return fitted(tool, ToolGrip((0.0, 0.06), "hand"))


def grip_from_above(depth: float, across: float = 0.0) -> Transform:
    """Return a tool frame that points down, so deep below the origin's level [m]."""
    return translation(across, 0.0, -depth) @ DOWN


def first_touch(body: Array, piece: Array, closing: Array) -> float | None:
    """Return the way after which two hulls first have a point in common, by a linear program."""
    n, m = len(body), len(piece)
    rows = np.zeros((5, n + m + 1))
    rows[:3, :n], rows[:3, n : n + m], rows[:3, -1] = body.T, -piece.T, closing
    rows[3, :n] = rows[4, n : n + m] = 1.0
    cost = np.zeros(n + m + 1)
    cost[-1] = 1.0
    bounds = [(0.0, None)] * (n + m) + [(-1.0, 1.0)]
    found = linprog(cost, A_eq=rows, b_eq=[0, 0, 0, 1, 1], bounds=bounds)
    return None if found.x is None else float(found.x[-1])


def apart(first: Array, second: Array) -> float:
    """Return the distance of two hulls, by least squares of what is positive."""
    heavy = 1e3
    a = np.hstack([first.T, -second.T])
    sums = np.zeros((2, len(first) + len(second)))
    sums[0, : len(first)] = sums[1, len(first) :] = heavy
    target = np.array([0.0, 0.0, 0.0, heavy, heavy])
    weights, _ = nnls(np.vstack([a, sums]), target)
    one, two = weights[: len(first)], weights[len(first) :]
    return float(np.linalg.norm(one @ first / one.sum() - two @ second / two.sum()))


def moved(body: ConvexBody, pose: Transform) -> Array:
    return body.vertices @ pose[:3, :3].T + pose[:3, 3]


edge = st.floats(0.004, 0.05)
turn = st.floats(-np.pi, np.pi)
near = st.floats(-0.03, 0.03)
HAND, TIP = hand()


@settings(deadline=None)
@given(
    st.booleans(),
    st.tuples(edge, edge, edge),
    st.tuples(near, near, near),
    st.tuples(turn, turn, turn),
)
@example(False, (0.02, 0.02, 0.02), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
@example(False, (0.02, 0.02, 0.02), (0.0, 0.028, 0.0), (0.0, 0.0, 0.0))
@example(False, (0.02, 0.02, 0.02), (0.02, 0.0, 0.0), (0.0, 0.0, 0.0))
@example(
    True,
    (0.025, 0.028161616694436044, 0.03125),
    (0.023951242353440906, 0.0, -0.016774519356166313),
    (0.0, -0.78125, -1.20703125),
)
def test_pads_touch_when_a_linear_program_says_so(
    peg: bool,
    size: tuple[float, float, float],
    at: tuple[float, float, float],
    turned: tuple[float, float, float],
) -> None:
    shape = box_shape("part", size)
    if peg:
        form = Cylinder(0.5 * size[0], size[1])
        shape = shape_of("part", [Element(form, identity())])
    grip = from_rpy(at, turned)
    pads = pads_at(HAND, TIP, shape, grip)
    sides = finger_sides(HAND, TIP)
    assert pads is not None
    assert sides is not None
    for side, pad, sign in zip(sides, pads.sides, (-1.0, 1.0), strict=True):
        closing = sign * grip[:3, 1]
        bodies = [moved(body, grip @ inverse(TIP)) for body in side]
        pieces = [piece.vertices for piece in shape.pieces]
        room = min(float(((grip[:3, 3] - body) @ closing).min()) for body in bodies)
        most = max(0.0, room) + 0.01
        directions = [
            first_touch(body, piece, closing) for body in bodies for piece in pieces
        ]
        first = min((way for way in directions if way is not None), default=np.inf)
        swept = [np.vstack([body, body + most * closing]) for body in bodies]
        gap = min(apart(one, piece) for one in swept for piece in pieces)
        if pad.travel is None:
            assert gap > BESIDE - 2e-5
            assert np.linalg.norm(pad.miss) == pytest.approx(gap, abs=3e-5)
        elif gap > 2e-5:
            assert gap < BESIDE + 2e-5  # it grazes the part
        elif gap < 1e-7 and first < most - 1e-5:
            assert pad.travel == pytest.approx(first, abs=1e-5)


BLOCK = box_shape("block", (0.03, 0.03, 0.02))


@pytest.mark.parametrize(
    ("tool", "grip", "words"),
    [
        (hand(), grip_from_above(0.0), None),
        (hand(), grip_from_above(-0.0098), None),
        (hand(), grip_from_above(-0.0102), None),
        (hand(), grip_from_above(-0.011), "close 1.0 mm short of (depth) block"),
        (hand(tcp=TIPS + 0.0098), grip_from_above(0.0), None),
        (
            hand(tcp=TIPS + 0.011),
            grip_from_above(0.0),
            "close 1.0 mm short of (depth) block, and must touch it: its tcp lies 11.0 mm beyond their tips",
        ),
        (hand(tcp=TIPS + 0.053), grip_from_above(0.0), "43.0 mm short of (depth) block"),
        (hand(aside=0.0248), grip_from_above(0.0), None),
        (hand(aside=0.026), grip_from_above(0.0), "1.0 mm beside (across) block"),
        (hand(), grip_from_above(0.0, 0.035), "10.0 mm beside (across) block"),
        (hand(off=0.0019), grip_from_above(0.0), None),
        (hand(off=0.0021), grip_from_above(0.0), "2.1 mm off the middle between the fingers of hand"),
        (hand(off=-0.003), grip_from_above(0.0), "3.0 mm off the middle"),
        (hand(aside=0.03, tcp=TIPS + 0.02), grip_from_above(0.0), "5.0 mm beside (across) and 10.0 mm short of (depth) block"),
        (hand(bodies=0), grip_from_above(-0.2), None),
        (hand(bodies=1), grip_from_above(-0.2), None),
    ],
)  # fmt: skip
def test_what_pads_do_not_touch_is_told_by_direction(
    tool: tuple[RobotModel, Transform], grip: Transform, words: str | None
) -> None:
    found = explain_not_held(*tool, "block", BLOCK, grip, suction=False)
    assert (found is None) == (words is None), found
    assert words is None or words in str(found)


@pytest.mark.parametrize("off", [0.0, 0.0019, 0.0021])
def test_a_thin_part_is_as_far_off_as_a_thick_one(off: float) -> None:
    """Though the pads meet in a plane that it does not reach."""
    thin = box_shape("thin", (0.03, 0.0004, 0.02))
    words = explain_not_held(*hand(off=off), "thin", thin, DOWN, suction=False)
    assert (words is None) == (off < 0.002), words


def test_fingers_drawn_in_a_part_are_followed_from_outside() -> None:
    """Robots come with fingers that are drawn in one place and close on parts of any width."""
    wide = box_shape("wide", (0.03, 0.064, 0.02))
    for off in (0.0, 0.003):
        pads = pads_at(*hand(off=off), wide, DOWN)
        assert pads is not None
        directions = [pad.travel for pad in pads.sides]
        assert directions == pytest.approx([-0.002 - off, -0.002 + off], abs=1e-5) or (
            directions == pytest.approx([-0.002 + off, -0.002 - off], abs=1e-5)
        )
        assert abs(pads.off or 0.0) == pytest.approx(off, abs=1e-5)


def cup(
    tcp: float, aside: float = 0.0, ring: bool = False
) -> tuple[RobotModel, Transform]:
    tool = Tool(name="cup", shapes=cup_shapes(ring), tcp=translation(aside, 0, tcp))
    return fitted(tool, ToolGrip(None, "cup"))


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        (cup(0.1), None),
        (cup(0.1009), None),
        (cup(0.1011), "cup ends 1.1 mm away from lid"),
        (cup(0.103), "cup ends 3.0 mm away from lid"),
        (cup(0.1, 0.0209), None),
        (cup(0.1, 0.03), "mm beside what is at lid"),
        (cup(0.1, ring=True), None),
        (cup(0.1, 0.03, ring=True), "5.0 mm beside"),
    ],
)
def test_a_cup_is_on_its_face(
    tool: tuple[RobotModel, Transform], words: str | None
) -> None:
    lid = box_shape("lid", (0.2, 0.2, 0.02))
    found = explain_not_held(*tool, "lid", lid, grip_from_above(-0.01), suction=True)
    assert (found is None) == (words is None), found
    assert words is None or words in str(found)


def test_four_cups_around_a_small_part_hold_nothing() -> None:
    lid = box_shape("lid", (0.02, 0.02, 0.02))
    found = cup_at(*cup(0.1, ring=True), lid, grip_from_above(-0.01))
    assert found is not None
    assert found.gap == pytest.approx(0.005 * np.sqrt(2), abs=1e-5)


def test_without_shapes_nothing_tells() -> None:
    """As of an arm whose description ends at its flange."""
    bare = replace(robot_model("ur5e"), grip=ToolGrip((0.0, 0.06), "hand"))
    tip = bare.frame_in_last_joint("tool")
    for suction in (False, True):
        assert (
            explain_not_held(bare, tip, "block", BLOCK, DOWN, suction=suction) is None
        )


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
    assert words in explain_missing_grip(
        robot("r", grip), box_shape("box", size), RULES
    )


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
        words = describe_tool_overhang(arm, part, grip, "tool")
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
            assert describe_tool_overhang(arm, part, other, "tool") == ""


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
