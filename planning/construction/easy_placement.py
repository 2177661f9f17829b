"""The next placement, as far as it is easy to find: which part, and by whom.

Eqs. (6) and (7) are only proposals here: others may be in a robot's way, and then another part or
another robot may be better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import islice

import numpy as np

from planning.construction.attempt import Attempt
from planning.construction.placements import Candidates
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.settings import SearchSettings
from planning.construction.skeletons import Skeleton
from planning.construction.subproblem import Solution
from planning.construction.world.building import Building

Solve = Callable[[Building, Attempt], Solution | None]


class EasyPlacement:
    """Places a part by ways that are easy to find.

    Args:
        problem: what is built by whom.
        candidates: who may place what.
        solve: solves a sub-problem.
        settings: how many are asked.
    """

    def __init__(
        self,
        problem: ConstructionProblem,
        candidates: Candidates,
        solve: Solve,
        settings: SearchSettings,
    ) -> None:
        self.problem = problem
        self.candidates = candidates
        self.solve = solve
        self.settings = settings

    def place(
        self,
        building: Building,
        parts: Sequence[Part],
        seed: Sequence[int],
        most: float = np.inf,
    ) -> Solution | None:
        """Return the best of a few ways to place a part, None for none.

        The first robot places the first part. Where it would lose time with that, because
        others are in its way or what the part rests on comes late, it may place another one;
        of a few the one with which it loses least. Where there are few parts for many robots
        all wait for the first: others are asked whether they have it there sooner.

        Args:
            building: the state before.
            parts: that may be placed next, the best first.
            seed: of all random numbers.
            most: a way with which as much time is lost is of no use [s].
        """
        team = self.problem.team
        if len(team) == 1 or len(parts) <= len(team) // 2:
            return self._soonest(building, parts[0], seed, most)
        best: Solution | None = None
        for part in parts[: self.settings.parts]:
            first = next(self.candidates.alone(building, part), None)
            if first is None:
                break
            found = self._easily(building, part, *first, seed, lost=most)
            if found is None:
                continue
            best, most = found, found.lost
            if found.lost <= self.settings.late:
                break
        return best

    def _soonest(
        self, building: Building, part: Part, seed: Sequence[int], most: float
    ) -> Solution | None:
        """Return the way by which a part is in its place soonest, None for none.

        The first robot does it, unless others are in its way and it would be late: then others
        are asked, too, as long as they may be sooner.
        """
        seconds = self.problem.seconds
        best: Solution | None = None
        latest = np.inf
        alone = self.candidates.alone(building, part)
        for robot, skeleton in islice(alone, self.settings.asked):
            free = building.world.free_from(robot)
            if free + seconds.pick + seconds.place > latest:
                break
            found = self._easily(building, part, robot, skeleton, seed, latest, most)
            if found is None:
                continue
            if found.building.placed[part.name] < latest:
                best, latest = found, found.building.placed[part.name]
            if found.late <= self.settings.late:
                break
        return best

    def _easily(
        self,
        building: Building,
        part: Part,
        robot: str,
        skeleton: Skeleton,
        seed: Sequence[int],
        latest: float = np.inf,
        lost: float = np.inf,
    ) -> Solution | None:
        """Return how a robot can place a part by ways that are easy to find, None for none."""
        own = [*seed, self.problem.team.index(robot)]
        return self.solve(
            building,
            Attempt(part, skeleton, own, hasty=True, latest=latest, lost=lost),
        )
