"""Robots: a HOME that is named where nobody gives one, bases, efforts, and what they carry.

``twin robots MODEL``: what is in a description, in tables that are never cut, and a picture.
"""

import json
import re
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import twin
from planning.cell.motion_limits import MotionLimits
from planning.cell.shape import Box, Cylinder, Element
from planning.kinematics.kinematics import frame_pose
from planning.robots.descriptions.fitting import Fitting, Tool
from planning.robots.descriptions.urdf_file import GivenLimits
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import identity, translation
from tests.planning.robots.descriptions.test_mounting import link_poses
from tests.planning.robots.descriptions.vendors import GRIPPER, ur5e
from tests.planted import planted
from tests.shipped_runs import SCENARIOS
from tests.twin.checks.test_check import CELL
from tests.twin.checks.test_tools import HANDS, hand_cell
from tests.twin.program import invoke
from tests.twin.written import Change, checked, refusal, written
from twin.checks.finding import CheckContext
from twin.checks.overview import flange_warning, robot_overview
from twin.checks.picture import cell_figure
from twin.checks.tools import finger_gap
from twin.checks.views import MOST, find_close_ups
from twin.kinds.parts.checks.context import ordered_parts
from twin.kinds.parts.checks.loads import check_payloads
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.scenario import resolve_scenario, restore_scenario
from twin.scenario.shipped import scenario_path


def vendors_arms(folder: Path, height: float, home: str) -> list[str]:
    """Return what is said of two arms of a vendor that gives no HOME, 1 m apart on a table."""
    file = written(
        folder,
        CELL,
        ("model: panda", f"model: {ur5e()}{home}"),
        ("xyz_m: [-0.6, 0, 0]", f"xyz_m: [-0.5, 0, {height}]"),
        ("xyz_m: [0.6, 0, 0]", "xyz_m: [0.5, 0, 0]"),
    )
    return [item.message for item in checked(file).findings]


def test_where_nobody_gives_a_home_a_free_one_is_named(tmp_path: Path) -> None:
    (found,) = (m for m in vendors_arms(tmp_path, 0, "") if "at HOME" in m)
    assert "its joints are at zero, as no HOME is given" in found
    home = re.search(r"home_deg: \[[-\d, ]+\]", found)
    assert home is not None
    again = vendors_arms(tmp_path, 0, f"\n      {home.group()}")
    assert not [message for message in again if "at HOME" in message]


def test_the_named_home_is_beside_the_places_of_parts(tmp_path: Path) -> None:
    # Straight in front of the arms.
    arms: list[Change] = [
        ("[0, 0.3, 0.05]", "[0, 0.05, 0.05]"),
        ("[0, 0.3, 0.1155]", "[0, 0, 0.1155]"),
        ("[0, 0.4, 0.1155]", "[0, 0.1, 0.1155]"),
        ("model: panda", f"model: {ur5e()}"),
    ]
    messages = [item.message for item in checked(written(tmp_path, CELL, *arms)).errors]
    home = re.search(r"home_deg: \[[-\d, ]+\] would be free$", messages[0])
    assert home is not None, messages
    key = home.group().removesuffix(" would be free")
    given = f"model: {ur5e()}", f"model: {ur5e()}\n      {key}"
    report = checked(written(tmp_path, CELL, *arms, given))
    assert not [item for item in report.findings if "at HOME" in item.message]
    for robot in report.subject.cell.robots:
        tool = frame_pose(robot, robot.home)[:2, 3]
        for goal in ordered_parts(report.subject).listed.goals.values():
            assert np.linalg.norm(tool - goal[:2, 3]) > 0.24


def test_a_base_drawn_as_balls_is_not_in_the_table_on_which_it_stands(
    tmp_path: Path,
) -> None:
    standing = vendors_arms(tmp_path, 0, "")
    assert not [message for message in standing if "deep in table" in message]
    sunk = vendors_arms(tmp_path, -0.02, "")
    (found,) = (message for message in sunk if "deep in table" in message)
    assert "the base of left is 20.0 mm deep in table" in found


