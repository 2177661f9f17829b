"""The six skills as subgoals: what stays together, what moves, and which way."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from planning.errors import RobotModelError
from planning.handling.skill_targets import SkillTargets
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    Cell,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import box_from_top
from planning.lego.skills.handovers import giver_rest_poses, receive_poses
from planning.lego.skills.targets import (
    DEFAULT_TWIST,
    LEVER_WALL,
    STUD_HEIGHT,
    BrickGrip,
    handover_targets,
    pick_targets,
    place_targets,
    received_top,
    support_targets,
    supported_span,
)
from planning.transforms import Transform, from_rpy, inverse, rotation, translation
from tests.planning.lego.structures import TOPS, grips

FRAMES = {
    "tool": translation(0.0, 0.0, 0.111),
    "disassemble": translation(0.0, 0.0, 0.12),
    "assemble": translation(0.0078, 0.0, 0.1105),
    "handover_assemble": translation(0.0078, 0.0, 0.1095),
    "alt": translation(-0.0174, 0.0, 0.1064),
    "alt_assemble": translation(-0.0078, 0.0, 0.1064),
}
BRICK = BRICKS["2x4"]
TOP = from_rpy((0.4, 0.1, 1.2), (0.0, 0.0, 0.3))


def flange(targets: SkillTargets, k: int) -> Transform:
    """Return the flange's pose at subgoal ``k``."""
    subgoal = targets.subgoals[k]
    return subgoal.pose @ inverse(FRAMES[subgoal.frame])


def held(targets: SkillTargets, grip: BrickGrip) -> Transform:
    """Return the pose of a brick's box in the flange frame where it changes hands in a skill."""
    assert targets.change_at is not None
    box = box_from_top(grip.top, grip.brick)
    return inverse(flange(targets, targets.change_at)) @ box


