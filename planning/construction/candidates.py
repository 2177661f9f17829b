"""Candidates for the next placement: robots by eq. (7), and the best of those that take little search.

A part is picked and placed once, and every robot of a group has it in hand once (Hartmann et al.
IV-D3, V-A3): so the robots in the order in which they have it say all of a skeleton, the sequence
of actions. The first one picks, each hands over to the next, the last one places and retracts.
Eqs. (6) and (7) are only proposals: others may be in a robot's way, and then another part or
another robot may be better.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, islice, pairwise, permutations

import numpy as np

from planning.construction.problem.problem import (
    ConstructionProblem,
    Part,
    SearchSettings,
)
from planning.construction.problem.reach_bounds import ReachBounds
from planning.construction.subproblem import Attempt, Skeleton, Solution
from planning.construction.world.fixed_world import Building

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


Solve = Callable[[Building, Attempt], Solution | None]


@dataclass(frozen=True)
class EasyPlacement:
    """Places a part by paths that take little search.

    Attributes:
        problem: what is built by whom.
        candidates: who may place what.
        solve: solves a sub-problem.
        settings: how many are asked.
    """

    problem: ConstructionProblem
    candidates: Candidates
    solve: Solve
    settings: SearchSettings

    def place(
        self,
        building: Building,
        parts: Sequence[Part],
        seed: Sequence[int],
        most_loss: float = np.inf,
    ) -> Solution | None:
        """Return the best of a few placements of a part, None if none was found.

        The first robot places the first part. Where it would lose time with that, because
        others are in its way or what the part rests on comes late, it may place another one;
        of a few the one with which it loses least. Where there are few parts for many robots
        all wait for the first: others are asked whether they have it there sooner.

        Args:
            building: the state before.
            parts: that may be placed next, the best first.
            seed: of all random numbers.
            most_loss: a way with which as much time is lost is of no use [s].
        """
        team = self.problem.team
        if len(team) == 1 or len(parts) <= len(team) // 2:
            return self._soonest(building, parts[0], seed, most_loss)
        best: Solution | None = None
        for part in parts[: self.settings.parts]:
            first = next(self.candidates.of(building, part, 1), None)
            if first is None:
                break
            attempt = self._attempt(part, first, seed, np.inf, most_loss)
            found = self.solve(building, attempt)
            if found is None:
                continue
            best, most_loss = found, found.lost
            if found.lost <= self.settings.late_s:
                break
        return best

    def _soonest(
        self, building: Building, part: Part, seed: Sequence[int], most_loss: float
    ) -> Solution | None:
        """Return the way by which a part is in its place soonest, None for none.

        The first robot does it, unless others are in its way and it would be late: then others
        are asked, too, as long as they may be sooner.
        """
        problem = self.problem
        best: Solution | None = None
        latest = np.inf
        alone = self.candidates.of(building, part, 1)
        for skeleton in islice(alone, self.settings.asked):
            free = building.world.free_from(skeleton[0])
            seconds = problem.seconds_of("pick", skeleton[0], part)
            seconds += problem.seconds_of("place-down", skeleton[-1], part)
            if free + seconds > latest:
                break
            attempt = self._attempt(part, skeleton, seed, latest, most_loss)
            found = self.solve(building, attempt)
            if found is None:
                continue
            if found.building.placed[part.name] < latest:
                best, latest = found, found.building.placed[part.name]
            if found.late <= self.settings.late_s:
                break
        return best

    def _attempt(
        self,
        part: Part,
        skeleton: Skeleton,
        seed: Sequence[int],
        latest: float,
        lost: float,
    ) -> Attempt:
        own = [*seed, self.problem.team.index(skeleton[0])]
        return Attempt(part, skeleton, own, low_effort=True, latest=latest, lost=lost)
