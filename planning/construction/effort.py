"""How hard one sub-problem is worked on: at first hardly at all, at last very."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from planning.construction.attempt import Attempt
from planning.construction.keyframes.solver import KeyframeSettings
from planning.construction.paths.rrt import RrtSettings

_RRT = RrtSettings(
    good_enough=1.0,
    bearable=10.0,
    patience=80,
    rounds=1,
    vertices=50,
    neighbours=16,
    checks=450,
    worst=60.0,
)
"""A path that arrives a second late is good enough: better ones cost more than they gain."""

_EASY = 15.0
"""An arrival so much later than possible is not looked for where others may be asked [s]."""


@dataclass(frozen=True)
class SubproblemSettings:
    """How hard one sub-problem is worked on.

    Attributes:
        keyframes: how hard keyframes are looked for.
        rrt: how hard paths are looked for.
        holds: ways to hold the part for which paths are looked for.
    """

    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    rrt: RrtSettings = _RRT
    holds: int = 2

    def unhurried(self, spare: float) -> SubproblemSettings:
        """Return the settings for a path that may well be late: by most of a time [s]."""
        enough = max(self.rrt.good_enough, 0.7 * spare)
        return replace(self, rrt=replace(self.rrt, good_enough=enough))

    def of(self, attempt: Attempt) -> SubproblemSettings:
        """Return the settings for an attempt."""
        return self.hasty() if attempt.hasty else self.harder(attempt.effort)

    def hasty(self) -> SubproblemSettings:
        """Return the settings with which paths are looked for that are easy to find."""
        rrt = replace(self.rrt, iterations=0, patience=0, worst=_EASY)
        return replace(self, rrt=rrt, holds=1)

    def harder(self, effort: int) -> SubproblemSettings:
        """Return the settings with which failures are gone through again."""
        if effort == 0:
            return self
        by = 3**effort
        keyframes = replace(
            self.keyframes,
            draws=self.keyframes.draws * by,
            places=self.keyframes.places * 2,
            ahead=self.keyframes.ahead * by,
            meetings=self.keyframes.meetings * by,
        )
        rrt = replace(self.rrt, iterations=self.rrt.iterations * by)
        return replace(self, keyframes=keyframes, rrt=rrt, holds=self.holds * by)
