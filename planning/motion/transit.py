"""Transit planning for one robot: OMPL's RRT-Connect, then shortcutting (APEX-MR IV-B)."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planning.motion.speed import SpeedModel, path_duration, path_times
from planning.transforms import Array

ou.setLogLevel(ou.LogLevel.LOG_NONE)


class TransitPlanner(Protocol):
    """Finds a path for one robot while everything else stands, the straight one where it is free."""

    def plan(
        self, checker: MotionChecker, start: Array, goal: Array, seed: int
    ) -> Array | None:
        """Return a free polyline from start to goal, shape (w, n), or None."""
        ...


@dataclass(frozen=True)
class RrtConnect:
    """OMPL's RRT-Connect, then shortcutting; a straight line where one is free.

    The search ends after a number of checked motions, never by the clock, and OMPL's global
    generator is seeded before every query: the same query gives the same path.

    Attributes:
        lower, upper: joint limits, shape (n,).
        speed: what paths are shortened by.
        reach: longest tree edge (L2 joint distance) [rad].
        checks: motions checked before giving up.
        smoothing: tries of the shortcutting.
        good_enough: a path within this ratio of the straight line ends the search for a
            better one.
        tours: independent searches among which the shortest path wins.
    """

    lower: Array
    upper: Array
    speed: SpeedModel
    reach: float = 0.7
    checks: int = 4000
    smoothing: int = 120
    good_enough: float = 1.08
    tours: int = 3

    def plan(
        self, checker: MotionChecker, start: Array, goal: Array, seed: int
    ) -> Array | None:
        """Return a free polyline from start to goal, or None.

        Args:
            checker: the scene.
            start, goal: free configurations, shape (n,).
            seed: of the search and the shortcutting.
        """
        if checker.motion_free(start, goal):
            return np.array([start, goal])
        bound = self.speed.duration(start, goal)
        best: Array | None = None
        for tour in range(self.tours):
            raw = self._search(checker, start, goal, 1000 * seed + tour)
            if raw is None:
                continue
            rng = np.random.default_rng([seed, tour])
            path = smooth_path(checker, raw, self.speed, rng, self.smoothing)
            if best is None or path_duration(path, self.speed) < path_duration(
                best, self.speed
            ):
                best = path
            if path_duration(best, self.speed) <= self.good_enough * bound:
                break
        return best

    def _search(
        self, checker: MotionChecker, start: Array, goal: Array, seed: int
    ) -> Array | None:
        # OMPL grumbles that earlier generators are not affected by seeding now: those
        # belong to earlier queries, and the ones made for this query are.
        ou.RNG.setSeed(seed + 1)
        n = len(start)
        space = ob.RealVectorStateSpace(n)
        bounds = ob.RealVectorBounds(n)
        for i in range(n):
            bounds.setLow(i, min(self.lower[i], start[i], goal[i]))
            bounds.setHigh(i, max(self.upper[i], start[i], goal[i]))
        space.setBounds(bounds)
        information = ob.SpaceInformation(space)
        validity = _Validity(information, checker, n)
        motions = _Motions(information, checker, n)
        information.setStateValidityChecker(validity)
        information.setMotionValidator(motions)
        information.setup()
        problem = ob.ProblemDefinition(information)
        ends = space.allocState(), space.allocState()
        for i in range(n):
            ends[0][i], ends[1][i] = float(start[i]), float(goal[i])
        problem.setStartAndGoalStates(*ends)
        planner = og.RRTConnect(information)
        planner.setRange(self.reach)
        planner.setProblemDefinition(problem)
        planner.setup()
        limit = self.checks
        status = planner.solve(
            ob.PlannerTerminationCondition(lambda: motions.count > limit)
        )
        if str(status) != "Exact solution":
            return None
        states = problem.getSolutionPath().getStates()
        path = np.array([[state[i] for i in range(n)] for state in states])
        path[0], path[-1] = start, goal
        return path


class _Validity(ob.StateValidityChecker):  # type: ignore[misc]
    def __init__(self, information: object, checker: MotionChecker, n: int) -> None:
        super().__init__(information)
        self._checker = checker
        self._n = n

    def isValid(self, state: object) -> bool:  # noqa: N802 - OMPL's name
        return self._checker.configuration_free(_read(state, self._n))


class _Motions(ob.MotionValidator):  # type: ignore[misc]
    def __init__(self, information: object, checker: MotionChecker, n: int) -> None:
        super().__init__(information)
        self._checker = checker
        self._n = n
        self.count = 0

    def checkMotion(self, a: object, b: object) -> bool:  # noqa: N802 - OMPL's name
        self.count += 1
        return self._checker.motion_free(_read(a, self._n), _read(b, self._n))


def _read(state: object, n: int) -> Array:
    return np.array([state[i] for i in range(n)])  # type: ignore[index]


_GAIN = 1e-6


class MotionChecker(Protocol):
    """Collision checks of a configuration and of a straight motion."""

    def configuration_free(self, q: Array) -> bool:
        """Tell whether the robot may stand at ``q``."""
        ...

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the straight line from ``q_a`` to ``q_b`` is free."""
        ...


