"""Transit planning for one robot: OMPL's RRT-Connect, then shortcutting (APEX-MR IV-B)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util as ou

from planning.motion.speed import SpeedModel, path_duration, path_times
from planning.transforms import Array

_GAIN = 1e-6
"""Least saved time for which a shortcut may add a corner [s]."""

_Check = Callable[[Array, Array], bool]
"""Tells whether the straight motion between two configurations is collision-free, including its end."""


class MotionChecker(Protocol):
    """Collision checks of a configuration and of a straight motion."""

    def configuration_free(self, q: Array) -> bool:
        """Tell whether the robot may stand at ``q``."""
        ...

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the straight line from ``q_a`` to ``q_b`` is free."""
        ...

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether ``q_b`` and samples of the motion to it are free; quick, but no proof."""
        ...


def shortcut_polyline(
    checker: MotionChecker,
    path: Array,
    speed: SpeedModel,
    rng: np.random.Generator,
    tries: int,
) -> Array:
    """Return a path with the same ends that is no slower, by removed corners and random shortcuts.

    Args:
        checker: the scene.
        path: free polyline, shape (w, n).
        speed: speed model that gives durations of paths.
        rng: source of the random shortcuts.
        tries: number of random shortcuts. Two of three change one joint only, which may save time
            under the L1 speed model where the shortcut of all joints is blocked.
    """
    path = _drop_corners(checker, path, speed)
    marks = path_times(path, speed)
    for attempt in range(tries):
        if len(path) < 3:
            break
        lo, hi = np.sort(rng.uniform(0.0, marks[-1], 2))
        i, j = int(np.searchsorted(marks, lo)), int(np.searchsorted(marks, hi))
        if i == j or hi - lo < 1e-3:
            continue
        entry, leave = _point(path, marks, lo), _point(path, marks, hi)
        if attempt % 3 == 0:
            bridge = np.array([entry, leave])
        else:
            joint = int(rng.integers(path.shape[1]))
            bridge = np.vstack([entry, path[i:j], leave])
            share = np.concatenate([[lo], marks[i:j], [hi]])
            share = (share - lo) / (hi - lo)
            bridge[:, joint] = entry[joint] + share * (leave[joint] - entry[joint])
        if path_duration(bridge, speed) < hi - lo - _GAIN and _is_free(checker, bridge):
            path = np.vstack([path[:i], bridge, path[j:]])
            moves = np.any(np.abs(np.diff(path, axis=0)) > 1e-9, axis=1)
            moves[-1] = True
            path = path[np.append(True, moves)]
            marks = path_times(path, speed)
    return _drop_corners(checker, path, speed)


def _is_free(checker: MotionChecker, path: Array) -> bool:
    """Tell whether a polyline is free: by samples first, by proof at the end."""
    return all(checker.seems_free(a, b) for a, b in pairwise(path)) and all(
        checker.motion_free(a, b) for a, b in pairwise(path)
    )


def _point(path: Array, marks: Array, at: float) -> Array:
    k = min(int(np.searchsorted(marks, at, side="right")) - 1, len(path) - 2)
    span = marks[k + 1] - marks[k]
    share = 0.0 if span <= 0 else (at - marks[k]) / span
    return np.asarray(path[k] + share * (path[k + 1] - path[k]))


def _drop_corners(checker: MotionChecker, path: Array, speed: SpeedModel) -> Array:
    """Remove corners, longest shortcuts first, where that is free and no slower."""
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


ou.setLogLevel(ou.LogLevel.LOG_NONE)


class TransitPlanner(Protocol):
    """Planner of a path for one robot among static obstacles; a straight line where one is free."""

    def plan(
        self, checker: MotionChecker, start: Array, goal: Array, seed: int
    ) -> Array | None:
        """Return a free polyline from start to goal, shape (w, n), or None."""
        ...


@dataclass(frozen=True)
class RrtConnect:
    """OMPL's RRT-Connect, then shortcutting; a straight line where one is free.

    The trees grow by motions of which only samples are checked. The motions of the resulting path
    are proved free; each one that is not is replaced by another search between its ends.
    The search ends after a number of checked motions, not after a time, and OMPL's global random
    generator is seeded before every query: the same query gives the same path.

    Attributes:
        lower, upper: joint limits, shape (n,).
        speed: speed model by which paths are compared.
        reach: longest tree edge (L2 joint distance) [rad].
        checks: motions checked before giving up.
        smoothing: random shortcuts tried on the best path.
        good_enough: a path within this ratio of the straight line ends the search for a
            better one.
        tours: independent searches among which the shortest path wins.
        rough: random shortcuts tried on the path of each tour, to compare them.
        enough: motions checked in all tours after which no better path is searched. Where the
            first path takes many, further ones are expensive, and seldom much better.
    """

    lower: Array
    upper: Array
    speed: SpeedModel
    reach: float = 0.7
    checks: int = 5000
    smoothing: int = 120
    good_enough: float = 1.08
    tours: int = 3
    rough: int = 40
    enough: int = 700

    def plan(
        self, checker: MotionChecker, start: Array, goal: Array, seed: int
    ) -> Array | None:
        """Return a free polyline from start to goal, or None.

        Args:
            checker: the scene.
            start, goal: free configurations, shape (n,).
            seed: seed of the search and of the random shortcuts.
        """
        if checker.motion_free(start, goal):
            return np.array([start, goal])
        good = self.good_enough * self.speed.duration(start, goal)
        best: Array | None = None
        least, checked = np.inf, 0
        for tour in range(self.tours):
            if best is not None and (checked >= self.enough or least <= good):
                break
            most = self.checks if best is None else self.enough - checked
            path, count = self._tour(checker, start, goal, 1000 * seed + tour, most)
            checked += count
            if path is None:
                continue
            rng = np.random.default_rng([seed, tour])
            path = shortcut_polyline(checker, path, self.speed, rng, self.rough)
            seconds = path_duration(path, self.speed)
            if seconds < least:
                best, least = path, seconds
        if best is None:
            return None
        rng = np.random.default_rng([seed, self.tours])
        return shortcut_polyline(checker, best, self.speed, rng, self.smoothing)

    def _tour(
        self, checker: MotionChecker, start: Array, goal: Array, seed: int, most: int
    ) -> tuple[Array | None, int]:
        """Return a free path, None where none is found, and how many motions were checked.

        Args:
            checker: the scene.
            start, goal: free configurations, shape (n,).
            seed: of the searches.
            most: motions checked before a search is given up.
        """
        path, count = self._search(checker.seems_free, start, goal, seed, most)
        if path is None:
            return None, count
        whole = [start]
        for a, b in pairwise(path):
            if checker.motion_free(a, b):
                whole.append(b)
                continue
            around, more = self._search(checker.motion_free, a, b, seed, most)
            count += more
            if around is None:
                return None, count
            whole.extend(around[1:])
        return np.array(whole), count

    def _search(
        self, check: _Check, start: Array, goal: Array, seed: int, most: int
    ) -> tuple[Array | None, int]:
        """Return a path of motions that pass a check, and the number of checks; see _tour."""
        # OMPL warns that existing generators keep their seeds. Those belong to earlier queries;
        # the generators of this query are created after the seed is set.
        ou.RNG.setSeed(seed + 1)
        n = len(start)
        space = ob.RealVectorStateSpace(n)
        bounds = ob.RealVectorBounds(n)
        for i in range(n):
            bounds.setLow(i, min(self.lower[i], start[i], goal[i]))
            bounds.setHigh(i, max(self.upper[i], start[i], goal[i]))
        space.setBounds(bounds)
        information = ob.SpaceInformation(space)
        validator = _Validator(information, check, start, goal)
        # The motion validator checks new states together with their motions.
        information.setStateValidityChecker(
            ob.AllValidStateValidityChecker(information)
        )
        information.setMotionValidator(validator)
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
        status = planner.solve(
            ob.PlannerTerminationCondition(lambda: validator.count > most)
        )
        if status.getStatus() != ob.PlannerStatus.EXACT_SOLUTION:
            return None, validator.count
        states = problem.getSolutionPath().getStates()
        path = np.array([[state[i] for i in range(n)] for state in states])
        path[0], path[-1] = start, goal
        return path, validator.count


class _Validator(ob.MotionValidator):  # type: ignore[misc]
    """OMPL motion validator that counts its checks, each from an accepted configuration to a new one.

    Args:
        information: OMPL's space information.
        check: test of motions.
        start, goal: configurations that pass, shape (n,).
    """

    def __init__(
        self, information: object, check: _Check, start: Array, goal: Array
    ) -> None:
        super().__init__(information)
        self.count = 0
        self._check, self._n = check, len(start)
        self._passed = {np.asarray(q, np.float64).tobytes() for q in (start, goal)}

    def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802 - OMPL's name
        """Tell whether the straight line from one state to another is valid."""
        self.count += 1
        q_a, q_b = (np.array([q[i] for i in range(self._n)]) for q in (a, b))
        if q_b.tobytes() in self._passed:
            q_a, q_b = q_b, q_a
        if not self._check(q_a, q_b):
            return False
        self._passed.add(q_b.tobytes())
        return True