TRAY = SCENARIOS / "multi_arm" / "tray.yaml"


def warnings(folder: Path, *changes: Change) -> list[str]:
    text = TRAY.read_text(encoding="utf-8")
    return list(twin.check(written(folder, text, *changes)).warnings)


def limited(limits: str) -> Change:
    left = "{name: left, model: panda,"
    return left, f"{left} limits: {{{limits}}},"


@pytest.mark.parametrize("effort", [87.0, 1.0])
def test_an_arm_that_cannot_hold_itself_is_named(effort: float, tmp_path: Path) -> None:
    found = warnings(tmp_path, limited(f"effort: {effort}"))
    if effort > 1.0:
        assert found == []
    else:
        (words,) = found
        assert "efforts of left (panda-fitted) are not kept to: panda_joint2" in words
        assert "hold the arm at HOME: that takes 2.72 N m" in words


def test_a_part_that_cannot_be_held_is_named(tmp_path: Path) -> None:
    heavy = "mass_kg: 0.3", "mass_kg: 6"
    found = warnings(tmp_path, limited("effort: 22, payload_kg: 9"), heavy)
    (words,) = [own for own in found if "kg/m^3" not in own]
    assert "left cannot hold" in words
    assert "(6 kg) at HOME: panda_joint4 would have to exert" in words


WEIGHED = GRIPPER.replace(
    '<link name="palm">',
    '<link name="palm"><inertial><origin xyz="0 0 0.04"/><mass value="0.3"/>'
    '<inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>',
).replace(
    '<link name="left">',
    '<link name="left"><inertial><mass value="0.06"/>'
    '<inertia ixx="0.0001" iyy="0.0001" izz="0.0001" ixy="0" ixz="0" iyz="0"/></inertial>',
)
"""The gripper with masses that add up to 0.36 kg."""

TOO = planted(r"""
what                             | old             | new             | says                                                                          | level
tool alone                       | payload_kg: 3   | payload_kg: 0.1 | the tool hand of arm weighs 0.5 kg, and arm may carry 0.1 kg with it           | warning
tool of its description          | ", mass_kg: 0.5" | ""             | the tool hand of arm weighs 0.36 kg, and arm may carry 0.1 kg with it          | warning
tool and part                    | mass_kg: 1}     | mass_kg: 2.6}   | a weighs 2.6 kg, which no robot carries beside its tool (arm 2.5 kg;           | error
tool and a part by its density   | mass_kg: 1}     | density_kg_m3: 40000} | a weighs 3.84 kg, which no robot carries beside its tool (arm 2.5 kg;    | error
part without mass                | ", mass_kg: 1}" | "}"             | a has no mass, so that of what arm may carry (limits.payload_kg) the tool alone counts: give mass_kg, or density_kg_m3 | warning
part of 0 kg                     | mass_kg: 1}     | mass_kg: 0}     | a has no mass                                                                 | warning
tool without mass                | ", mass_kg: 0.5" | ""             | hand has no mass, so that of the 3 kg that arm may carry                       | warning
""")


def said(folder: Path, *changes: Change, hand: str = GRIPPER) -> list[tuple[str, bool]]:
    file = hand_cell(folder, *changes)
    (folder / "hand.urdf").write_text(hand)
    found = check_payloads(CheckContext(load_scenario(file), folder))
    return [(item.message, item.error) for item in found]


@pytest.mark.parametrize("what", TOO)
def test_masses_that_cannot_be_are_told(what: str, tmp_path: Path) -> None:
    old, new, words, level = TOO[what]
    changes, hand = [(old, new)], GRIPPER
    if what == "tool of its description":
        changes, hand = [*changes, ("payload_kg: 3", "payload_kg: 0.1")], WEIGHED
    found = said(tmp_path, *changes, hand=hand)
    assert any(words in m and bad == (level == "error") for m, bad in found), found


