"""Tool frames: those of packaged robots are at their tools, an X-forward flange is not.

Tools of cells: fingers that are where they say, parts that they can hold and carry.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planning.robots.descriptions.fitting import Fitting
from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import from_rpy
from tests.planning.robots.descriptions.vendors import GRIPPER, ur5e
from tests.planted import rows
from twin.check.check import check_scenario
from twin.check.tools import misplaced
from twin.scenario.manifest import read_scenario

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
    assert list(misplaced(model, model.frames["tool"])) == []


def test_a_flange_with_z_forward_is_right(tmp_path: Path) -> None:
    model = robot_model(str(arm(tmp_path, "0 0 0")))
    assert list(misplaced(model, np.eye(4))) == []


def test_a_flange_with_x_forward_is_found(tmp_path: Path) -> None:
    """As on ROS-Industrial robots, whose link ``flange`` has x out of the arm."""
    model = robot_model(str(arm(tmp_path, "0 -1.5708 -1.5708")))
    (words,) = misplaced(model, np.eye(4))
    assert "does not point out of the tool: 30" in words
    turned = from_rpy((0.0, 0.0, 0.0), (0.0, np.pi / 2, 0.0))
    assert list(misplaced(model, turned)) == []


def test_a_frame_at_the_mount_of_a_gripper_is_found() -> None:
    (words,) = misplaced(robot_model("panda"), np.eye(4))
    assert "lies behind the tool" in words


def test_a_frame_between_wide_open_fingers_is_at_the_tool() -> None:
    """The fingers belong to the arm's description: how far they open, nobody says."""
    data = pytest.importorskip("pybullet_data")
    file = str(Path(data.getDataPath(), "franka_panda", "panda.urdf"))
    wide = {"panda_finger_joint1": 0.035, "panda_finger_joint2": 0.035}
    model = robot_model(file, None, Fitting(held=wide, flange="panda_link8"))
    between = from_rpy((0.0, 0.0, 0.105), (0.0, 0.0, -np.pi / 4))
    assert list(misplaced(model, between)) == []
    assert list(misplaced(model, between @ from_rpy((0, 0, 0.05), (0, 0, 0))))


def test_a_frame_too_far_from_the_tool_is_found() -> None:
    pose = from_rpy((0.0, 0.0, 0.2), (0.0, 0.0, 0.0))
    (words,) = misplaced(robot_model("panda"), pose)
    assert "mm away from the tool" in words


CELL = """\
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


def findings(folder: Path, old: str, new: str) -> list[tuple[str, int, bool]]:
    """Return what is found in the cell with something else in it: words, line, whether an error."""
    assert old in CELL
    (folder / "hand.urdf").write_text(GRIPPER)
    file = folder / "cell.yaml"
    file.write_text(CELL.replace(old, new, 1).replace("ARM", "ur5e"))
    report = check_scenario(*read_scenario(file), folder)
    return [
        (item.message, report.problem(item).mark.line, item.error)
        for item in report.findings
    ]


def test_a_sound_hand_passes(tmp_path: Path) -> None:
    assert findings(tmp_path, "version: 1", "version: 1") == []


@pytest.mark.parametrize(
    ("opening", "said"), [("0.059", 0), ("0.0581", 0), ("0.0575", 1), ("0.05", 1)]
)
def test_fingers_may_be_drawn_a_little_wider_than_they_open(
    tmp_path: Path, opening: str, said: int
) -> None:
    """Each by a millimetre, as a vendor's are that open to 85 mm and are drawn 86 mm apart."""
    found = findings(tmp_path, "opening_m: 0.08", f"opening_m: {opening}")
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
    found = findings(tmp_path, old, new)
    if not words:  # a tool across the flange is a tool like others
        assert not any("flange of arm" in message for message, _, _ in found)
        return
    assert any(
        words in message and (at, bad) == (int(line), level == "error")
        for message, at, bad in found
    ), found


def test_an_x_forward_flange_under_a_tool_is_found(tmp_path: Path) -> None:
    """The arm of a vendor of ROS-Industrial's: its link flange is asked for, tool0 is right."""
    vendor = str(ur5e())
    for flange, doubtful in (("flange", True), ("tool0", False)):
        text = CELL.replace("ARM", f"{vendor}, flange: {flange}")
        file = tmp_path / "cell.yaml"
        (tmp_path / "hand.urdf").write_text(GRIPPER)
        file.write_text(text)
        report = check_scenario(*read_scenario(file), tmp_path)
        words = [item.message for item in report.findings if not item.error]
        assert any("x points out of the flange" in w for w in words) == doubtful
    turned = "squeeze: 0.03}, mount: {xyz_m: [0, 0, 0], rpy_deg: [0, 90, 0]}"
    text = text.replace("flange: tool0", "flange: flange")
    file.write_text(text.replace("squeeze: 0.03}", turned))
    report = check_scenario(*read_scenario(file), tmp_path)
    assert not any(
        "points out of the flange" in item.message for item in report.findings
    )


@pytest.mark.parametrize(
    ("frame", "doubtful"),
    [("[0, 0.07, 0.25]", False), ("[0, 0.2, 0.1]", True), ("[0, 0, 0.14]", False)],
)
def test_a_process_may_work_at_a_distance_in_front_of_its_tool(
    tmp_path: Path, frame: str, doubtful: bool
) -> None:
    """A camera's focus is far from everything; what is beside the tool is a slip of the pen."""
    file = tmp_path / "cell.yaml"
    (tmp_path / "hand.urdf").write_text(GRIPPER)
    look = "  processes: {look: {duration: {kind: fixed, value_s: 1}, frame: camera}}\n"
    text = CELL.replace("ARM", "ur5e").replace(
        "opening_m: 0.08", f"opening_m: 0.08, frames: {{camera: {{xyz_m: {frame}}}}}"
    )
    text = text.replace("  steps: [a]", f"{look}  steps: [a]")
    file.write_text(text)
    report = check_scenario(*read_scenario(file), tmp_path)
    found = [m for m in (item.message for item in report.findings) if "'camera'" in m]
    assert bool(found) == doubtful, found
