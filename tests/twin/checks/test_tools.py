"""Tool frames: those of packaged robots are at their tools, an X-forward flange is not.

Tools of cells: fingers that are where they say, parts that they can hold and carry. Lengths in
millimetres where metres are asked for: the key is named, and what it is in metres.
"""

from pathlib import Path

import numpy as np
import pytest
import yaml

from planning.robots.descriptions.fitting import Fitting
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import from_rpy, translation
from tests.planning.robots.descriptions.vendors import GRIPPER, ur5e
from tests.planted import planted, rows
from tests.twin.checks.test_check import CELL, ROOT
from tests.twin.written import Change, checked, written
from twin.checks.tools import frame_warnings
from twin.document.validation import InvalidScenarioError
from twin.reading.scenario_file import read_scenario

LINK = (
    '<link name="l{0}"><collision><origin xyz="0 0 0.05"/><geometry>'
    '<cylinder radius="0.03" length="0.1"/></geometry></collision></link>'
)
JOINT = (
    '<joint name="j{0}" type="revolute"><parent link="l{1}"/><child link="l{0}"/>'
    '<origin xyz="0 0 0.15"/><axis xyz="{2}"/>'
    '<limit lower="-2.9" upper="2.9" effort="10" velocity="2"/></joint>'
)
FLANGE = (
    '<link name="flange"/><joint name="fixed" type="fixed"><parent link="l6"/>'
    '<child link="flange"/><origin xyz="0 0 0.1" rpy="{}"/></joint>'
)


def arm(folder: Path, flange_rpy: str) -> Path:
    """Write an arm of six joints whose flange is turned against the last link."""
    parts = [LINK.format(0)]
    for k in range(1, 7):
        parts.append(LINK.format(k))
        parts.append(JOINT.format(k, k - 1, ("0 0 1", "0 1 0")[k % 2]))
    text = "".join(parts) + FLANGE.format(flange_rpy)
    file = folder / "arm.urdf"
    file.write_text(f'<robot name="arm">{text}</robot>', encoding="utf-8")
    return file


@pytest.mark.parametrize("name", ROBOTS)
def test_frames_of_packaged_robots_are_at_their_tools(name: str) -> None:
    model = robot_model(name)
    assert list(frame_warnings(model, model.frames["tool"])) == []


def test_a_flange_with_x_forward_is_found(tmp_path: Path) -> None:
    """As on ROS-Industrial robots, whose link ``flange`` has x out of the arm."""
    right = robot_model(str(arm(tmp_path, "0 0 0")))
    assert list(frame_warnings(right, np.eye(4))) == []
    model = robot_model(str(arm(tmp_path, "0 -1.5708 -1.5708")))
    (words,) = frame_warnings(model, np.eye(4))
    assert "does not point out of the tool: 30" in words
    turned = from_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
    assert list(frame_warnings(model, turned)) == []


@pytest.mark.parametrize(
    ("ahead", "says"), [(0.0, "lies behind the tool"), (0.2, "mm away from the tool")]
)
def test_a_frame_at_the_mount_of_a_gripper_or_far_from_it_is_found(
    ahead: float, says: str
) -> None:
    (words,) = frame_warnings(robot_model("panda"), translation(0.0, 0.0, ahead))
    assert says in words


def test_a_frame_between_wide_open_fingers_is_at_the_tool() -> None:
    """The fingers belong to the arm's description: how far they open, nobody says."""
    data = pytest.importorskip("pybullet_data")
    file = str(Path(data.getDataPath(), "franka_panda", "panda.urdf"))
    wide = {"panda_finger_joint1": 0.035, "panda_finger_joint2": 0.035}
    model = robot_model(file, None, Fitting(held=wide, flange="panda_link8"))
    between = from_rpy((0.0, 0.0, 0.105), (0.0, 0.0, -np.pi / 4))
    assert list(frame_warnings(model, between)) == []
    assert list(frame_warnings(model, between @ from_rpy((0, 0, 0.05), (0, 0, 0))))


HANDS = """\
version: 1
name: hands
cell:
  tools:
    hand: {description: hand.urdf, joints: {squeeze: 0.03}, opening_m: 0.08, mass_kg: 0.5}
  robots:
    - {name: arm, model: ARM, tool: hand, home_deg: [0, -100, 110, -100, -90, 0], limits: {payload_kg: 3}}
  fixtures:
    - {name: table, size_m: [1.6, 1.6, 0.04], pose: {xyz_m: [0, 0, -0.03]}}
assembly:
  kind: assembly
  grips: {positions: 1, depth_m: 0.02}
  parts:
    - {name: a, size_m: [0.06, 0.04, 0.04], start: {xyz_m: [0.5, 0.1, 0.01]}, goal: {xyz_m: [0.5, -0.1, 0.01]}, mass_kg: 1}
  steps: [a]
planning: {speed_model: joint}
execution:
  skills: {pick: {kind: fixed, value_s: 1}, place-down: {kind: fixed, value_s: 1}}
"""