NO_PAYLOAD: Change = (", limits: {payload_kg: 3}", "")


@pytest.mark.parametrize(
    "changes",
    [
        [("payload_kg: 3", "payload_kg: 1.5")],
        [("mass_kg: 1}", "mass_kg: 2.5}")],
        [("mass_kg: 1}", "density_kg_m3: 7850}")],
        [NO_PAYLOAD],
        # The UR5e's maker tells its payload: a cell that says nothing of masses is none that is wrong.
        [NO_PAYLOAD, (", mass_kg: 0.5", ""), (", mass_kg: 1}", "}")],
    ],
)
def test_what_a_robot_carries_is_no_word_worth(
    changes: list[Change], tmp_path: Path
) -> None:
    assert said(tmp_path, *changes) == []


def test_a_part_that_who_may_place_it_cannot_carry_is_refused(tmp_path: Path) -> None:
    other = "    - {name: weak, model: ARM, tool: hand, base: {xyz_m: [1, 0, 0]}, limits: {payload_kg: 1}}\n"
    two = "  fixtures:\n", f"{other}  fixtures:\n"
    assert said(tmp_path, two) == []
    own = "steps: [a]", "steps: [{place: a, robots: [weak]}]"
    ((words, error),) = said(tmp_path, two, own)
    assert error
    assert "a weighs 1 kg, which no robot that may place it carries" in words
    assert "(weak 0.5 kg;" in words


@pytest.mark.parametrize("shapes", [False, True])
@pytest.mark.parametrize("hand", [GRIPPER, WEIGHED])
def test_a_tool_weighs_what_the_scenario_says(
    hand: str, shapes: bool, tmp_path: Path
) -> None:
    """Its links keep their shares; a tool of shapes has it where these are."""
    path = tmp_path / "hand.urdf"
    path.write_text(hand)
    forms = (
        Element(Box((0.06, 0.06, 0.1)), translation(0.0, 0.0, 0.05)),
        Element(Cylinder(0.01, 0.1), translation(0.0, 0.0, 0.15)),
    )
    one: dict[str, Any] = {"shapes": forms} if shapes else {"description": path}
    bare = robot_model("ur5e", None, Fitting(limits=GivenLimits(payload=5.0)))
    tool = Tool(name="hand", tcp=translation(0.0, 0.0, 0.2), mass=0.9, **one)
    model = robot_model(
        "ur5e", None, Fitting(tool=tool, limits=GivenLimits(payload=5.0))
    )
    assert model.drives is not None
    assert bare.drives is not None
    assert bare.inertias is not None
    assert model.inertias is not None
    assert model.drives.tool_mass == pytest.approx(0.9)
    assert model.drives.spare == pytest.approx(4.1)
    gained = model.inertias.mass[-1] - bare.inertias.mass[-1]
    assert gained == pytest.approx(0.9)
    # In the frame of the last joint: where it was, and where the tool is.
    whole = model.inertias.mass[-1] * model.inertias.centre[-1]
    centre = (whole - bare.inertias.mass[-1] * bare.inertias.centre[-1]) / gained
    ahead = (np.linalg.inv(model.flange) @ np.append(centre, 1.0))[2]
    assert 0.03 < ahead < 0.12


def test_a_density_stays_what_it_is_in_a_manifest(tmp_path: Path) -> None:
    dense = "mass_kg: 1}", "density_kg_m3: 500}"
    scenario = load_scenario(hand_cell(tmp_path, dense))
    assert restore_scenario(resolve_scenario(scenario)) == scenario
    assert CheckContext(scenario, tmp_path).cell.object("a").mass == pytest.approx(
        0.048
    )
    both = "mass_kg: 1}", "density_kg_m3: 500, mass_kg: 1}"
    said = refusal(tmp_path, HANDS, both, ("ARM", "ur5e"))
    assert "give mass_kg or density_kg_m3, not both" in str(said)


