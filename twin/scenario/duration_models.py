"""Duration models of a scenario's skills, with its files of measured times read."""

from __future__ import annotations

from pathlib import Path

from twin.durations import DurationModel
from twin.scenario.sections.execution import ReferenceDuration
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.skill_durations import SkillDurations


def skill_durations(
    scenario: Scenario, folder: Path = Path(), *, antithetic: bool = False
) -> SkillDurations:
    """Return the durations of all skills, with the exceptions for robots and objects.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.
        antithetic: draw replications in mirrored pairs, see SkillDurations.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    overrides = tuple(
        item.model_copy(update={"duration": item.duration.located(folder)})
        for item in scenario.execution.skill_overrides
    )
    return SkillDurations(skill_models(scenario, folder), overrides, antithetic)


def skill_models(scenario: Scenario, folder: Path = Path()) -> dict[str, DurationModel]:
    """Return the duration model of every skill, without exceptions.

    Skills that take as long as their reference path have none.

    Args:
        scenario: a checked scenario.
        folder: where relative paths in it start, that of its file.

    Raises:
        ScenarioError: a file of measured times cannot be read.
    """
    return {
        skill: duration.located(folder)
        for skill, duration in scenario.execution.skills.items()
        if isinstance(duration, DurationModel)
    }


def follow_references(scenario: Scenario) -> Scenario:
    """Return a scenario in which every skill takes as long as its reference path.

    That is how APEX-MR V-A executes skills in simulation: without force control, the same each time.
    """
    skills = dict.fromkeys(
        scenario.execution.skills, ReferenceDuration(kind="reference")
    )
    execution = scenario.execution.model_copy(
        update={"skills": skills, "skill_overrides": ()}
    )
    return scenario.model_copy(update={"execution": execution})