def smooth_path(
    checker: MotionChecker,
    path: Array,
    speed: SpeedModel,
    rng: np.random.Generator,
    tries: int,
) -> Array:
    """Return a path of the same ends that is no slower.

    Args:
        checker: the scene.
        path: free polyline, shape (w, n).
        speed: what decides which path is faster.
        rng: source of the random shortcuts.
        tries: number of random shortcuts; two of three move one joint only, which under the
            L1 speed model gains where a whole shortcut is blocked.
    """
    path = _drop_corners(checker, path, speed)
    for attempt in range(tries):
        if len(path) < 3:
            break
        marks = path_times(path, speed)
        lo, hi = np.sort(rng.uniform(0.0, marks[-1], 2))
        i, j = int(np.searchsorted(marks, lo)), int(np.searchsorted(marks, hi))
        if i == j or hi - lo < 1e-3:
            continue
        entry, leave = _point(path, marks, lo), _point(path, marks, hi)
        middle = path[i:j]
        if attempt % 3 == 0:
            bridge = np.array([entry, leave])
        else:
            joint = int(rng.integers(path.shape[1]))
            bridge = np.vstack([entry, middle, leave])
            share = np.concatenate([[lo], marks[i:j], [hi]])
            share = (share - lo) / (hi - lo)
            bridge[:, joint] = entry[joint] + share * (leave[joint] - entry[joint])
        gain = (hi - lo) - path_duration(bridge, speed)
        if gain > _GAIN and all(checker.motion_free(a, b) for a, b in pairwise(bridge)):
            path = np.vstack([path[:i], bridge, path[j:]])
            moves = np.any(np.abs(np.diff(path, axis=0)) > 1e-9, axis=1)
            moves[-1] = True
            path = path[np.append(True, moves)]
    return _drop_corners(checker, path, speed)


def _point(path: Array, marks: Array, at: float) -> Array:
    k = min(int(np.searchsorted(marks, at, side="right")) - 1, len(path) - 2)
    span = marks[k + 1] - marks[k]
    share = 0.0 if span <= 0 else (at - marks[k]) / span
    return np.asarray(path[k] + share * (path[k + 1] - path[k]))


def _drop_corners(checker: MotionChecker, path: Array, speed: SpeedModel) -> Array:
    """Leave out corners, longest shortcuts first, where that is free and no slower."""
    kept = [path[0]]
    i = 0
    while i < len(path) - 1:
        j = len(path) - 1
        while j > i + 1:
            direct = speed.duration(path[i], path[j])
            along = path_duration(path[i : j + 1], speed)
            if direct <= along + _GAIN and checker.motion_free(path[i], path[j]):
                break
            j -= 1
        kept.append(path[j])
        i = j
    return np.array(kept)