SCENARIO = """version: 1
name: pair
cell:
  tools:
    hand: {description: hand.urdf, joints: {squeeze: 0.02}, opening_m: 0.09}
  robots:
    - {name: left, model: ur5e, tool: hand, base: {xyz_m: [0, 0, 0]}}
    - {name: right, model: ur5e, tool: hand, base: {xyz_m: [2, 0, 0]}}
    - {name: bare, model: ur5e, base: {xyz_m: [4, 0, 0]}, limits: {velocity: 1.25, payload_kg: 5}}
assembly:
  kind: goals
  moves: [{robot: left, to_rad_or_m: [0, -1, 1, 0, 0, 0]}]
"""


def robots(*arguments: str) -> str:
    done = invoke("robots", *arguments, code=0)
    return done.stdout


@pytest.fixture
def hand(tmp_path: Path) -> Path:
    path = tmp_path / "hand.urdf"
    path.write_text(GRIPPER)
    return path


def test_every_registered_robot_has_a_sheet() -> None:
    for name in ROBOTS:
        text = robots(name)
        model = robot_model(name)
        assert f"flange: link '{model.flange_link}'" in text
        for joint in (*model.joint_names, *model.frames):
            assert f" {joint} " in text
        assert "…" not in text
        assert "doubtful: the last joint" not in text


def test_links_are_where_pinocchio_puts_them() -> None:
    model = robot_model("panda")
    found = robot_overview(model)
    values = dict(zip(model.joint_names, model.home, strict=True))
    wanted = link_poses(model.urdf, {**values, **ROBOTS["panda"].frozen})
    own = {row.name: row.pose for row in found.links}
    for link in ("panda_link4", "panda_link8", "panda_hand"):
        assert np.allclose(own[link], wanted[link], atol=1e-9)


def test_a_tool_has_a_sheet_too(hand: Path, tmp_path: Path) -> None:
    text = robots(str(hand), "--hold", "squeeze=0.03", "--out", str(tmp_path / "p"))
    assert "a tool, as it is no robot" in text
    assert " squeeze  0.03 " in text
    assert " follow   -0.03 " in text
    assert "(-0.01, 0.03, 0.09)" in text  # the least corner of the left finger
    with Image.open(tmp_path / "p" / "hand.png") as picture:
        assert picture.size[0] > 1000


def test_the_robots_of_a_scenario_are_shown_with_their_tools(
    hand: Path, tmp_path: Path
) -> None:
    path = written(tmp_path, SCENARIO)
    pair, bare = json.loads(robots(str(path), "--json"))
    assert pair["title"] == "ur5e+hand (left, right)"
    assert bare["title"] == "ur5e-fitted (bare)"
    assert "hand: fingers open from 0 to 90 mm, held 40.0 mm apart" in pair["notes"]
    assert "payload 5 kg, the tool included" in bare["notes"]
    assert {row["velocity"] for row in bare["joints"]} == {"1.25"}
    held = {row["joint"]: row["kind"] for row in pair["joints"]}
    assert held["hand.follow"] == "held at -0.02"


def test_limits_are_told_with_where_they_come_from() -> None:
    (panda,) = json.loads(robots("panda", "--json"))
    assert any("libfranka" in word for word in panda["notes"])
    assert [row["acceleration"] for row in panda["joints"][:3]] == ["15", "7.5", "10"]
    assert panda["joints"][0]["jerk"] == "7500"
    (ur5e,) = json.loads(robots("ur5e", "--json"))
    assert {row["acceleration"] for row in ur5e["joints"]} == {"5 (usual)"}
    assert any("not specified" in word for word in ur5e["notes"])