def angle(a: Transform, b: Transform) -> float:
    """Return the angle between two orientations [rad]."""
    trace = np.trace(a[:3, :3].T @ b[:3, :3])
    return float(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


@given(grips(FRAMES), TOPS)
def test_a_brick_is_held_the_same_from_pick_to_place(
    start: BrickGrip, goal: Transform
) -> None:
    there = replace(start, top=goal)
    picked = held(pick_targets(start), start)
    np.testing.assert_allclose(picked, start.held(), atol=1e-12)
    placed = held(place_targets(there, up=False), there)
    np.testing.assert_allclose(picked, placed, atol=1e-12)


@given(TOPS, grips(FRAMES))
def test_a_brick_passes_through_two_hands_to_its_goal(
    ready: Transform, goal: BrickGrip
) -> None:
    """Giver's press, receiver's carry and place-up agree on where the brick is."""
    given_up = replace(goal, top=received_top(goal, ready))
    in_giver = held(handover_targets(given_up), given_up)
    start = replace(goal, top=TOP)
    np.testing.assert_allclose(in_giver, held(pick_targets(start), start), atol=1e-12)
    box = box_from_top(given_up.top, goal.brick)
    in_receiver = inverse(ready @ inverse(FRAMES["tool"])) @ box
    np.testing.assert_allclose(in_receiver, goal.held(up=True), atol=1e-12)
    at_goal = held(place_targets(goal, up=True), goal)
    np.testing.assert_allclose(in_receiver, at_goal, atol=1e-12)


def test_waypoints_and_handlings_of_each_skill() -> None:
    grip = BrickGrip(FRAMES, BRICK, TOP, Press(1, 1))
    down, up = (place_targets(grip, up=up) for up in (False, True))
    held = support_targets(Plate(np.eye(4)), Support(Cell(9, 9, 9), 0))[3]
    for skill, names, change_at, lead in (
        (pick_targets(grip), "approach, above, attach, twist, leave", 2, 1),
        (down, "approach, above, attach, half twist, twist, leave", 2, 1),
        (up, "pre, approach, below, place, twist, leave", 3, 2),
        (handover_targets(grip), "approach, press, twist, leave", 1, 1),
        (held, "pre, support", None, 1),
    ):
        assert ", ".join(subgoal.name for subgoal in skill.subgoals) == names
        assert (skill.change_at, skill.lead) == (change_at, lead)
    assert held.skill == "support-bottom"


@given(grips(FRAMES), st.floats(0.05, 0.5))
def test_every_twist_turns_by_its_angle_about_its_axis(
    grip: BrickGrip, twist: float
) -> None:
    twists = dict.fromkeys(DEFAULT_TWIST, twist)
    down, up = (place_targets(grip, up=up, twist=twists) for up in (False, True))
    for targets, before, after, axis in (
        (pick_targets(grip, twist=twist), 2, 3, "disassemble"),
        (down, 2, 4, "assemble"),
        (up, 3, 4, "alt_assemble"),
    ):
        a, b = flange(targets, before), flange(targets, after)
        assert angle(a, b) == pytest.approx(twist, abs=1e-6)
        # The axis of the twist stays where it is, its direction too.
        # That of a pick is near the bottom of a brick, and as near to that of a plate.
        nearer = 0.0032 * (3 - grip.brick.height) if axis == "disassemble" else 0.0
        at = FRAMES[axis] @ translation(0.0, 0.0, -nearer)
        still_a, still_b = a @ at, b @ at
        np.testing.assert_allclose(still_a[:3, 3], still_b[:3, 3], atol=1e-12)
        np.testing.assert_allclose(still_a[:3, 1], still_b[:3, 1], atol=1e-12)


@given(grips(FRAMES))
def test_the_tool_comes_straight_down_and_leaves_straight_up(grip: BrickGrip) -> None:
    for targets, drop in (
        (pick_targets(grip), 0.0028),
        (place_targets(grip, up=False), 0.005),
    ):
        down = flange(targets, 2)[:3, 3] - flange(targets, 1)[:3, 3]
        np.testing.assert_allclose(down, [0, 0, -drop], atol=1e-12)
        leave = flange(targets, -1)[:3, 3] - flange(targets, -2)[:3, 3]
        np.testing.assert_allclose(leave, [0, 0, 0.015], atol=1e-12)


@given(grips(FRAMES))
def test_attack_mirrors_the_approach(grip: BrickGrip) -> None:
    for up in (False, True):
        plus, minus = (place_targets(grip, up=up, attack=a) for a in (1, -1))
        for a, b in zip(plus.subgoals, minus.subgoals, strict=True):
            moved = (inverse(a.pose) @ b.pose)[:3, 3]
            sideways = 0.010 if a.name in ("approach", "pre") else 0.0
            assert abs(moved[1]) == pytest.approx(sideways, abs=1e-12)
            np.testing.assert_allclose(moved[[0, 2]], 0.0, atol=1e-12)


def test_a_robot_without_the_tool_is_named() -> None:
    with pytest.raises(RobotModelError, match="disassemble") as caught:
        pick_targets(BrickGrip({"tool": np.eye(4)}, BRICK, TOP, Press(1, 0)))
    assert caught.value.choices == ("tool",)


def test_default_twists_are_the_published_ones() -> None:
    degrees = {k: round(np.degrees(v), 9) for k, v in DEFAULT_TWIST.items()}
    assert degrees == {"pick": 16, "place-down": 16, "place-up": 16, "handover": 18}


@given(TOPS, st.floats(0.5, 2.0), st.floats(-3, 3))
def test_a_handover_is_held_out_towards_the_giver(
    receiver: Transform, distance: float, bearing: float
) -> None:
    giver = receiver @ rotation("z", bearing) @ translation(distance, 0.0, 0.0)
    poses = receive_poses(receiver, giver)
    assert len({receive.pose.tobytes() for _, receive in poses}) == len(poses) >= 20
    towards = (giver[:3, 3] - receiver[:3, 3]) / distance
    for pre, receive in poses:
        tool = receive.pose
        assert tool[:3, 2] @ towards > np.cos(np.radians(10.0)) - 1e-9
        np.testing.assert_allclose(tool[:3, 0], [0, 0, -1], atol=1e-9)
        back = (inverse(tool) @ pre.pose)[:3, 3]
        np.testing.assert_allclose(back, [0, 0, -0.075], atol=1e-9)
    # Nearest to the published place first.
    published = np.array([0.45, 0.35])
    off = []
    for _, receive in poses:
        at = receive.pose[:3, 3] - receiver[:3, 3]
        place = np.array([np.hypot(at[0], at[1]), at[2]])
        off.append(np.abs(place - published).sum())
    assert off[0] == pytest.approx(0.0, abs=1e-9)
    assert all(a <= b + 1e-6 for a, b in itertools.pairwise(off))
    again = receive_poses(receiver, giver)
    for (_, a), (_, b) in zip(poses, again, strict=True):
        np.testing.assert_array_equal(a.pose, b.pose)


@given(TOPS)
def test_the_giver_waits_in_front_of_itself_pointing_down(base: Transform) -> None:
    rest = giver_rest_poses(base)
    assert rest.frame == "flange"
    np.testing.assert_allclose(
        (inverse(base) @ rest.pose)[:3, 3], [0.2, 0.0, 0.5], atol=1e-12
    )
    np.testing.assert_allclose(rest.pose[:3, 2], [0, 0, -1], atol=1e-12)


HEADING = {0: (1, 0), 1: (0, -1), 2: (0, 1), 3: (-1, 0)}
QUARTER_TURN = {0: 2, 2: 3, 3: 1, 1: 0}

places = st.tuples(st.integers(4, 40), st.integers(4, 40), st.integers(2, 20))
orientations = st.sampled_from([0, 1, 2, 3])
supports = st.builds(
    Support, places.map(lambda at: Cell(*at)), orientations, st.booleans()
)


def _turned_by_a_quarter(support: Support, studs: int = 48) -> Support:
    """Return the support on the grid turned by +90 degrees about the plate's centre."""
    far = supported_span(support).y1
    orientation = QUARTER_TURN[support.orientation]
    cell = replace(support.cell, x=studs - far, y=support.cell.x)
    return Support(cell, orientation, support.from_above)


@given(supports)
def test_orientations_are_quarter_turns_of_each_other(support: Support) -> None:
    plate = Plate(np.eye(4))
    here = support_targets(plate, support)[0].subgoals
    there = support_targets(plate, _turned_by_a_quarter(support))[0].subgoals
    quarter = rotation("z", np.pi / 2)
    for a, b in zip(here, there, strict=True):
        np.testing.assert_allclose(b.pose, quarter @ a.pose, atol=1e-12)


@given(places, orientations)
def test_the_tip_lies_under_the_supported_studs(
    place: tuple[int, int, int], orientation: int
) -> None:
    plate = Plate(np.eye(4))
    support = Support(Cell(*place), orientation)
    pose = support_targets(plate, support)[0].subgoals[-1].pose
    heading = np.array([*HEADING[orientation], 0.0])
    np.testing.assert_allclose(pose[:3, 2], heading, atol=1e-12)
    # The tip is two studs high: it fills up to the bottom of layer z + 1.
    assert pose[2, 3] + STUD_PITCH == pytest.approx(place[2] * LAYER_HEIGHT)
    # It ends at the far edge of the supported studs, the wall included, centred on them.
    tip = (pose[:3, 3] + LEVER_WALL * heading)[:2] / STUD_PITCH + 24
    x0, x1, y0, y1, *_ = supported_span(support)
    expected = [(x0 + x1) / 2, (y0 + y1) / 2] + 0.5 * heading[:2]
    np.testing.assert_allclose(tip, expected, atol=1e-9)


@given(places, orientations)
def test_the_wall_stands_on_the_studs_from_above(
    place: tuple[int, int, int], orientation: int
) -> None:
    support = Support(Cell(*place), orientation, from_above=True)
    (targets,) = support_targets(Plate(np.eye(4)), support)
    pose = targets.subgoals[-1].pose
    np.testing.assert_allclose(pose[:3, 2], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(pose[:2, 0], HEADING[orientation], atol=1e-12)
    top_of_studs = (place[2] - 1) * LAYER_HEIGHT + STUD_HEIGHT
    assert pose[2, 3] - LEVER_WALL == pytest.approx(top_of_studs)


@given(supports, st.floats(-3, 3))
def test_support_poses_move_with_the_plate(support: Support, yaw: float) -> None:
    moved = from_rpy((0.3, -0.2, 1.0), (0.0, 0.0, yaw))
    a = support_targets(Plate(np.eye(4)), support)[0].subgoals[-1].pose
    b = support_targets(Plate(moved), support)[0].subgoals[-1].pose
    np.testing.assert_allclose(inverse(moved) @ b, a, atol=1e-9)


def test_pre_poses_are_apart_and_the_first_is_straight() -> None:
    plate = Plate(np.eye(4))
    bottom = support_targets(plate, Support(Cell(20, 20, 5), 0))
    moves = [
        tuple(np.round((pre.pose - support.pose)[:3, 3] * 1e3, 6) + 0.0)
        for pre, support in (way.subgoals for way in bottom)
    ]
    assert moves[0] == (0.0, 0.0, -1.0)
    assert len(set(moves)) == 9
    assert {m[2] for m in moves} == {-1.0}
    ((pre, support),) = (
        way.subgoals
        for way in support_targets(plate, Support(Cell(20, 20, 5), 1, from_above=True))
    )
    lift = (pre.pose - support.pose)[:3, 3]
    np.testing.assert_allclose(lift, [0, 0, 0.005], atol=1e-12)
