"""Settings of the construction planner: the effort of the search, of keyframes and of paths."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

_EASY_S = 15.0
"""Greatest delay of an arrival to search for while other robots remain to be tried."""

_EASY_SHARE = 10
"""Divisor of the sample count at low effort where the search is by samples only."""


PathFinder = Literal["auto", "rrt"]
"""What finds paths: what needs least search first, or the bi-directional RRT of IV-C alone."""


class RrtSettings(NamedTuple):
    """Effort of the search for one path, without time limits: a seed determines the path.

    A path that arrives a second late is good enough: better ones cost more than they gain.

    Attributes:
        iterations: samples of the bi-directional search in all.
        patience: samples after the last improvement of the arrival time.
        weight: lambda of eq. (5): distance against time.
        reach: longest motion added in one extension [s].
        growth: factor by which the range of arrival times grows.
        good_enough_s: an arrival this much after the earliest that speeds allow ends the search;
            so much must an improvement gain.
        acceptable_loss_s: an arrival this much after the earliest over a roadmap is not searched
            on for.
        direct: paths that need no search tried first, at most.
        stands: shares of the arm's time for which a robot may stand on such a path, see
            ``direct_paths``; 0 for straight paths only.
        drives: steps on the lattice that are looked at, see ``base_path``; 0 for none.
        rounds: how often a path is searched for, each time with the bound of the one before.
        vertices: of the roadmap that is searched for an earlier arrival.
        neighbours: of each of its vertices.
        checks: motions of the roadmap that are checked.
        most_loss_s: greatest delay of an arrival to search for over a roadmap.
        shortcuts: random stretches of a path that are tried to be made straight.
    """

    iterations: int = 3000
    patience: int = 80
    weight: float = 0.5
    reach: float = 4.0
    growth: float = 1.15
    good_enough_s: float = 1.0
    acceptable_loss_s: float = 10.0
    direct: int = 3
    stands: int = 3
    drives: int = 800
    rounds: int = 1
    vertices: int = 50
    neighbours: int = 16
    checks: int = 450
    most_loss_s: float = 60.0
    shortcuts: int = 60

    @property
    def samples_only(self) -> bool:
        """True if all paths come from the bi-directional search."""
        return self.direct == 0 and self.checks == 0

    def rrt_alone(self) -> RrtSettings:
        """Return settings that find all paths by the bi-directional search, as in IV-C."""
        return self._replace(direct=0, drives=0, checks=0)


@dataclass(frozen=True)
class KeyframeSettings:
    """Effort of the search for keyframes.

    Attributes:
        picks, places: number of candidates wanted.
        starts: configurations drawn together.
        draws: number of draws for each hold of the part.
        spread_s: times are drawn up to so long after the earliest.
        meetings: places of a handover drawn.
        ahead_s: later arrivals than so long after the earliest are not looked at, as long as
            others still move.
    """

    picks: int = 3
    places: int = 4
    starts: int = 12
    draws: int = 4
    spread_s: float = 10.0
    ahead_s: float = 30.0
    meetings: int = 60


@dataclass(frozen=True)
class SubproblemSettings:
    """Effort levels for one sub-problem.

    Attributes:
        keyframes: effort for keyframes.
        rrt: effort for paths.
        holds: number of holds of the part for which paths are searched.
    """

    keyframes: KeyframeSettings = field(default_factory=KeyframeSettings)
    rrt: RrtSettings = field(default_factory=RrtSettings)
    holds: int = 2

    def low_effort(self) -> SubproblemSettings:
        """Return settings that search only for paths that are easy to find."""
        rrt = self.rrt
        few = rrt.iterations // _EASY_SHARE if rrt.samples_only else 0
        rrt = rrt._replace(
            iterations=few, patience=min(rrt.patience, few), most_loss_s=_EASY_S
        )
        return replace(self, rrt=rrt, holds=1)

    def with_more_effort(self, effort: int) -> SubproblemSettings:
        """Return settings that retry failures."""
        if effort == 0:
            return self
        by = 3**effort
        keyframes = replace(
            self.keyframes,
            draws=self.keyframes.draws * by,
            places=self.keyframes.places * 2,
            ahead_s=self.keyframes.ahead_s * by,
            meetings=self.keyframes.meetings * by,
        )
        rrt = self.rrt._replace(iterations=self.rrt.iterations * by)
        return replace(self, keyframes=keyframes, rrt=rrt, holds=self.holds * by)


@dataclass(frozen=True)
class SearchSettings:
    """Effort of the search over parts and robots.

    Attributes:
        attempts: of each sequence of actions, before the next robots are tried.
        asked: robots that may plan a part before the effort is raised, one after another, as
            long as each is late; where there are no more parts to place than for half of them.
        parts: that the first robot may plan before anything is tried hard, one after another,
            as long as it loses time with each; where there are more.
        late_s: a part that comes no later than this after speeds and the world at its place
            allow is not late, and so much is no loss.
        round: parts that are planned before it is looked at how much time was lost with them;
            no more than there are robots.
        tries: how often they are planned, at most.
        acceptable_loss_s: lost time per placement that does not trigger replanning.
        again: attempts that may go into planning again, in all: for each part of the
            construction, over the number of robots, since among many each takes longer.
        efforts: how often failures are gone through again when nothing else is left, each
            time trying harder.
        returns: greatest number of backtracks for one part. Parts that keep each
            other from their places would take turns for ever.
    """

    attempts: int = 2
    asked: int = 3
    parts: int = 3
    late_s: float = 2.0
    round: int = 5
    tries: int = 3
    acceptable_loss_s: float = 3.0
    again: float = 6.0
    efforts: int = 3
    returns: int = 8


@dataclass(frozen=True)
class PlannerSettings:
    """Effort of planning a construction.

    Attributes:
        search: over objects, robots and actions.
        subproblem: each part.
    """

    search: SearchSettings = field(default_factory=SearchSettings)
    subproblem: SubproblemSettings = field(default_factory=SubproblemSettings)

    def finding(self, paths: PathFinder) -> PlannerSettings:
        """Return settings with another method of path search."""
        if paths == "auto":
            return self
        rrt = self.subproblem.rrt.rrt_alone()
        return replace(self, subproblem=replace(self.subproblem, rrt=rrt))
