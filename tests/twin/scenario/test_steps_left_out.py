"""Assemblies whose order is found do not have to say what their steps are."""

from __future__ import annotations

from pathlib import Path

import pytest

from planning.errors import TwinError
from twin.scenario.manifest import read_scenario
from twin.scenario.sections.parts import PartsSection

FILE = """\
version: 1
name: all
cell:
  robots:
    - {name: arm, model: ur5e, base: {xyz_m: [0, 0, 0]}}
assembly:
  kind: assembly
  ORDER
  parts:
    - {name: a, size_m: [0.04, 0.04, 0.04], start: {xyz_m: [0.5, 0, 0.02]}, goal: {xyz_m: [0, 0.5, 0.02]}}
    - {name: stays, size_m: [0.04, 0.04, 0.04], start: {xyz_m: [0.5, 0.2, 0.02]}}
    - {name: b, size_m: [0.04, 0.04, 0.04], start: {xyz_m: [0.4, 0, 0.02]}, goal: {xyz_m: [0, 0.5, 0.06]}}
"""


def _read(folder: Path, text: str) -> PartsSection:
    file = folder / "all.yaml"
    file.write_text(text)
    section = read_scenario(file)[0].assembly
    assert isinstance(section, PartsSection)
    return section


def test_all_parts_with_a_goal_are_put_in_place(tmp_path: Path) -> None:
    assert _read(tmp_path, FILE.replace("ORDER", "order: find")).placed == ("a", "b")


def test_an_order_that_is_not_found_has_to_be_given(tmp_path: Path) -> None:
    with pytest.raises(TwinError, match=r"'steps' is missing: .* 'order: find'"):
        _read(tmp_path, FILE.replace("ORDER", "order: listed"))


def test_something_has_to_be_put_in_place(tmp_path: Path) -> None:
    text = FILE.replace("ORDER", "order: find").replace("goal:", "start:")
    none = "\n".join(line for line in text.splitlines() if "start:" not in line)
    stays = "    - {name: c, size_m: [0.1, 0.1, 0.1], start: {xyz_m: [0.5, 0, 0.05]}}\n"
    with pytest.raises(TwinError, match="no part has a 'goal'"):
        _read(tmp_path, none + "\n" + stays)
