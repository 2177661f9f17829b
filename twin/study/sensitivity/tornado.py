"""Tornado analysis: the mean makespan when one input at a time is smaller or larger."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array
from twin.study.replications.experiment import Block
from twin.study.replications.statistics import paired_difference
from twin.study.replications.workload import Engines, Workload
from twin.study.sensitivity.inputs import inputs_of

SHARE = 0.2
"""Every input is made this much smaller and larger."""

REPLICATIONS = 200
"""Of each input and direction, with the same draws as the first ones of the study."""


@dataclass(frozen=True)
class Influence:
    """Effect of an input on the mean makespan.

    Attributes:
        name: of the input, in words.
        less_s: change of the mean makespan when the input is smaller [s].
        more_s: the same when it is larger [s].
    """

    name: str
    less_s: float
    more_s: float

    @property
    def span_s(self) -> float:
        """Length of the bar in the chart [s]."""
        return abs(self.more_s - self.less_s)


def influences(
    load: Workload,
    *,
    share: float = SHARE,
    replications: int = REPLICATIONS,
) -> list[Influence]:
    """Return the effects of the inputs on the mean makespan, the strongest first.

    What the inputs are is in ``inputs_of``.

    Args:
        load: the work of one cell.
        share: how much smaller and larger.
        replications: of every input and direction, all with the same draws.
    """
    block = Block(0, 0, replications if not load.reasons else min(replications, 30))
    base = makespans_s(load, block)
    found = []
    for one in inputs_of(load):
        less, more = (
            _difference(makespans_s(one.times(load, factor), block), base)
            for factor in (1 - share, 1 + share)
        )
        found.append(Influence(one.name, less, more))
    return sorted(found, key=lambda one: -one.span_s)


def makespans_s(load: Workload, block: Block) -> Array:
    """Return the makespans of some replications, NaN where one did not complete [s]."""
    return Engines(load).compute(block).rows.makespans_s()


def _difference(values: Array, base: Array) -> float:
    both = np.isfinite(values) & np.isfinite(base)
    if not np.any(both):
        return 0.0
    return paired_difference(values[both], base[both]).estimate
