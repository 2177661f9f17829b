"""Sobol indices: the share of each input in the variance of the mean makespan."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from planning.errors import RequestError
from planning.transforms import Array
from twin.host.progress import Report, report_nothing
from twin.study.replications.experiment import Block
from twin.study.replications.workload import Workload
from twin.study.sensitivity.inputs import inputs_of
from twin.study.sensitivity.tornado import SHARE, makespans_s

SENSITIVITY = "Sobol indices"
"""Name of the stage for progress displays."""

REPLICATIONS = 50
"""Of each combination of inputs; all of them see the same draws."""


@dataclass(frozen=True)
class SobolIndex:
    """The share of an input in the variance of the mean makespan.

    Attributes:
        name: of the input, in words.
        first: what varying it alone explains.
        total: what varying it explains alone and together with others.
    """

    name: str
    first: float
    total: float


def check_points(points: int) -> None:
    """Refuse a number of points that is no power of 2 greater than 1, with a RequestError."""
    if points < 2 or points & (points - 1):
        raise RequestError(
            f"Sobol indices need a power of 2 of points, not {points}",
            choices=("64", "128", "256", "512"),
        )


def sobol_indices(
    load: Workload,
    points: int,
    *,
    seed: int = 0,
    progress: Report = report_nothing,
) -> list[SobolIndex]:
    """Return the Sobol indices of all inputs, the greatest total first.

    Every input is multiplied by a factor between 1 - SHARE and 1 + SHARE, evenly spread (Saltelli
    et al. 2010, as scipy has it).

    Args:
        load: the work of one cell.
        points: of the quasi-random sample, a power of 2; the plan is replicated with
            points x (inputs + 2) combinations.
        seed: of the scrambling of the sample.
        progress: told of combinations done and in all.

    Raises:
        RequestError: points is no power of 2 greater than 1.
    """
    check_points(points)
    inputs = inputs_of(load)
    block = Block(0, 0, REPLICATIONS)
    total = points * (len(inputs) + 2)
    done = 0

    def mean_makespans(factors: Array) -> Array:
        nonlocal done
        found = np.empty(factors.shape[1])
        for column, point in enumerate(factors.T.tolist()):
            changed = load
            for one, factor in zip(inputs, point, strict=True):
                changed = one.times(changed, factor)
            found[column] = np.nanmean(makespans_s(changed, block))
            done += 1
            progress(SENSITIVITY, done, total)
        return found

    spread: Any = stats.uniform(loc=1 - SHARE, scale=2 * SHARE)
    indices = stats.sobol_indices(
        func=mean_makespans, n=points, dists=[spread] * len(inputs), rng=seed
    )
    found = [
        SobolIndex(one.name, float(first), float(total_index))
        for one, first, total_index in zip(
            inputs, indices.first_order, indices.total_order, strict=True
        )
    ]
    return sorted(found, key=lambda one: -one.total)
