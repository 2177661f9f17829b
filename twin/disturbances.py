"""Disturbances of a run: robots that stall before they move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.errors import ScenarioError
from planning.transforms import Array
from scheduling.temporal_plan_graph import TemporalPlanGraph
from twin.draws import uniforms
from twin.durations import Nanoseconds, to_nanoseconds


@dataclass(frozen=True)
class RandomStalls:
    """Every robot stalls at a number of its nodes, after it started them and before it moves.

    Attributes:
        count_per_robot: nodes that stall, all of a robot's nodes where it has fewer.
        duration_s: shortest and longest stall, uniform between them [s].
    """

    count_per_robot: int
    duration_s: tuple[float, float] = (1.0, 20.0)

    def __post_init__(self) -> None:
        low, high = self.duration_s
        if self.count_per_robot < 0 or not 0 <= low <= high < np.inf:
            raise ScenarioError(
                "stalls: need count_per_robot >= 0 and 0 <= shortest <= longest "
                f"duration_s, not {self.count_per_robot} and [{low}, {high}]"
            )

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return the stall before each node moves, per chain, each of shape (nodes,) [ns]."""
        low, high = self.duration_s
        stalls = []
        for chain in tpg.chains:
            count = min(self.count_per_robot, len(chain))
            place = _draw(seed, replication, chain.robot, "stall-node", count)
            u = _draw(seed, replication, chain.robot, "stall", count)
            out = np.zeros(len(chain), dtype=np.int64)
            out[_choose(len(chain), place)] = to_nanoseconds(low + u * (high - low))
            stalls.append(out)
        return tuple(stalls)


def _draw(seed: int, replication: int, robot: str, purpose: str, count: int) -> Array:
    return uniforms(
        seed,
        replication,
        [robot] * count,
        [-1] * count,
        [""] * count,
        purpose,
        range(count),
    )


def _choose(n: int, u: Array) -> list[int]:
    """Return ``len(u)`` distinct numbers below n, every choice equally likely.

    Floyd's algorithm: one uniform a number, none redrawn.
    """
    chosen: dict[int, None] = {}
    for k, value in enumerate(u.tolist()):
        last = n - len(u) + k
        pick = min(int(value * (last + 1)), last)
        chosen[last if pick in chosen else pick] = None
    return list(chosen)
