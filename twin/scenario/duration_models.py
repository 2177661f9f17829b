"""From the duration sections of a scenario to distributions that can be drawn from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planning.errors import TwinError
from twin.durations import (
    DurationModel,
    Empirical,
    Exponential,
    Fixed,
    Gamma,
    Lognormal,
    Pert,
    Retries,
    Scaled,
    Shifted,
    Triangular,
    TruncatedNormal,
    Uniform,
    Weibull,
    packaged_timing,
)
from twin.scenario.sections.durations import (
    AnyDuration,
    EmpiricalDuration,
    ExponentialDuration,
    FixedDuration,
    GammaDuration,
    LognormalDuration,
    NormalDuration,
    PackagedDuration,
    PertDuration,
    ReferenceDuration,
    RetriesDuration,
    ShiftedDuration,
    TriangularDuration,
    UniformDuration,
    WeibullDuration,
)
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.skill_durations import DurationOverride, SkillDurations


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
        DurationOverride(
            item.skill, duration_model(item.duration, folder), item.robot, item.object
        )
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
        skill: duration_model(section, folder)
        for skill, section in scenario.execution.skills.items()
        if not isinstance(section, ReferenceDuration)
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


def duration_model(section: AnyDuration, folder: Path) -> DurationModel:
    """Return the distribution of one section.

    Raises:
        ScenarioError: there is no such distribution, or a file cannot be read.
    """
    model = _unscaled(section, folder)
    return model if section.scale == 1.0 else Scaled(model, section.scale)


def _unscaled(section: AnyDuration, folder: Path) -> DurationModel:
    match section:
        case FixedDuration():
            return Fixed(section.value_s)
        case UniformDuration():
            return Uniform(section.low_s, section.high_s)
        case TriangularDuration():
            return Triangular(section.low_s, section.mode_s, section.high_s)
        case PertDuration():
            return Pert(section.low_s, section.mode_s, section.high_s)
        case NormalDuration():
            high = np.inf if section.high_s is None else section.high_s
            return TruncatedNormal(section.mean_s, section.sd_s, section.low_s, high)
        case LognormalDuration(median_s=float(median), p95_s=float(p95)):
            return Lognormal(median, p95)
        case LognormalDuration(mean_s=float(mean), cv=float(cv)):
            return Lognormal.from_mean(mean, cv)
        case ExponentialDuration():
            return Exponential(section.mean_s)
        case GammaDuration(shape=float(shape), scale_s=float(scale)):
            return Gamma(shape, scale)
        case GammaDuration(mean_s=float(mean), cv=float(cv)):
            return Gamma.from_mean(mean, cv)
        case WeibullDuration():
            return Weibull(section.shape, section.scale_s)
        case EmpiricalDuration():
            return Empirical.from_csv(folder / section.csv, section.column)
        case PackagedDuration():
            return packaged_timing(section.skill)
        case ShiftedDuration():
            return Shifted(duration_model(section.model, folder), section.offset_s)
        case RetriesDuration():
            return Retries(
                duration_model(section.attempt, folder),
                section.probability,
                section.retries,
                None
                if section.retry is None
                else duration_model(section.retry, folder),
            )
    raise TwinError(f"no distribution for {type(section).__name__}")
