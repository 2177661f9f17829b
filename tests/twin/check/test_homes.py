"""Robots where they stand: a HOME that is named where nobody gives one, bases on what they stand on."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from planning.kinematics.kinematics import frame_pose
from tests.planning.robots.descriptions.vendors import ur5e
from tests.twin.check.test_check import CELL, checked, written


def vendors_arms(folder: Path, height: float, home: str) -> list[str]:
    """Return what is said of two arms of a vendor that gives no HOME, 1 m apart on a table."""
    arms = CELL.replace("model: panda", f"model: {ur5e()}{home}").replace(
        "xyz_m: [-0.6, 0, 0]", f"xyz_m: [-0.5, 0, {height}]"
    )
    file = written(folder, arms.replace("xyz_m: [0.6, 0, 0]", "xyz_m: [0.5, 0, 0]"))
    return [item.message for item in checked(file).findings]


def test_where_nobody_gives_a_home_a_free_one_is_named(tmp_path: Path) -> None:
    (found,) = (m for m in vendors_arms(tmp_path, 0, "") if "at HOME" in m)
    assert "its joints are at zero, as nobody gives it a HOME" in found
    home = re.search(r"home_deg: \[[-\d, ]+\]", found)
    assert home is not None
    again = vendors_arms(tmp_path, 0, f"\n      {home.group()}")
    assert not [message for message in again if "at HOME" in message]


def test_the_named_home_is_beside_the_places_of_parts(tmp_path: Path) -> None:
    # Straight in front of the arms.
    near = CELL.replace("[0, 0.3, 0.05]", "[0, 0.05, 0.05]")
    near = near.replace("[0, 0.3, 0.1155]", "[0, 0, 0.1155]")
    near = near.replace("[0, 0.4, 0.1155]", "[0, 0.1, 0.1155]")
    arms = near.replace("model: panda", f"model: {ur5e()}")
    messages = [item.message for item in checked(written(tmp_path, arms)).errors]
    home = re.search(r"home_deg: \[[-\d, ]+\] would be free$", messages[0])
    assert home is not None, messages
    key = home.group().removesuffix(" would be free")
    given = arms.replace(f"model: {ur5e()}", f"model: {ur5e()}\n      {key}")
    report = checked(written(tmp_path, given))
    assert not [item for item in report.findings if "at HOME" in item.message]
    assert report.subject.parts is not None
    for robot in report.subject.cell.robots:
        tool = frame_pose(robot, robot.home)[:2, 3]
        for goal in report.subject.parts.listed.goals.values():
            assert np.linalg.norm(tool - goal[:2, 3]) > 0.24


def test_a_base_drawn_as_balls_is_not_in_the_table_on_which_it_stands(
    tmp_path: Path,
) -> None:
    standing = vendors_arms(tmp_path, 0, "")
    assert not [message for message in standing if "deep in table" in message]
    sunk = vendors_arms(tmp_path, -0.02, "")
    (found,) = (message for message in sunk if "deep in table" in message)
    assert "the base of left is 20.0 mm deep in table" in found
