"""Who may place a part, and how: robots by eq. 7, sequences of actions breadth first (IV-D)."""

from __future__ import annotations

from collections.abc import Iterator
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
    """Return the groups of a size, those first that are free earliest (eq. 7)."""
    free = {name: building.world.free_from(name) for name in team}
    groups = set(combinations(team, size))
    return sorted(
        groups,
        key=lambda g: (max(free[r] for r in g), [team.index(r) for r in g]),
    )


class Candidates:
    """Sequences of actions that lower bounds leave a chance.

    Args:
        problem: what is built by whom.
        bounds: who reaches what.
    """

    def __init__(self, problem: ConstructionProblem, bounds: ReachBounds) -> None:
        self.problem = problem
        self.bounds = bounds

    def of(self, building: Building, part: Part) -> Iterator[Skeleton]:
        """Yield sequences of actions: robots by eq. 7, one before several, short before long."""
        for size in range(1, _GROUP + 1):
            for group in robot_groups(building, self.problem.team, size):
                for skeleton in skeletons(group):
                    if self._may_work(part, skeleton):
                        yield skeleton

    def alone(self, building: Building, part: Part) -> Iterator[tuple[str, Skeleton]]:
        """Yield who may do it alone, and how, by eq. 7."""
        for skeleton in self.of(building, part):
            robots = robots_of(skeleton)
            if len(robots) > 1:
                return
            yield robots[0], skeleton

    def _may_work(self, part: Part, skeleton: Skeleton) -> bool:
        """Tell whether lower bounds leave a sequence of actions any chance."""
        robots = robots_of(skeleton)
        if len(robots) == 1:
            return robots[0] in self.bounds.alone(part)
        return (
            bool(self.bounds.pick_grips(robots[0], part))
            and bool(self.bounds.place_grips(robots[-1], part))
            and all(self.bounds.can_hand_over(a, b, part) for a, b in pairwise(robots))
        )
