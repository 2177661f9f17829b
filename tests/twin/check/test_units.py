"""Lengths in millimetres where metres are asked for: the key is named, and what it is in metres."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from tests.planted import planted
from tests.twin.check.test_check import CELL, ROOT, checked, written

# What is written in place of what, the one thing found, and a piece of the line it is found at.
IN_MILLIMETRES = planted(r"""
mistake | old                         | new                                          | says                                         | at line
base    | [-0.6, 0, 0]                | [-600, 0, 0]                                 | left stands 599.8 m away from whatever is to be handled, and its arm is 0.99 m long: xyz_m is in metres; if these are millimetres, it is [-0.6, 0, 0] | ""
start   | [-0.2, -0.3, 0.0155]        | [-200, -300, 15.5]                           | if these are millimetres, it is [-0.2, -0.3, 0.0155] | ""
goal    | [0, 0.3, 0.1155]            | [0, 300, 115.5]                              | the place of a is 321.                       | ""
size    | [0.1, 0.03, 0.03]           | [100, 30, 30]                                | a measures 100 x 30 x 30 m                   | size_m: [100, 30, 30]
frame   | base: {xyz_m: [-0.6, 0, 0]} | "base: {xyz_m: [-0.6, 0, 0]}\n      frames: {tool: {xyz_m: [0, 0, 103]}}" | frame tool of left is 103 m away from what it is on | frames: {tool: {xyz_m: [0, 0, 103]}}
""")


@pytest.mark.parametrize("key", IN_MILLIMETRES)
def test_a_length_in_millimetres_is_the_only_thing_found(
    key: str, tmp_path: Path
) -> None:
    old, new, words, line = IN_MILLIMETRES[key]
    text = CELL.replace(old, new, 1)
    assert text != CELL
    report = checked(written(tmp_path, text))
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
    assert old in text
    text = text.replace("tools/gripper.urdf", str(source / "tools/gripper.urdf"))
    return written(folder, text.replace(old, new))


def test_what_is_wrong_with_every_product_is_said_once_at_its_source(
    tmp_path: Path,
) -> None:
    old, new = "xyz_m: [0.1, -0.45, 0.725]", "xyz_m: [100, -450, 725]"
    (found,) = checked(tended(tmp_path, old, new)).findings
    assert found.at == ("assembly", "sources", "blanks", "pose")
    assert "if these are millimetres, it is [0.1, -0.45, 0.725]" in found.message


def test_a_robot_that_cannot_drive_to_where_it_is_parked(tmp_path: Path) -> None:
    old, new = "at_m: [1.6, 0.1]", "at_m: [1600, 0.1]"
    (found,) = checked(tended(tmp_path, old, new)).errors
    assert "HOME of cart: joint base_x is at 1600.000" in found.message
    assert found.at == ("cell", "robots", 1, "parked")
