"""What hangs beside fingers, below them, off their middle, or under a cup is seen, by direction."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from planning.cell.robot_model import RobotModel, ToolGrip
from planning.cell.shape import Capsule, Cylinder, Element, Shape, box_shape, shape_of
from planning.cell.workcell import CellObject, Fixture, PlacedRobot, Workcell
from planning.grips.pads import pads_at
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.registry import robot_model
from planning.transforms import Transform, from_rpy, identity, inverse, translation
from tests.planning.grips.test_pads import TIPS, cup_shapes, hand_shapes
from tests.twin.audits.audit_cell import HandWrittenRun
from twin.audits.audit import audit_run
from twin.audits.case import AuditCase
from twin.audits.expectations import Expectations
from twin.audits.grips import _Grasp
from twin.audits.motion.executed import read_recording
from twin.audits.supports import nearest_hand
from twin.audits.worlds.world import AuditWorld


def hand(
    turn: float = 0.0, *, fingers: int = 2, opening: float | None = 0.07
) -> RobotModel:
    """Return an arm with two fingers 60 mm apart, 20 mm wide, turned on its flange."""
    tcp, mount = translation(0, 0, TIPS), from_rpy((0, 0, 0), (0, 0, turn))
    grip = None if opening is None else ToolGrip((0.0, opening), "hand")
    tool = Tool(
        name="hand", shapes=hand_shapes(fingers), tcp=tcp, mount=mount, grip=grip
    )
    return robot_model("ur5e", None, Fitting(tool=tool))


def cup(ring: bool = False) -> RobotModel:
    tcp, grip = translation(0, 0, 0.1), ToolGrip(None, "cup")
    tool = Tool(name="cup", shapes=cup_shapes(ring), tcp=tcp, grip=grip)
    return robot_model("ur5e", None, Fitting(tool=tool))


PEG = shape_of("part", [Element(Cylinder(0.008, 0.03), identity())])
BLOCK = box_shape("part", (0.03, 0.03, 0.02))


def found(
    folder: Path,
    model: RobotModel,
    at: Transform,
    shape: Shape = BLOCK,
    by_suction: frozenset[str] = frozenset(),
    beside: tuple[Shape, Transform] | None = None,
) -> list[str]:
    """Return what the audit says of a part held at a pose in the tool frame for a second.

    A fixture may be beside the part, at a pose in its frame.
    """
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    part = CellObject("part", "part", shape, frame_pose(robot, model.home, "tool") @ at)
    fixtures: tuple[Fixture, ...] = ()
    if beside is not None:
        fixtures = (Fixture("slat", beside[0], part.start @ beside[1]),)
    run = HandWrittenRun(Workcell((robot,), fixtures, (part,)))
    run.move("arm", [0.0, 2.0], np.stack([model.home] * 2))
    flange = frame_pose(robot, model.home, "flange")
    run.put(1.0, "part", "arm", inverse(flange) @ part.start)
    wanted = Expectations(opening_m=0.5, gripped_at="tool", by_suction=by_suction)
    report = audit_run(run.write(folder), wanted=wanted, finished=False)
    return [v.detail for v in report.violations if v.kind == "grip"]


def agree(found: list[str], words: str | None) -> None:
    assert (found == []) == (words is None), found
    assert words is None or words in found[0], found


@pytest.mark.parametrize("turn", [0.0, 0.6])
@pytest.mark.parametrize(
    ("x", "y", "z", "words"),
    [
        (0.0, 0.0, 0.0, None),
        (0.0, 0.0, 0.0098, None),
        (0.0, 0.0, 0.0104, None),
        (0.0, 0.0, 0.011, "both fingers of hand would pass it 1.00 mm short of it (depth)"),
        (0.0, 0.0, 0.063, "53.00 mm short of it (depth)"),
        (0.0248, 0.0, 0.0, None),
        (0.026, 0.0, 0.0, "1.00 mm beside it (across)"),
        (-0.035, 0.0, 0.0, "10.00 mm beside it (across)"),
        (0.03, 0.0, 0.02, "5.00 mm beside it (across) and 10.00 mm short of it (depth)"),
        (0.0, 0.002, 0.0, None),
        (0.0, 0.0022, 0.0, "is 2.20 mm off the middle between the fingers of hand (closing)"),
        (0.0, -0.003, 0.0, "3.00 mm off the middle"),
    ],
)  # fmt: skip
def test_what_pads_do_not_touch_is_seen_by_direction(
    turn: float, x: float, y: float, z: float, words: str | None,
    tmp_path: Path,
) -> None:  # fmt: skip
    """Oracle: arithmetic of boxes. The tool is also turned against the axes of its links."""
    at = translation(x, y, z)
    agree(found(tmp_path, hand(turn), at), words)


@pytest.mark.parametrize(
    ("shape", "at", "words"),
    [
        (shape_of("part", [Element(Cylinder(0.01, 0.04), identity())]), identity(), None),
        (shape_of("part", [Element(Capsule(0.01, 0.04), identity())]), from_rpy((0, 0.003, 0), (0, np.pi / 2, 0)), "3.00 mm off the middle"),
        (box_shape("part", (0.03, 0.0004, 0.02)), translation(0, 0.0019, 0), None),
        (box_shape("part", (0.03, 0.064, 0.02)), translation(0, 0.001, 0), None),
        (box_shape("part", (0.03, 0.062, 0.02)), translation(0, 0.003, 0), "3.00 mm off the middle"),
    ],
)  # fmt: skip
def test_round_thin_and_wide_parts_are_measured_alike(
    shape: Shape, at: Transform, words: str | None, tmp_path: Path
) -> None:
    """Fingers that are drawn in a wide part are followed from outside it."""
    agree(found(tmp_path, hand(), at, shape), words)


LID = box_shape("part", (0.2, 0.2, 0.02))


@pytest.mark.parametrize(
    ("ring", "shape", "x", "gap", "words"),
    [
        (False, LID, 0.0, 0.0, None),
        (False, LID, 0.0, 0.0009, None),
        (False, LID, 0.0, 0.0013, "is held 1.30 mm away from the cup of cup"),
        (False, LID, 0.0, 0.003, "is held 3.00 mm away"),
        (False, LID, 0.1, 0.0, None),
        (True, LID, 0.0, 0.0, None),
        (True, box_shape("part", (0.02, 0.02, 0.02)), 0.0, 0.0, "7.07 mm away from the cup"),
    ],
)  # fmt: skip
def test_a_cup_is_on_what_it_holds(
    ring: bool, shape: Shape, x: float, gap: float, words: str | None,
    tmp_path: Path,
) -> None:  # fmt: skip
    at = translation(x, 0.0, 0.01 + gap)
    agree(found(tmp_path, cup(ring), at, shape), words)


def test_a_frame_beside_the_cup_is_seen(tmp_path: Path) -> None:
    model = cup(ring=True)
    frame = model.frames["tool"] @ translation(0.03, 0.0, 0.0)
    beside = replace(model, frames={"tool": frame})
    (words,) = found(tmp_path, beside, translation(0.0, 0.0, 0.01), LID)
    assert "5.00 mm beside what of cup is at it (across)" in words


def test_what_shapes_do_not_tell_is_measured_by_distance(tmp_path: Path) -> None:
    """One finger, or suction of which the tool says nothing: 5 mm, and as much as fingers close."""
    one = hand(fingers=1)
    assert found(tmp_path / "one", one, translation(0, 0, 0.02)) == []
    (words,) = found(tmp_path / "far", one, translation(0, 0, 0.09))
    assert "is held 8" in words
    assert "which closes by" in words
    mute = hand(opening=None)
    below = translation(0, 0, 0.0145)
    assert len(found(tmp_path / "pads", mute, below)) == 1
    held = frozenset(["part"])
    assert found(tmp_path / "cup", mute, below, by_suction=held) == []


BESIDE = 9e-4
"""So far beside a pad planning may find what the audit finds at it, and the other way round [m]."""

near = st.floats(-0.02, 0.02)
angle = st.floats(-np.pi, np.pi)


@pytest.fixture(scope="module")
def grasp() -> Callable[[Transform], _Grasp]:
    """A hand and a round peg, as the audit measures them, with the peg anywhere in the hand."""
    model = hand()
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    part = CellObject("part", "part", PEG, np.eye(4))
    world = AuditWorld(Workcell((robot,), (), (part,)))
    world.configure(0, model.home)
    frame = frame_pose(robot, model.home, "tool")
    tool = world.tool_shapes(0)
    return lambda at: _Grasp(world, tool, frame, world.objects, frame @ at)


@settings(max_examples=40, deadline=None)
@given(st.tuples(near, near, near), st.tuples(angle, angle, angle))
@example((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
@example((0.0, 0.02, 0.0), (1.0, 0.0, 0.0))
@example((0.0, 0.0, 0.015), (0.0078125, 0.0, 0.0))
@example((0.0, 0.0, 0.015044546987349226), (0.00390625, 0.0, 0.0))
def test_planning_and_audit_measure_the_same(
    grasp: Callable[[Transform], _Grasp],
    at: tuple[float, float, float],
    turned: tuple[float, float, float],
) -> None:
    """They share neither bodies nor ways to measure; pieces of planning are polygons around round forms."""
    pose = from_rpy(at, turned)
    model = hand()
    tip = model.frame_in_last_joint("tool")
    pads = pads_at(model, tip, PEG, inverse(pose))
    audited = grasp(pose)
    sides = audited.sides()
    assert pads is not None
    assert sides is not None
    for pad, shapes, sign in zip(pads.sides, sides, (-1.0, 1.0), strict=True):
        way, nearest = audited._closed(shapes, sign)
        miss = audited._miss(*nearest, sign)
        if pad.travel is None:
            gap = float(np.linalg.norm(pad.miss))
            assert way is None or gap < BESIDE
            assert np.linalg.norm(miss) == pytest.approx(gap, abs=3e-4)
            if gap > 0.003:
                assert miss == pytest.approx(pad.miss, abs=4e-3)
        elif way is None:
            assert np.linalg.norm(miss) < BESIDE
        elif (
            np.linalg.norm(miss) < 1e-4
            and pad.travel > -0.02
            and way != pytest.approx(pad.travel, abs=3e-3)
        ):
            # Where a rim is met, a little aside is a long way on.
            beside = ways_beside(pose, sign)
            near = [other for other in beside if other is not None]
            assert len(near) < len(beside) or min(near) - 3e-3 < way < max(near) + 3e-3


def ways_beside(pose: Transform, sign: float) -> list[float | None]:
    """Return how far a pad closes by planning on a peg that lies a little aside in each direction."""
    found: list[float | None] = []
    model = hand()
    tip = model.frame_in_last_joint("tool")
    for own in (*np.eye(3), *-np.eye(3)):
        pads = pads_at(model, tip, PEG, inverse(translation(*(BESIDE * own)) @ pose))
        assert pads is not None
        found.append(pads.sides[0 if sign < 0 else 1].travel)
    return found


@pytest.mark.parametrize(("x", "loose"), [(0.0, ""), (0.026, "1.00 mm beside it")])
def test_who_holds_something_in_place_holds_it_by_its_pads(
    x: float, loose: str, tmp_path: Path
) -> None:
    """A block that lies between the fingers of who stands still, and one that lies beside them."""
    model = hand()
    robot = PlacedRobot("arm", model, np.eye(4), model.home)
    lies = frame_pose(robot, model.home, "tool") @ translation(x, 0.0, 0.0)
    part = CellObject("part", "part", BLOCK, lies)
    run = HandWrittenRun(Workcell((robot,), (), (part,)))
    run.stand("arm", 2.0)
    run.write(tmp_path)
    recording = read_recording(tmp_path, run.cell)
    world = AuditWorld(run.cell)
    for wanted in (
        Expectations(opening_m=0.5, gripped_at="tool"),
        Expectations(opening_m=0.5),
    ):
        case = AuditCase(world, run.tpg(), recording, wanted)
        found = nearest_hand(case, (0.0, 2.0), "nobody", case.at())
        told = wanted.gripped_at is not None
        assert found.robot == "arm"
        assert found.is_near == (not loose or not told)
        assert (loose if told else "") in found.loose
        assert bool(found.loose) == bool(loose and told)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("face", "early"), [(0.0172, 2.2), (0.022, 7.0), (0.0154, None), (0.0425, None)]
)
def test_what_a_finger_meets_before_the_part_is_seen(
    side: float, face: float, early: float | None, tmp_path: Path
) -> None:
    """A slat of 2 mm lies with its outer face so far from the middle of a block of 30 mm."""
    slat = box_shape("slat", (0.02, 0.002, 0.02))
    at = translation(0.0, side * (face - 0.001), 0.0)
    block = box_shape("part", (0.03, 0.03, 0.02))
    told = found(tmp_path, hand(), identity(), block, beside=(slat, at))
    words = f"is met by a finger {early or 0.0:.2f} mm before that touches part"
    assert told == ([] if early is None else [words])
