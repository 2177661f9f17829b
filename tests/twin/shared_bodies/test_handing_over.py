"""A part that one arm of the shipped torso picks and only the other can place."""

import shutil
from pathlib import Path

import pytest
import yaml

from tests.shipped_runs import SCENARIOS
from tests.twin.scenarios.executed import built

FOLDER = SCENARIOS / "multi_arm"
BAR = {
    "name": "bar",
    "size_m": [0.04, 0.2, 0.04],
    "start": {"xyz_m": [0.35, 0.78, 0.77]},
    "goal": {"xyz_m": [0.35, -0.78, 0.77]},
    "mass_kg": 0.1,
}


@pytest.mark.nightly
def test_arms_of_one_body_hand_a_part_over_in_front_of_it(tmp_path: Path) -> None:
    shutil.copy(FOLDER / "torso.urdf", tmp_path)
    cell = yaml.safe_load((FOLDER / "torso.yaml").read_text(encoding="utf-8"))
    cell["cell"]["fixtures"][0]["size_m"][1] = 2.0
    cell["assembly"] |= {"parts": [BAR], "steps": ["bar"]}
    planned = built(tmp_path, yaml.safe_dump(cell))
    kinds = {task.kind for task in planned.tpg.tasks}
    assert "handover" in kinds
