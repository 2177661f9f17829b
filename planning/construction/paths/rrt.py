"""Path planning in space-time to goals with unknown arrival times (Hartmann et al. IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.paths.base_paths import base_path
from planning.construction.paths.bidirectional_search import grow_forests
from planning.construction.paths.direct_paths import direct_paths
from planning.construction.paths.earliest_arrival import search_roadmap
from planning.construction.paths.path_shortcuts import shortcut_path
from planning.construction.paths.query import Query, SpaceTimePath, next_arrival
from planning.construction.paths.retiming import retime_with_waits, with_early_waits
from planning.construction.problem.settings import RrtSettings
from planning.construction.stopwatch import Stopwatch
from planning.packed import packed
from planning.transforms import Array

_POSTPROCESSING = "postprocessing"
"""Name of the time that shortcuts and new times of paths take."""

_DETOUR = 4.0
"""Least extra time of the detours to search for [s]."""


def space_time_rrt(
    checker: SpaceTimeChecker,
    goals: Array,
    windows: Sequence[Array],
    settings: RrtSettings,
    *,
    latest: float = np.inf,
    hints: Array | None = None,
    linger: bool = False,
    seed: int = 0,
    watch: Stopwatch | None = None,
) -> SpaceTimePath | None:
    """Return a path to one of several goals that arrives early, or None.

    Paths that need no search are tried first, see ``direct_paths``. Then the earliest arrival is
    searched for over a roadmap of hints, of ways to drive around what lies on the floor, of places
    on the best path so far, and of random ones. Where that fails two forests are grown until they
    meet, and on to arrive earlier.

    Args:
        checker: collision checker of the moving robot.
        goals: configurations, shape (g, n).
        windows: for each goal the time windows of arrival, shape (w, 2), see
            ``arrival_windows`` [s].
        settings: effort.
        latest: no later arrival is wanted [s].
        hints: configurations that a path may well lead through, shape (h, n).
        linger: a robot that has to wait does so early on the way, not late: where it is, rather
            than where it is in the way of others.
        seed: of all random numbers.
        watch: accumulates the time of shortcutting and retiming.
    """
    watch = Stopwatch() if watch is None else watch
    goals = np.array(goals, dtype=np.float64)
    start = checker.start_configuration()
    model, first = checker.model, checker.start
    soon = first + np.max(np.abs(goals - start) / model.velocity, axis=1)
    spans = [
        _cut(span, float(earliest), latest)
        for span, earliest in zip(windows, soon, strict=True)
    ]
    query = make_query(checker, goals, spans)
    earliest = min(next_arrival(query, g, t) for g, t in enumerate(soon.tolist()))
    if not earliest <= latest or np.isinf(earliest):
        return None  # no goal is ever free when it can be reached
    least = float(soon.min()) - first
    # Some while after all others have stopped nothing changes any more.
    calm = max(checker.world.end, earliest)
    horizon = min(latest, calm + 4.0 * least + 20.0)
    search = _Search(checker, query, settings, seed, earliest, least, horizon, watch)
    found = search.run(np.empty((0, len(start))) if hints is None else hints)
    if found is None or not linger:
        return found
    with watch.time(_POSTPROCESSING):
        return with_early_waits(checker, found, query)


def make_query(
    checker: SpaceTimeChecker, goals: Array, windows: Sequence[Array]
) -> Query:
    """Return a query from where a robot becomes free to move, see ``space_time_rrt``."""
    start, model = checker.start_configuration(), checker.model
    return packed(
        Query(
            start,
            checker.start,
            np.minimum(model.lower, np.minimum(start, goals.min(axis=0))),
            np.maximum(model.upper, np.maximum(start, goals.max(axis=0))),
            model.velocity,
            goals,
            np.cumsum([0, *(len(s) for s in windows)]).astype(np.int64),
            np.ascontiguousarray(np.concatenate([np.empty((0, 2)), *windows])),
            checker.home,
            np.arange(model.dof) >= (3 if model.is_mobile else 0),
        )
    )


def _cut(windows: Array, earliest: float, latest: float) -> Array:
    """Return the parts of time spans between two times."""
    out = np.clip(windows, earliest, latest)
    out[:, 1] = np.where(np.isinf(windows[:, 1]), latest, out[:, 1])
    keep = (windows[:, 1] >= earliest) & (windows[:, 0] <= latest)
    return np.asarray(out[keep])


@dataclass(frozen=True)
class _Search:
    """One search for a path.

    Attributes:
        earliest: no path arrives before [s].
        least: time that speeds allow to the nearest goal [s].
        horizon: latest arrival to consider [s].
        watch: what takes how long.
    """

    checker: SpaceTimeChecker
    query: Query
    settings: RrtSettings
    seed: int
    earliest: float
    least: float
    horizon: float
    watch: Stopwatch

    def run(self, hints: Array) -> SpaceTimePath | None:
        settings = self.settings
        enough = self.earliest + settings.good_enough_s
        best = self._without_search()
        if best is not None and best.arrival <= enough:
            return best
        hints = np.concatenate([hints, *self._base_paths()])
        acceptable = max(enough, self.earliest + settings.acceptable_loss_s)
        for turn in range(settings.rounds):
            seed = self.seed + turn
            if settings.checks > 0:
                around = self._over_roadmap(best, hints, seed)
                if around is not None:
                    best = self._improve(around, seed)
            if best is not None and best.arrival <= acceptable:
                break
            time, path, goal = grow_forests(
                self.checker.scene,
                self.query,
                settings,
                settings.iterations if best is None else settings.patience,
                self.horizon,
                np.inf if best is None else best.arrival,
                self.seed * 64 + turn,
            )
            if goal >= 0:
                found = SpaceTimePath(time, path, int(goal), self.earliest)
                best = self._improve(found, seed)
            if best is not None and best.arrival <= enough:
                break
        return best

    def _without_search(self) -> SpaceTimePath | None:
        """Return the earliest of the direct paths, None where all are blocked."""
        settings, checker, query = self.settings, self.checker, self.query
        if settings.direct == 0:
            return None
        best: SpaceTimePath | None = None
        times, paths, counts, goals, clear = direct_paths(
            checker.scene, query, self.horizon, settings.direct, settings.stands
        )
        for k, count in reversed(list(enumerate(counts.tolist()))):
            path = SpaceTimePath(
                times[k, :count], paths[k, :count], int(goals[k]), self.earliest
            )
            latest = self.horizon if best is None else best.arrival
            if path.arrival >= latest:
                continue
            if clear and k == len(counts) - 1:
                best = path
            else:
                with self.watch.time(_POSTPROCESSING):
                    best = retime_with_waits(checker, path, query, latest) or best
        return best

    def _base_paths(self) -> list[Array]:
        """Return paths for the base of a robot that moves alone to drive to each goal."""
        checker, most = self.checker, self.settings.drives
        if most == 0 or not checker.model.is_mobile:
            return []
        goals = range(len(self.query.goals))
        return [base_path(checker.scene, self.query, k, most) for k in goals]

    def _over_roadmap(
        self, best: SpaceTimePath | None, hints: Array, seed: int
    ) -> SpaceTimePath | None:
        """Return a path that arrives earlier than the best one so far, over a random roadmap."""
        bound = min(self.horizon, self.earliest + self.settings.most_loss_s)
        # As wide as that there are detours; waits make them no wider.
        wide = self.checker.start + self.least
        wide += max(0.5 * self.least, _DETOUR)
        if best is not None:
            hints = np.concatenate([hints, np.unique(best.path, axis=0)])
            bound = min(bound, best.arrival - self.settings.good_enough_s)
            wide = min(wide, bound)
        time, path, goal = search_roadmap(
            self.checker.scene,
            self.query,
            self.settings,
            hints,
            self.earliest - self.least - _DETOUR,
            bound,
            wide,
            seed,
        )
        if goal < 0:
            return None
        keep = np.concatenate([[True], np.diff(time) > 1e-9])
        return SpaceTimePath(time[keep], path[keep], int(goal), self.earliest)

    def _improve(self, found: SpaceTimePath, seed: int) -> SpaceTimePath:
        """Return a path with less travel that arrives no later."""
        settings, checker, query = self.settings, self.checker, self.query
        with self.watch.time(_POSTPROCESSING):
            for turn in range(3):
                before = found.arrival
                tries = settings.shortcuts
                found = shortcut_path(checker, found, query, tries, 8 * seed + turn)
                found = retime_with_waits(checker, found, query, found.arrival) or found
                if found.arrival > before - settings.good_enough_s:
                    break
        return found
