"""Settings of the construction planner: search effort, keyframes and paths."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

_LOW_EFFORT_DELAY_S = 15.0
"""Largest accepted delay of a path over the roadmap at low effort [s]."""

_LOW_EFFORT_DIVISOR = 10
"""Divisor of the number of samples at low effort, if all paths are found by the bidirectional RRT."""


PathFinder = Literal["auto", "rrt"]
"""Method of path search: direct paths and roadmaps before the RRT, or only the RRT of Hartmann et al. IV-C."""


class RrtSettings(NamedTuple):
    """Effort of the search for one path, without time limits: a seed determines the path.

    A path that arrives a second late is good enough: better ones cost more than they gain.

    Attributes:
        iterations: number of samples of the bi-directional search.
        patience: number of samples without an improvement after which the search ends, once a path is known.
        weight: lambda of eq. (5): distance against time.
        reach: longest motion added in one extension [s].
        growth: factor by which the range of arrival times grows.
        good_enough_s: a delay after the earliest arrival that speeds allow at which the search ends;
            also the least gain of an improvement.
        acceptable_loss_s: a delay after the earliest arrival at which a path over the roadmap is not
            improved by the bi-directional search.
        direct: maximum number of paths tried first that need no search.
        stands: number of durations for which a robot may stand on such a path, see
            ``direct_paths``; 0 for straight paths only.
        drives: maximum number of lattice steps in the search for a path of the base, see
            ``base_path``; 0 for no such search.
        rounds: number of searches for a path, each bounded by the arrival of the one before.
        vertices: number of vertices of the roadmap.
        neighbours: number of neighbours of each vertex.
        checks: maximum number of checked motions of the roadmap; 0 for no roadmap.
        most_loss_s: largest delay of an arrival over the roadmap.
        shortcuts: number of random stretches of a path that the planner tries to straighten.
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
        starts: number of configurations drawn together.
        draws: number of draws for each hold of the part.
        spread_s: arrival times are drawn up to this long after the earliest.
        meetings: number of places drawn for a handover.
        ahead_s: arrivals later than this after the earliest are ignored, as long as
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
        few = rrt.iterations // _LOW_EFFORT_DIVISOR if rrt.samples_only else 0
        rrt = rrt._replace(
            iterations=few,
            patience=min(rrt.patience, few),
            most_loss_s=_LOW_EFFORT_DELAY_S,
        )
        return replace(self, rrt=rrt, holds=1)

    def with_more_effort(self, effort: int) -> SubproblemSettings:
        """Return settings for another attempt after failures, at an effort level from 0."""
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
        attempts: number of attempts with each skeleton, before the next robots are tried.
        asked: maximum number of robots for which the first part is planned at low effort, as long as
            it is late with each; used where parts to place are at most half as many as robots.
        parts: maximum number of parts that are planned for the first robot at low effort, as long
            as it loses time with each; used where there are more parts than that.
        late_s: largest delay of a part, and largest lost time, that count as none [s].
        round: maximum number of placements in a round, after which the lost time is evaluated;
            no more than there are robots.
        tries: maximum number of times that a round is planned.
        acceptable_loss_s: lost time per placement that does not trigger replanning.
        again: budget of attempts for replanning rounds, for each part of the construction;
            divided by the number of robots, since among many robots each attempt takes longer.
        efforts: number of effort levels at which backtracking tries to place a part that has failed.
        returns: maximum number of backtracks for one part. Without a limit, parts that block
            each other's places would alternate endlessly.
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
        search: effort of the search over parts and robots.
        subproblem: effort of each sub-problem.
    """

    search: SearchSettings = field(default_factory=SearchSettings)
    subproblem: SubproblemSettings = field(default_factory=SubproblemSettings)

    def finding(self, paths: PathFinder) -> PlannerSettings:
        """Return settings with another method of path search."""
        if paths == "auto":
            return self
        rrt = self.subproblem.rrt.rrt_alone()
        return replace(self, subproblem=replace(self.subproblem, rrt=rrt))
