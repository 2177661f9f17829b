"""Duration models: distributions of how long skills take.

Imports planning.errors only; scenario, uncertainty and fit import it.
"""

from twin.durations.bounded import Fixed, Pert, Triangular, Uniform
from twin.durations.composed import Scaled, Shifted
from twin.durations.empirical import Empirical, packaged_timing, packaged_timings
from twin.durations.model import DurationModel
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds, to_nanoseconds
from twin.durations.normal import TruncatedNormal
from twin.durations.retries import Retries
from twin.durations.skewed import Exponential, Gamma, Lognormal, Weibull

__all__ = [
    "NANOSECONDS",
    "DurationModel",
    "Empirical",
    "Exponential",
    "Fixed",
    "Gamma",
    "Lognormal",
    "Nanoseconds",
    "Pert",
    "Retries",
    "Scaled",
    "Shifted",
    "Triangular",
    "TruncatedNormal",
    "Uniform",
    "Weibull",
    "packaged_timing",
    "packaged_timings",
    "to_nanoseconds",
]
