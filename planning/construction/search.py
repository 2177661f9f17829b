"""Searches over objects, robots and action sequences, depth first with backtracking (IV-D)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations, pairwise

import numpy as np

from planning.construction.bounds import ReachBounds
from planning.construction.building import Building, nothing_built
from planning.construction.object_order import rank_parts
from planning.construction.problem import ConstructionProblem, Part
from planning.construction.skeletons import Skeleton, skeletons
from planning.construction.subproblem import SubproblemSolver
from planning.errors import ConstructionError


@dataclass(frozen=True)
class SearchSettings:
    """How hard the search tries.

    Attributes:
        attempts: of each sequence of actions, before the next robots are tried.
        group: most robots that work on one part together.
    """

    attempts: int = 2
    group: int = 2


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


class ConstructionSearch:
    """Plans part after part, fixed once planned, and takes placements back where it must.

    Args:
        problem: what is built by whom.
        bounds: who reaches what.
        solver: of sub-problems.
        settings: how hard is tried.
        progress: told how many parts are planned, of how many.

    Attributes:
        rewound: how many placements have been taken back.
        failed: what failed, in order: part, sequence of actions, and the parts in place.
    """

    def __init__(
        self,
        problem: ConstructionProblem,
        bounds: ReachBounds,
        solver: SubproblemSolver,
        settings: SearchSettings,
        progress: Callable[[int, int], None],
    ) -> None:
        self.problem = problem
        self.bounds = bounds
        self.solver = solver
        self.settings = settings
        self.progress = progress
        self.rewound = 0
        self.failed: list[tuple[str, Skeleton, frozenset[str]]] = []

    def run(self) -> Building:
        """Return the state in which every part is in its place.

        Raises:
            ConstructionError: no way was found; names the part.
        """
        problem = self.problem
        rng = np.random.default_rng([problem.seed, 1])
        building = nothing_built(problem)
        total = len(problem.parts)
        while len(building.placed) < total:
            free = min(building.world.free_from(name) for name in problem.team)
            ranked = rank_parts(problem, building.placed, {}, rng, free)
            part = problem.part(ranked[0])
            after = self._place(building, part)
            if after is None:
                raise ConstructionError(f"{part.name} could not be placed")
            building = after
            self.progress(len(building.placed), total)
        return building

    def _place(self, building: Building, part: Part) -> Building | None:
        """Return the state in which a part is in its place, None where nobody can do it."""
        for skeleton in self._skeletons(building, part):
            for attempt in range(self.settings.attempts):
                seed = [self.problem.seed, 2, building.step, self.rewound, attempt]
                seed += [self.problem.team.index(a.robot) for a in skeleton]
                after = self.solver.solve(building, part, skeleton, seed)
                if after is not None:
                    return after
            self.failed.append((part.name, skeleton, frozenset(building.placed)))
        return None

    def _skeletons(self, building: Building, part: Part) -> Iterator[Skeleton]:
        """Yield sequences of actions: robots by eq. 7, one before several, short before long."""
        for size in range(1, self.settings.group + 1):
            for group in robot_groups(building, self.problem.team, size):
                for skeleton in skeletons(group):
                    if self._may_work(part, skeleton):
                        yield skeleton

    def _may_work(self, part: Part, skeleton: Skeleton) -> bool:
        """Tell whether lower bounds leave a sequence of actions any chance."""
        robots = tuple(dict.fromkeys(action.robot for action in skeleton))
        if len(robots) == 1:
            return robots[0] in self.bounds.alone(part)
        return (
            bool(self.bounds.pick_grips(robots[0], part))
            and bool(self.bounds.place_grips(robots[-1], part))
            and all(self.bounds.can_hand_over(a, b, part) for a, b in pairwise(robots))
        )
