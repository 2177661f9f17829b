"""Candidate robots (by eq. 7) and skeletons (short before long) for placing a part (IV-D)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.skeletons import Skeleton, robots_of, skeletons
from planning.construction.world.building import Building

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
        problem: what is built by whom.
        bounds: who reaches what.
    """

    problem: ConstructionProblem
    bounds: ReachBounds

    def of(self, building: Building, part: Part) -> Iterator[Skeleton]:
        """Yield skeletons: robots by eq. 7, one before several."""
        for size in range(1, _GROUP + 1):
            for group in robot_groups(building, self.problem.team, size):
                for skeleton in skeletons(group):
                    if self._may_work(part, robots_of(skeleton)):
                        yield skeleton

    def alone(self, building: Building, part: Part) -> Iterator[Skeleton]:
        """Yield the skeletons of one robot by eq. 7."""
        for group in robot_groups(building, self.problem.team, 1):
            if self._may_work(part, group):
                yield from skeletons(group)

    def _may_work(self, part: Part, robots: tuple[str, ...]) -> bool:
        """Tell whether lower bounds leave robots any chance to place a part together."""
        if len(robots) == 1:
            return robots[0] in self.bounds.alone(part)
        return (
            bool(self.bounds.pick_grips(robots[0], part))
            and bool(self.bounds.place_grips(robots[-1], part))
            and all(self.bounds.can_hand_over(a, b, part) for a, b in pairwise(robots))
        )
