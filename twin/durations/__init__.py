"""How long skills take: duration models, and the durations they give the nodes of a TPG."""

from twin.durations.bounded import Fixed, Uniform
from twin.durations.empirical import Empirical, packaged_timings
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.durations.skewed import Lognormal
from twin.durations.skill_durations import (
    NodeDurations,
    SkillDurations,
    nominal_durations,
    total_duration_s,
)

__all__ = [
    "NANOSECONDS",
    "DurationModel",
    "Empirical",
    "Fixed",
    "Lognormal",
    "Nanoseconds",
    "NodeDurations",
    "SkillDurations",
    "Uniform",
    "nominal_durations",
    "packaged_timings",
    "to_nanoseconds",
    "total_duration_s",
]
