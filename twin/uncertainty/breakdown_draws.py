"""Draws of the times between failures by the clock, and of the times to repair."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count

import numpy as np

from twin.durations.nanoseconds import to_nanoseconds
from twin.uncertainty.disturbances import MachineBreakdowns
from twin.uncertainty.draws import uniforms

_CHUNK = 16
"""Breakdowns drawn together."""


def breakdown_times(
    breakdowns: MachineBreakdowns, name: tuple[int, int, str]
) -> Iterator[tuple[int, int]]:
    """Yield the time to each failure, from the end of the repair before it, and its time to repair [ns].

    Args:
        breakdowns: their distributions.
        name: seed, replication and robot, which name the draws.
    """
    seed, replication, robot = name
    names = (seed, [replication], [robot] * _CHUNK, -1, [""] * _CHUNK)
    for first in count(0, _CHUNK):
        index = np.arange(first, first + _CHUNK)
        gap = uniforms(*names, "breakdown-gap", index)[:, 0]
        repair = uniforms(*names, "breakdown-duration", index)[:, 0]
        # 1 - u: exponential times are -log(u) then.
        up = to_nanoseconds(breakdowns.between.ppf(1.0 - gap)).tolist()
        down = to_nanoseconds(breakdowns.repair.ppf(1.0 - repair)).tolist()
        yield from zip(up, down, strict=True)
