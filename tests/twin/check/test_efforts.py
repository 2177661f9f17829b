"""``twin check`` of efforts: arms that could not hold themselves, or what they place."""

from __future__ import annotations

from pathlib import Path

import pytest

import twin
from tests.shipped_runs import SCENARIOS

TRAY = SCENARIOS / "multi_arm" / "tray.yaml"


def warnings(text: str, folder: Path) -> list[str]:
    path = folder / "tray.yaml"
    path.write_text(text)
    return list(twin.check(path).warnings)


@pytest.mark.parametrize("effort", [87.0, 1.0])
def test_an_arm_that_cannot_hold_itself_is_named(effort: float, tmp_path: Path) -> None:
    text = TRAY.read_text(encoding="utf-8")
    left = "{name: left, model: panda,"
    text = text.replace(left, f"{left} limits: {{effort: {effort}}},")
    found = warnings(text, tmp_path)
    if effort > 1.0:
        assert found == []
    else:
        (words,) = found
        assert "efforts of left (panda-fitted) are not kept to: panda_joint2" in words
        assert "hold the arm at HOME: that takes 2.72 N m" in words


def test_a_part_that_cannot_be_held_is_named(tmp_path: Path) -> None:
    text = TRAY.read_text(encoding="utf-8")
    left = "{name: left, model: panda,"
    text = text.replace(left, f"{left} limits: {{effort: 22, payload_kg: 9}},")
    text = text.replace("mass_kg: 0.3", "mass_kg: 6")
    (words,) = warnings(text, tmp_path)
    assert "left cannot hold" in words
    assert "(6 kg) at HOME: panda_joint4 would have to exert" in words