def hand_cell(folder: Path, *changes: Change, arm: str = "ur5e") -> Path:
    """Return the file of the cell, of which an arm has the hand, with something else in it."""
    (folder / "hand.urdf").write_text(GRIPPER)
    return written(folder, HANDS, *changes, ("ARM", arm))


def findings(
    folder: Path, *changes: Change, arm: str = "ur5e"
) -> list[tuple[str, int, bool]]:
    """Return what is found in that cell: words, line, whether an error."""
    report = checked(hand_cell(folder, *changes, arm=arm))
    return [
        (item.message, report.problem(item).mark.line, item.error)
        for item in report.findings
    ]


def test_a_sound_hand_passes(tmp_path: Path) -> None:
    assert findings(tmp_path) == []


@pytest.mark.parametrize(
    ("opening", "said"), [("0.059", 0), ("0.0581", 0), ("0.0575", 1), ("0.05", 1)]
)
def test_fingers_may_be_drawn_a_little_wider_than_they_open(
    tmp_path: Path, opening: str, said: int
) -> None:
    """Each by a millimetre, as a vendor's are that open to 85 mm and are drawn 86 mm apart."""
    found = findings(tmp_path, ("opening_m: 0.08", f"opening_m: {opening}"))
    assert len([m for m, _, _ in found if "are held 60.0 mm apart" in m]) == said


@pytest.mark.parametrize(
    ("old", "new", "words", "line", "level"),
    rows(r"""
old                        | new                                          | says                                    | line | level
opening_m: 0.08            | opening_m: 0.05                              | hand are held 60.0 mm apart             | 7    | warning
opening_m: 0.08            | opening_m: 0.08, closing: x                  | nothing of hand on both sides           | 7    | warning
size_m: [0.06, 0.04, 0.04] | size_m: [0.1, 0.1, 0.1]                      | and hand opens to 80.0 mm               | 14   | error
opening_m: 0.08            | opening_m: 0                                 | and hand holds nothing                  | 14   | error
mass_kg: 1}                | mass_kg: 3.5}                                | a weighs 3.5 kg, which no robot carries | 14   | error
"squeeze: 0.03}, "         | "squeeze: 0.03}, mount: {xyz_m: [0, 0, 0], rpy_deg: [0, 90, 0]}, " | ""                                      | 0    | warning
"""),
)
def test_a_hand_that_does_not_fit_is_found(
    tmp_path: Path, old: str, new: str, words: str, line: str, level: str
) -> None:
    found = findings(tmp_path, (old, new))
    if not words:  # a tool across the flange is a tool like others
        assert not any("flange of arm" in message for message, _, _ in found)
        return
    assert any(
        words in message and (at, bad) == (int(line), level == "error")
        for message, at, bad in found
    ), found


def test_an_x_forward_flange_under_a_tool_is_found(tmp_path: Path) -> None:
    """The arm of a vendor of ROS-Industrial's: its link flange is asked for, tool0 is right."""
    mount = "squeeze: 0.03}, mount: {xyz_m: [0, 0, 0], rpy_deg: [0, 90, 0]}"
    turned = "squeeze: 0.03}", mount
    for flange, changes, doubtful in (
        ("flange", (), True),
        ("tool0", (), False),
        ("flange", (turned,), False),
    ):
        arm = f"{ur5e()}, flange: {flange}"
        words = [m for m, _, bad in findings(tmp_path, *changes, arm=arm) if not bad]
        assert any("x points out of the flange" in w for w in words) == doubtful


@pytest.mark.parametrize(
    ("frame", "doubtful"),
    [("[0, 0.07, 0.25]", False), ("[0, 0.2, 0.1]", True), ("[0, 0, 0.14]", False)],
)
def test_a_process_may_work_at_a_distance_in_front_of_its_tool(
    tmp_path: Path, frame: str, doubtful: bool
) -> None:
    """A camera's focus is far from everything; what is beside the tool is a slip of the pen."""
    look = "  processes: {look: {duration: {kind: fixed, value_s: 1}, frame: camera}}\n"
    camera = f"opening_m: 0.08, frames: {{camera: {{xyz_m: {frame}}}}}"
    steps = "  steps: [a]", f"{look}  steps: [a]"
    found = findings(tmp_path, ("opening_m: 0.08", camera), steps)
    assert any("'camera'" in message for message, _, _ in found) == doubtful, found


