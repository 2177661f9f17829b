"""Limits of the tool's speed in scenarios: kept to in plans within limits only."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from planning.errors import ScenarioError
from tests.shipped_runs import SCENARIOS
from twin.planning.build_workcell import build_workcell
from twin.scenario.manifest import load_scenario
from twin.scenario.variations import varied

CLIFF = SCENARIOS / "lego" / "cliff.yaml"


def test_they_reach_the_robots_that_they_are_given_for() -> None:
    scenario = load_scenario(CLIFF)
    first, second = (robot.name for robot in scenario.cell.robots)
    limited = varied(
        scenario,
        {
            "planning.speed_model": "limits",
            f"cell.robots.{first}.limits.tool_speed_m_s": 0.5,
            f"cell.robots.{second}.limits.loaded_tool_speed_m_s": 0.25,
        },
    )
    found = [robot.limits for robot in build_workcell(limited, CLIFF.parent).robots]
    speeds = [(own.tool_speed, own.loaded_tool_speed) for own in found if own]
    assert speeds == [(0.5, np.inf), (np.inf, 0.25)]


def test_they_are_refused_with_another_speed_model(tmp_path: Path) -> None:
    text = CLIFF.read_text(encoding="utf-8")
    name = load_scenario(CLIFF).cell.robots[0].name
    given = f"- name: {name}\n      limits: {{tool_speed_m_s: 0.5}}\n"
    path = tmp_path / "cliff.yaml"
    path.write_text(text.replace(f"- name: {name}\n", given))
    with pytest.raises(ScenarioError, match=r"speed_model: limits.*'l1'"):
        load_scenario(path)
