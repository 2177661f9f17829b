"""Candidate robots for placing a part, by eq. (7), one before several (Hartmann et al. IV-D3, V-A3).

A part is picked and placed once, and every robot of a group has it in hand once: so the robots
in the order in which they have it say all of a skeleton, the sequence of actions. The first one
picks, each hands over to the next, the last one places and retracts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise, permutations

from planning.construction.problem.problem import Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.world.building import Building

Skeleton = tuple[str, ...]
"""Robots in the order in which they have a part in hand."""

_GROUP = 2
"""Most robots that work on one part together: one that gives and one that takes."""


def robot_groups(
    building: Building, team: tuple[str, ...], size: int
) -> list[tuple[str, ...]]:
    """Return the groups of robots of a given size, the earliest free first (eq. 7)."""
    free = {name: building.world.free_from(name) for name in team}
    return sorted(
        set(combinations(team, size)),
        key=lambda g: (max(free[r] for r in g), [team.index(r) for r in g]),
    )


@dataclass(frozen=True)
class Candidates:
    """Candidate skeletons of a part: those that no lower bound rules out.

    Attributes:
        bounds: who reaches what.
    """

    bounds: ReachBounds

    def of(
        self, building: Building, part: Part, most: int = _GROUP
    ) -> Iterator[Skeleton]:
        """Yield the skeletons of at most so many robots, in order of preference."""
        for size in range(1, most + 1):
            for group in robot_groups(building, self.bounds.problem.team, size):
                for robots in permutations(group):
                    if self._may_work(part, robots):
                        yield robots

    def _may_work(self, part: Part, robots: Skeleton) -> bool:
        """Tell whether lower bounds leave robots any chance to place a part together."""
        if len(robots) == 1:
            return robots[0] in self.bounds.alone(part)
        return (
            bool(self.bounds.pick_grips(robots[0], part))
            and bool(self.bounds.place_grips(robots[-1], part))
            and all(self.bounds.can_hand_over(a, b, part) for a, b in pairwise(robots))
        )