def test_a_maker_s_limits_stay_when_a_cell_adds_a_tool_or_a_limit() -> None:
    own = robot_model("panda")
    fitted = robot_model("panda", None, Fitting(limits=GivenLimits(velocity=(1.0,))))
    slower = robot_model(
        "panda", None, Fitting(limits=GivenLimits(acceleration=(2.0,)))
    )
    for model in (own, fitted):
        assert MotionLimits.of(model).acceleration.tolist()[:3] == [15.0, 7.5, 10.0]
        assert MotionLimits.of(model).jerk.tolist()[-1] == 10000.0
    assert set(MotionLimits.of(slower).acceleration.tolist()) == {2.0}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nobody.urdf"], "does not exist"),
        (["nobody"], "no robot 'nobody'"),
        (["panda", "--hold", "finger"], "JOINT=VALUE expected"),
        (["panda", "--hold", "thumb=1"], "no joint 'thumb'"),
        (["panda", "--flange", "thumb"], "'thumb' is no link"),
    ],
)
def test_mistakes_are_explained(arguments: list[str], words: str) -> None:
    done = invoke("robots", *arguments, code=2)
    assert words in done.output


def test_what_is_neither_a_robot_nor_a_tool_gets_both_reasons(tmp_path: Path) -> None:
    path = tmp_path / "thing.urdf"
    path.write_text('<robot name="x"><link name="a"/></robot>')
    done = invoke("robots", path, code=2)
    assert "it is no robot: " in done.output
    assert "has no collision geometry" in done.output


def test_a_flange_with_x_out_of_it_is_doubtful() -> None:
    other = robot_model(str(ur5e()), None, Fitting(flange="flange"))
    words = flange_warning(other)
    assert words is not None
    assert "x points out of the flange" in words
    assert flange_warning(robot_model(str(ur5e()))) is None


@pytest.mark.parametrize("held", [0.0, 0.01, 0.04])
def test_the_gap_between_fingers_is_measured(hand: Path, held: float) -> None:
    tool = Tool(name="h", description=hand, held={"squeeze": held})
    model = robot_model("ur5e", None, Fitting(tool=tool))
    gap = finger_gap(model, model.frames["tool"])
    assert gap == pytest.approx(2.0 * held, abs=1e-9)
    assert finger_gap(model, identity()) == 0.0  # the flange is in the palm


ROW = (15.0, 3.3)


def _boxes(*centres: tuple[float, float], size: float = 0.02) -> np.ndarray:
    middle = np.array(centres)
    return np.stack([middle - 0.5 * size, middle + 0.5 * size], axis=1)


def test_tiny_things_near_each_other_are_drawn_larger() -> None:
    boxes = _boxes((0, 0), (0.05, 0), (0.03, 0.04), (1.9, 1.9), (1.0, 0.1))
    (found,) = find_close_ups(boxes, np.array([2.0, 2.0]), 0.004, ROW)
    assert [found.holds(box) for box in boxes] == [True, True, True, False, False]
    assert find_close_ups(10 * boxes, np.array([2.0, 2.0]), 0.004, ROW) == []
    assert find_close_ups(boxes[:0], np.array([2.0, 2.0]), 0.004, ROW) == []
    many = [(x, y) for x in np.arange(8) / 4 for y in (0.0, 0.03, 1.0, 1.03)]
    assert len(find_close_ups(_boxes(*many), np.array([2.0, 2.0]), 0.004, ROW)) <= MOST


def test_names_in_the_picture_are_not_on_each_other() -> None:
    path = scenario_path(Path("cliff"))
    figure = cell_figure(CheckContext(load_scenario(path), path.parent))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    above, _, *larger = figure.axes
    assert len(larger) == 3
    # The two reach 1.47 m from side to side, what happens there less than 1 m.
    assert np.ptp(above.get_xlim()) < 1.4
    for area in figure.axes:
        boxes = [
            text.get_window_extent(canvas.get_renderer()).expanded(0.9, 0.8)
            for text in area.texts
        ]
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
    named = {text.get_text() for area in larger for text in area.texts}
    assert {"left_2x4_a", "right_2x6", "step 10"} <= named
