"""From the duration sections of a scenario to distributions that can be drawn from."""

from __future__ import annotations

from pathlib import Path

from twin.durations import (
    DurationModel,
    Empirical,
    Fixed,
    Lognormal,
    Uniform,
    packaged_timings,
)
from twin.scenario import Scenario
from twin.scenario_durations import (
    DurationSection,
    EmpiricalDuration,
    FixedDuration,
    UniformDuration,
)


def skill_models(scenario: Scenario, folder: Path = Path()) -> dict[str, DurationModel]:
    """Return the duration model of every skill; packaged timings where none is given.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    own: dict[str, DurationModel] = {
        skill: duration_model(section, folder)
        for skill, section in scenario.execution.skills.items()
    }
    return {**packaged_timings(), **own}


def duration_model(section: DurationSection, folder: Path) -> DurationModel:
    """Return the distribution of one section."""
    if isinstance(section, FixedDuration):
        return Fixed(section.value_s)
    if isinstance(section, UniformDuration):
        return Uniform(section.low_s, section.high_s)
    if isinstance(section, EmpiricalDuration):
        return Empirical.from_csv(folder / section.csv, section.column)
    return Lognormal(section.median_s, section.p95_s)