# What is written in place of what, the one thing found, and a piece of the line it is found at.
IN_MILLIMETRES = planted(r"""
mistake | old                         | new                                          | says                                         | at line
base    | [-0.6, 0, 0]                | [-600, 0, 0]                                 | left stands 599.8 m away from whatever is to be handled, and its arm is 0.99 m long: xyz_m is in metres; if these are millimetres, it is [-0.6, 0, 0] | ""
start   | [-0.2, -0.3, 0.0155]        | [-200, -300, 15.5]                           | if these are millimetres, it is [-0.2, -0.3, 0.0155] | ""
goal    | [0, 0.3, 0.1155]            | [0, 300, 115.5]                              | the place of a is 321.                       | ""
size    | "- name: a\n      size_m: [0.1, 0.03, 0.03]" | "- name: a\n      size_m: [100, 30, 30]" | a measures 100 x 30 x 30 m                   | size_m: [100, 30, 30]
frame   | base: {xyz_m: [-0.6, 0, 0]} | "base: {xyz_m: [-0.6, 0, 0]}\n      frames: {tool: {xyz_m: [0, 0, 103]}}" | frame tool of left is 103 m away from what it is on | frames: {tool: {xyz_m: [0, 0, 103]}}
""")


@pytest.mark.parametrize("key", IN_MILLIMETRES)
def test_a_length_in_millimetres_is_the_only_thing_found(
    key: str, tmp_path: Path
) -> None:
    old, new, words, line = IN_MILLIMETRES[key]
    file = written(tmp_path, CELL, (old, new))
    report, text = checked(file), file.read_text(encoding="utf-8")
    (found,) = report.findings
    assert found.error
    assert words in found.message
    place = text.splitlines()[report.problem(found).mark.line - 1]
    assert (line or new) in place


def gearbox(folder: Path, tool: str, key: str, pose: dict[str, list[float]]) -> Path:
    """Write the gearbox without its gears, and with another pose of one of its tools."""
    source = ROOT / "scenarios/assembly"
    content = yaml.safe_load((source / "gearbox.yaml").read_text(encoding="utf-8"))
    for each in content["cell"]["tools"].values():
        each["description"] = str(source / each["description"])
    content["cell"]["tools"][tool][key] |= pose
    assembly, gears = content["assembly"], ("gear_a", "gear_b")
    assembly["parts"] = [p for p in assembly["parts"] if p["name"] not in gears]
    assembly["steps"] = [step for step in assembly["steps"] if step not in gears]
    return written(folder, yaml.safe_dump(content))


def test_the_tcp_of_a_tool_in_millimetres(tmp_path: Path) -> None:
    file = gearbox(tmp_path, "gripper", "tcp", {"xyz_m": [0, 0, 145]})
    (found,) = checked(file).findings
    assert found.at == ("cell", "tools", "gripper", "tcp")
    assert "if these are millimetres, it is [0, 0, 0.145]" in found.message


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ([360, 470, 220], "driver lies"),
        ([1.9, 0.47, 0.22], "right cannot change driver at its rack"),
    ],
)
def test_a_rack_that_its_robot_does_not_reach(
    place: list[float], words: str, tmp_path: Path
) -> None:
    report = checked(gearbox(tmp_path, "driver", "rack", {"xyz_m": place}))
    (found,) = (item for item in report.errors if words in item.message)
    assert found.at == ("cell", "tools", "driver", "rack")


def tended(folder: Path, old: str, new: str) -> Path:
    """Write the tended machines with one text in place of another."""
    source = ROOT / "scenarios/assembly"
    text = (source / "machine_tending.yaml").read_text(encoding="utf-8")
    tool = "tools/gripper.urdf", str(source / "tools/gripper.urdf")
    return written(folder, text, tool, (old, new))


def test_what_is_wrong_with_every_product_is_said_once_at_its_source(
    tmp_path: Path,
) -> None:
    old, new = "xyz_m: [0.1, -0.45, 0.725]", "xyz_m: [100, -450, 725]"
    (found,) = checked(tended(tmp_path, old, new)).findings
    assert found.at == ("assembly", "sources", "blanks", "pose")
    assert "if these are millimetres, it is [0.1, -0.45, 0.725]" in found.message


def test_a_robot_that_cannot_drive_to_where_it_is_parked(tmp_path: Path) -> None:
    old, new = "at_m: [1.6, 0.1]", "at_m: [1600, 0.1]"
    file = tended(tmp_path, old, new)
    with pytest.raises(InvalidScenarioError) as caught:
        read_scenario(file)
    (found,) = caught.value.problems
    assert "1600 m is beyond the limits of base_x" in found.message
    assert "parked" in file.read_text().splitlines()[found.mark.line - 1]
