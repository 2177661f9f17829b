"""Rounds of a few placements, planned again where robots lose much time.

One robot is planned after another, so who comes first may stand in the way of all others: more
with the first parts, when all robots set out together, and with the last ones, when some have
nothing left to do. Other random numbers often lose half as much.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from planning.construction.problem.problem import ConstructionProblem, Part
from planning.construction.problem.settings import SearchSettings
from planning.construction.subproblem import Solution
from planning.construction.world.building import Building


class Placer(Protocol):
    """Plans one placement; see ``ConstructionSearch``.

    Attributes:
        spent: how much has been tried so far, in attempts to place a part.
    """

    spent: int

    def next_parts(self, building: Building) -> list[Part]:
        """Return the parts that may be placed next, the best first."""

    def place_next(
        self, building: Building, parts: list[Part], turn: int, most_loss: float
    ) -> Solution | None:
        """Plan the placement of one of the parts; None where that failed."""


class Round(NamedTuple):
    """Placements, one after another.

    Attributes:
        states: after each of them.
        lost: for how long robots stood or made detours, and at the end of a construction for
            how long they had nothing to do [s].
        stuck: the part that could not be placed, None where all was well.
    """

    states: list[Building]
    lost: float
    stuck: Part | None = None


@dataclass
class Rounds:
    """Plans round after round.

    Attributes:
        problem: what is built by whom.
        placer: plans a placement.
        settings: how often a round is planned.
    """

    problem: ConstructionProblem
    placer: Placer
    settings: SearchSettings

    def __post_init__(self) -> None:
        """Set how many attempts may go into planning again."""
        parts, robots = len(self.problem.parts), len(self.problem.team)
        self._spare = self.settings.again * parts / robots

    def next(self, start: Building) -> Round:
        """Return the next placements, as good as a few tries make them.

        Args:
            start: the state before.
        """
        size = min(len(self.problem.team), self.settings.round)
        left = len(self.problem.parts) - len(start.placed)
        if left < 2 * size:
            size = left  # no short round at the end
        best = self._plan(start, size, 0, np.inf)
        for turn in range(1, self.settings.tries):
            if (
                best.stuck is not None
                or best.lost <= self.settings.acceptable_loss_s * size
                or self._spare <= 0.0
            ):
                break
            before = self.placer.spent
            found = self._plan(start, size, turn, best.lost)
            self._spare -= self.placer.spent - before
            if found.stuck is None and found.lost < best.lost:
                best = found
        return best

    def _plan(self, start: Building, size: int, turn: int, most_loss: float) -> Round:
        """Return a round, broken off when so much time is lost."""
        states: list[Building] = []
        now, lost = start, 0.0
        for _ in range(size):
            parts = self.placer.next_parts(now)
            found = self.placer.place_next(now, parts, turn, most_loss - lost)
            if found is None:
                return Round(states, lost, parts[0])
            now, lost = found.building, lost + found.lost
            states.append(now)
        if len(now.placed) == len(self.problem.parts):
            free = [now.world.free_from(robot) for robot in self.problem.team]
            lost += sum(max(free) - t for t in free)
        return Round(states, lost)
