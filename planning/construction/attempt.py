"""What one attempt at a part is: who does what, and how hard it is tried."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.construction.problem.problem import Part
from planning.construction.skeletons import Skeleton, robots_of


@dataclass(frozen=True)
class Attempt:
    """One attempt to bring a part to its place.

    Attributes:
        part: what is placed; it is placeable.
        skeleton: who does what.
        seed: of all random numbers.
        effort: how much harder than usual is tried.
        hasty: nothing is tried hard.
        latest: the part must be in its place by then [s].
        lost: a way with which robots lose as much time as that is of no use [s].
    """

    part: Part
    skeleton: Skeleton
    seed: Sequence[int]
    effort: int = 0
    hasty: bool = False
    latest: float = np.inf
    lost: float = np.inf

    @property
    def robots(self) -> tuple[str, ...]:
        """Who acts, in order of first appearance."""
        return robots_of(self.skeleton)
