"""Distributions of skill durations: one class each, with its section, quantiles and fit.

Imports planning and the base of scenario sections; scenario, uncertainty and fit import it.
"""

from twin.durations.bounded import Fixed, Pert, Triangular, Uniform
from twin.durations.lifetimes import (
    AnyDuration,
    Distribution,
    Exponential,
    Gamma,
    Retries,
    Shifted,
    SkillOverride,
    Weibull,
)
from twin.durations.measured import Empirical, Measured, Packaged, packaged_timings
from twin.durations.model import (
    NANOSECONDS,
    DurationModel,
    Nanoseconds,
    PackagedSkill,
    Skill,
    to_nanoseconds,
)
from twin.durations.normal import Lognormal, TruncatedNormal

__all__ = [
    "NANOSECONDS",
    "AnyDuration",
    "Distribution",
    "DurationModel",
    "Empirical",
    "Exponential",
    "Fixed",
    "Gamma",
    "Lognormal",
    "Measured",
    "Nanoseconds",
    "Packaged",
    "PackagedSkill",
    "Pert",
    "Retries",
    "Shifted",
    "Skill",
    "SkillOverride",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "packaged_timings",
    "to_nanoseconds",
]
