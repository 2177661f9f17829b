"""Choice of the next part and its robots among placements that take little search.

Eqs. (6) and (7) are only proposals here: others may be in a robot's way, and then another part or
another robot may be better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from planning.construction.candidates import Candidates, Skeleton
from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.settings import SearchSettings
from planning.construction.subproblem import Attempt, Solution
from planning.construction.world.building import Building

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
        seconds = self.problem.seconds
        best: Solution | None = None
        latest = np.inf
        alone = self.candidates.of(building, part, 1)
        for skeleton in islice(alone, self.settings.asked):
            free = building.world.free_from(skeleton[0])
            if free + seconds.pick + seconds.place > latest:
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
