"""Distributions of skill durations: one class each, with its section, quantiles and fit.

Imports planning and the base of scenario sections; scenario, uncertainty and fit import it.
"""

from twin.durations.composed import AnyDuration, Distribution, Retries, Shifted
from twin.durations.exponential import Exponential
from twin.durations.fixed import Fixed
from twin.durations.gamma import Gamma
from twin.durations.lognormal import Lognormal
from twin.durations.measured import Empirical, Measured, Packaged, packaged_timings
from twin.durations.model import DurationModel, Skill
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.durations.normal import TruncatedNormal
from twin.durations.peaked import Pert, Triangular
from twin.durations.uniform import Uniform
from twin.durations.weibull import Weibull

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
    "Pert",
    "Retries",
    "Shifted",
    "Skill",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "packaged_timings",
    "to_nanoseconds",
]
