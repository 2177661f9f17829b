"""How long skills take: duration models, and the durations they give the nodes of a TPG."""

from twin.durations.bounded import Fixed, Pert, Triangular, Uniform
from twin.durations.composed import Scaled, Shifted
from twin.durations.empirical import Empirical, packaged_timing, packaged_timings
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.durations.normal import TruncatedNormal
from twin.durations.retries import Retries
from twin.durations.skewed import Exponential, Gamma, Lognormal, Weibull
from twin.durations.skill_durations import (
    DurationOverride,
    NodeDurations,
    SkillDurations,
    nominal_durations,
    total_duration_s,
)

__all__ = [
    "NANOSECONDS",
    "DurationModel",
    "DurationOverride",
    "Empirical",
    "Exponential",
    "Fixed",
    "Gamma",
    "Lognormal",
    "Nanoseconds",
    "NodeDurations",
    "Pert",
    "Retries",
    "Scaled",
    "Shifted",
    "SkillDurations",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "nominal_durations",
    "packaged_timing",
    "packaged_timings",
    "to_nanoseconds",
    "total_duration_s",
]
