"""Tool frames: those of packaged robots are at their tools, an X-forward flange is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planning.robots.registry import ROBOTS, robot_model
from planning.transforms import from_rpy
from twin.check.tools import misplaced

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


def test_a_frame_too_far_from_the_tool_is_found() -> None:
    pose = from_rpy((0.0, 0.0, 0.2), (0.0, 0.0, 0.0))
    (words,) = misplaced(robot_model("panda"), pose)
    assert "mm away from the tool" in words
