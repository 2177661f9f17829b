"""Legs: the paths of one sub-problem between its skills (Hartmann et al. IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.keyframes.keyframes import Keyframe
from planning.construction.paths.rrt import space_time_rrt
from planning.construction.problem.settings import RrtSettings
from planning.construction.stopwatch import Stopwatch
from planning.construction.world.building import Building
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.timeline import RobotTimeline
from planning.steps.skill import NOTHING, Pairs
from planning.transforms import Array

_SPACING = 0.75
"""Most between places on earlier paths that are hints for new ones [s]."""


class Leg(NamedTuple):
    """A path to the beginning of a skill.

    Attributes:
        building: the state then.
        keyframe: which skill.
        start: when it begins [s].
        earliest: how soon speeds and the world at the goals would have let it begin [s].
        lost: how much later it begins than speeds alone would allow [s].
    """

    building: Building
    keyframe: Keyframe
    start: float
    earliest: float
    lost: float


@dataclass(frozen=True)
class LegPlanner:
    """Plans legs.

    Attributes:
        settings: effort.
        rng: what seeds are drawn from.
        watch: what takes how long.
    """

    settings: RrtSettings
    rng: np.random.Generator
    watch: Stopwatch

    def allowing_delay(self, spare: float) -> LegPlanner:
        """Return a planner of legs that may arrive late, by most of a given time [s]."""
        enough = max(self.settings.good_enough_s, 0.7 * spare)
        return replace(self, settings=self.settings._replace(good_enough_s=enough))

    def leg(
        self,
        building: Building,
        robot: str,
        goals: Sequence[Keyframe],
        *,
        allowed: Pairs = NOTHING,
        hints: Array | None = None,
        linger: bool = False,
        latest: float = np.inf,
        most_loss: float = np.inf,
    ) -> Leg | None:
        """Return a path to the beginning of a skill, None where none was found.

        Args:
            building: the state before.
            robot: who goes.
            goals: ways to do the skill.
            allowed: unordered pairs of entities that may touch.
            hints, linger: see ``space_time_rrt``.
            latest: no later arrival is of use [s].
            most_loss: nor one with which so much time is lost [s].
        """
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,), allowed=allowed)
            here = checker.start_configuration()
            far = max(checker.least_duration(here, goal.start) for goal in goals)
            # Whoever is later than this at the farthest goal has lost too much.
            latest = min(latest, checker.start + far + most_loss)
            found = space_time_rrt(
                checker,
                np.array([goal.start for goal in goals]),
                [goal.windows for goal in goals],
                self.settings,
                latest=latest,
                hints=hints,
                linger=linger,
                seed=self._seed(),
            )
        if found is None:
            return None
        goal = goals[found.goal]
        lost = found.arrival - checker.start - checker.least_duration(here, goal.start)
        building = building.moved(robot, found.time, found.path)
        return Leg(building, goal, found.arrival, found.earliest, lost)

    def retreat(self, building: Building, robot: str) -> Building | None:
        """Return the state in which a robot has gone HOME, out of the others' way."""
        home = building.world.cell.robot(robot).home
        with self.watch.time("path"):
            checker = SpaceTimeChecker(building.world, (robot,))
            here = checker.start_configuration()
            soon = checker.start + checker.least_duration(here, home)
            found = space_time_rrt(
                checker,
                home[None],
                [arrival_windows([(checker, home)], np.inf, soon)],
                self.settings,
                hints=approach_hints(building.world, robot),
                seed=self._seed(),
            )
        if found is None:
            return None
        return building.moved(robot, found.time, found.path, work=False)

    def _seed(self) -> int:
        return int(self.rng.integers(2**31))


def retreat_hints(world: FixedWorld, robot: str) -> Array:
    """Return places on a robot's way out of others' way, shape (w, n)."""
    line = world.robots[robot]
    return _places(line, line.busy_until, line.end)


def approach_hints(world: FixedWorld, robot: str) -> Array:
    """Return places on a robot's way to its last skill, which may be a way back, shape (w, n)."""
    line = world.robots[robot]
    since = line.skills[-2][1] if len(line.skills) > 1 else 0.0
    return _places(line, since, line.skills[-1][0])


def _places(line: RobotTimeline, since: float, until: float) -> Array:
    """Return places on a robot's path: waypoints, and some in between, shape (w, n)."""
    corners = line.time[(line.time > since) & (line.time < until)]
    times = np.unique(np.concatenate([corners, np.arange(since, until, _SPACING)]))
    path = [line.at(float(t)) for t in times]
    return np.array(path).reshape(len(times), line.path.shape[1])
