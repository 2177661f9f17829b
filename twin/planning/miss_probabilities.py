"""Probabilities that robots miss the goal poses of objects, computed from the robots' repeatability."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from twin.planning.build_workcell import build_workcell
from twin.scenario.sections.scenario import Scenario


def miss_probabilities(scenario: Scenario, folder: Path) -> Mapping[str, float]:
    """Return the probability of missing a place, by ROBOT/OBJECT, for robots with a repeatability.

    Args:
        scenario: a validated scenario.
        folder: base folder of relative paths in the scenario.
    """
    robots = scenario.cell.robots
    if not any(robot.repeatability_m for robot in robots):
        return {}
    return scenario.kind.miss_probabilities(build_workcell(scenario, folder), robots)
