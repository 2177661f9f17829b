"""Distributions by their parameters, and the same ones of scipy."""

from typing import Any

import numpy as np
from scipy import stats

from twin.durations.bounded import Pert, Triangular, Uniform
from twin.durations.lifetimes import Exponential, Gamma, Weibull
from twin.durations.lognormal import Lognormal
from twin.durations.normal import TruncatedNormal
from twin.fit.shifted import Family, ShiftedFamily

Frozen = Any
"""A distribution of SciPy with its parameters; SciPy has no public name for the type."""

KNOWN: list[tuple[Family, list[float], Frozen]] = [
    (Uniform, [2, 5], stats.uniform(2, 3)),
    (Triangular, [2, 3, 7], stats.triang(0.2, 2, 5)),
    (Triangular, [2, 2, 7], stats.triang(0, 2, 5)),
    (Triangular, [2, 7, 7], stats.triang(1, 2, 5)),
    (Pert, [2, 3, 7], stats.beta(1.8, 4.2, 2, 5)),
    (Pert, [2, 7, 7], stats.beta(5, 1, 2, 5)),
    (TruncatedNormal, [8, 1], stats.norm(8, 1)),
    (TruncatedNormal, [1, 2], stats.truncnorm(-0.5, np.inf, 1, 2)),
    (TruncatedNormal, [-2, 2], stats.truncnorm(1, np.inf, -2, 2)),
    (Exponential, [3], stats.expon(0, 3)),
    (Lognormal, [1.5, 0.4], stats.lognorm(0.4, 0, np.exp(1.5))),
    (Gamma, [3.5, 2], stats.gamma(3.5, 0, 2)),
    (Weibull, [2.5, 4], stats.weibull_min(2.5, 0, 4)),
    (ShiftedFamily(Gamma), [4, 3.5, 2], stats.gamma(3.5, 4, 2)),
    (ShiftedFamily(Weibull), [4, 1.5, 2], stats.weibull_min(1.5, 4, 2)),
    (ShiftedFamily(Exponential), [4, 2], stats.expon(4, 2)),
    (
        ShiftedFamily(Lognormal),
        [4, 0.5, 0.4],
        stats.lognorm(0.4, 4, np.exp(0.5)),
    ),
]
