"""Paths through space-time to goals whose arrival times are not known (Hartmann et al. IV-C)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.construction.checks.arrival_windows import arrival_windows
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.paths.bidirectional_loop import Limits, grow
from planning.construction.paths.drive_ways import drive_way
from planning.construction.paths.earliest_arrival import search_roadmap
from planning.construction.paths.leaning_ways import leaning_ways
from planning.construction.paths.postprocess import (
    delayed,
    hasten,
    retimed,
    shorten,
)
from planning.construction.paths.query import Query, least_time, next_arrival
from planning.construction.paths.space_time_path import SpaceTimePath
from planning.robots.mobile import is_mobile
from planning.transforms import Array

_AROUND = 4.0
"""Ways around are looked for that take at least so much longer [s]."""


@dataclass(frozen=True)
class RrtSettings:
    """How the search goes on. It never looks at a clock: a seed means one path.

    Attributes:
        iterations: samples of a search in all.
        patience: samples after the last improvement of the arrival time.
        weight: lambda of eq. (5): distance against time.
        reach: longest motion added at once [s].
        growth: factor by which the range of arrival times grows.
        good_enough: an arrival this much after the earliest that speeds allow ends the search
            [s]; so much must an improvement gain.
        bearable: an arrival this much after the earliest over a roadmap is not searched on
            for [s].
        direct: ways that need no search tried first, at most.
        stands: shares of the arm's time for which a robot may stand on such a way, see
            ``leaning_ways``; 0 for straight ways only.
        drives: steps on the lattice that are looked at, see ``drive_way``; 0 for none.
        rounds: how often a path is searched for, each time with the bound of the one before.
        vertices: of the roadmap that is searched for an earlier arrival.
        neighbours: of each of its vertices.
        checks: motions of the roadmap that are looked at.
        worst: an arrival so much later than possible is not looked for over a roadmap [s].
        shortcuts: random stretches of a path that are tried to be made straight.
        speed: share of the joints' speed limits that is used, (0, 1].
    """

    iterations: int = 3000
    patience: int = 400
    weight: float = 0.5
    reach: float = 4.0
    growth: float = 1.15
    good_enough: float = 0.2
    bearable: float = 0.0
    direct: int = 3
    stands: int = 3
    drives: int = 800
    rounds: int = 2
    vertices: int = 200
    neighbours: int = 8
    checks: int = 1000
    worst: float = 15.0
    shortcuts: int = 60
    speed: float = 1.0


def space_time_rrt(
    checker: SpaceTimeChecker,
    goals: Array,
    *,
    stay: float = 0.0,
    windows: Sequence[Array] | None = None,
    not_before: float = 0.0,
    arrival: float | None = None,
    latest: float = np.inf,
    hints: Array | None = None,
    linger: bool = False,
    settings: RrtSettings = RrtSettings(),
    seed: int = 0,
) -> SpaceTimePath | None:
    """Return a path to one of several goals that arrives early, or None.

    Ways that need no search are tried first, see ``leaning_ways``. Then the earliest arrival is
    searched for over a roadmap of hints, of ways to drive around what lies on the floor, of places
    on the best way so far, and of random ones. Where that fails two forests are grown until they
    meet, and on to arrive earlier.

    Args:
        checker: who moves, and among what.
        goals: configurations, shape (g, n).
        stay: how long the movers stay there; infinity for good [s].
        windows: for each goal the spans in which one may arrive, shape (w, 2), see
            ``arrival_windows``; worked out from ``stay`` where not given.
        not_before: no earlier arrival is wanted [s].
        arrival: the only arrival time that is wanted, such as that of a partner [s].
        latest: no later arrival is wanted [s].
        hints: configurations that a way may well lead through, shape (h, n).
        linger: one robot alone that has to wait does so early on the way, not late: where it
            is, rather than where it is in the way of others.
        settings: how the search goes on.
        seed: of all random numbers.
    """
    goals = np.array(np.atleast_2d(goals), dtype=np.float64)
    start = np.array(checker.start_configuration(), dtype=np.float64)
    velocity = checker.velocity * settings.speed
    soon = np.max(
        checker.begin_of_joint + np.abs(goals - start) / velocity, axis=1, initial=0.0
    )
    soon = np.maximum(soon, max(not_before, arrival or 0.0))
    if arrival is not None:
        latest = min(latest, arrival)
    spans = [
        arrival_windows([(checker, goal)], stay, float(soon[k]), latest)
        if windows is None
        else _cut(windows[k], float(soon[k]), latest)
        for k, goal in enumerate(goals)
    ]
    first = np.cumsum([0, *(len(s) for s in spans)]).astype(np.int64)
    query = Query(
        start,
        np.array(checker.begin_of_joint),
        np.minimum(checker.lower, np.minimum(start, goals.min(axis=0))),
        np.maximum(checker.upper, np.maximum(start, goals.max(axis=0))),
        velocity,
        goals,
        first,
        np.ascontiguousarray(np.concatenate([np.empty((0, 2)), *spans])),
        checker.rest,
        checker.leans,
    )
    if hints is None:
        hints = np.empty((0, len(start)))
    found = _search(checker, query, latest, hints, settings, seed)
    return delayed(checker, found, query) if linger and found is not None else found


def _cut(windows: Array, earliest: float, latest: float) -> Array:
    """Return the parts of spans between two times."""
    out = np.clip(windows, earliest, latest)
    out[:, 1] = np.where(np.isinf(windows[:, 1]), latest, out[:, 1])
    keep = (windows[:, 1] >= earliest) & (windows[:, 0] <= latest)
    return np.asarray(out[keep])


def _search(
    checker: SpaceTimeChecker,
    query: Query,
    latest: float,
    hints: Array,
    settings: RrtSettings,
    seed: int,
) -> SpaceTimePath | None:
    begin = float(query.begin.min())
    earliest = min(
        next_arrival(query, g, least_time(query, query.start, begin, g))
        for g in range(len(query.goals))
    )
    if not earliest <= latest or np.isinf(earliest):
        return None  # no goal is ever free when one could be there
    # Some while after all others have stopped nothing changes any more.
    calm = max(checker.world.end, earliest)
    horizon = min(latest, calm + 4.0 * _least(query) + 20.0)
    best = _without_search(checker, query, horizon, earliest, settings)
    if best is not None and best.arrival <= earliest + settings.good_enough:
        return best
    hints = np.concatenate([hints, *_drive_ways(checker, query, settings.drives)])
    samples = 0
    for turn in range(settings.rounds):
        at = seed + turn
        if settings.checks > 0:
            around = _over_roadmap(
                checker, query, best, horizon, earliest, hints, settings, at
            )
            if around is not None:
                best = _improve(checker, around, query, settings, at)
        enough = max(settings.good_enough, settings.bearable)
        if best is not None and best.arrival <= earliest + enough:
            break
        limits = Limits(
            settings.iterations if best is None else settings.patience,
            settings.patience,
            settings.weight,
            settings.reach,
            settings.growth,
            settings.good_enough,
            horizon,
            seed * 64 + turn,
        )
        bound = np.inf if best is None else best.arrival
        time, path, goal, drawn, _ = grow(checker.scene, query, limits, bound)
        samples += int(drawn)
        if goal >= 0:
            found = SpaceTimePath(time, path, int(goal), earliest)
            best = _improve(checker, found, query, settings, at)
        if best is not None and best.arrival <= earliest + settings.good_enough:
            break
    return None if best is None else replace(best, samples=samples)


def _drive_ways(checker: SpaceTimeChecker, query: Query, most: int) -> list[Array]:
    """Return ways for the base of a robot that moves alone to drive to each goal."""
    if most == 0 or len(checker.robots) > 1 or not is_mobile(checker.models[0]):
        return []
    return [drive_way(checker.scene, query, k, most) for k in range(len(query.goals))]


def _least(query: Query) -> float:
    """Return the time that speeds allow to the nearest goal [s]."""
    begin = float(query.begin.min())
    goals = range(len(query.goals))
    return min(least_time(query, query.start, begin, g) for g in goals) - begin


def _without_search(
    checker: SpaceTimeChecker,
    query: Query,
    horizon: float,
    earliest: float,
    settings: RrtSettings,
) -> SpaceTimePath | None:
    """Return the earliest of the ways that need no search, None where they are all blocked."""
    if settings.direct == 0:
        return None
    best: SpaceTimePath | None = None
    times, ways, counts, goals, clear = leaning_ways(
        checker.scene, query, horizon, settings.direct, settings.stands
    )
    for k, count in reversed(list(enumerate(counts.tolist()))):
        way = SpaceTimePath(times[k, :count], ways[k, :count], int(goals[k]), earliest)
        latest = horizon if best is None else best.arrival
        if way.arrival >= latest:
            continue
        if not (clear and k == len(counts) - 1):
            found = retimed(checker, way, query, latest)
            if found is None:
                continue
            way = found
        best = way
    return best


def _over_roadmap(
    checker: SpaceTimeChecker,
    query: Query,
    best: SpaceTimePath | None,
    horizon: float,
    earliest: float,
    hints: Array,
    settings: RrtSettings,
    seed: int,
) -> SpaceTimePath | None:
    """Return a path that arrives earlier than the best one so far, over a random roadmap."""
    extra = hints
    bound = min(horizon, earliest + settings.worst)
    # As wide as that there are ways around; waits make them no wider.
    begin = float(query.begin.min())
    least = _least(query)
    wide = begin + least + max(0.5 * least, _AROUND)
    if best is not None:
        extra = np.concatenate([hints, np.unique(best.path, axis=0)])
        bound = min(bound, best.arrival - settings.good_enough)
        wide = min(wide, bound)
    time, path, goal, _ = search_roadmap(
        checker.scene,
        query,
        extra,
        max(settings.vertices, 1 + len(query.goals) + len(extra)),
        settings.neighbours,
        settings.checks,
        checker.step,
        earliest - least - _AROUND,
        bound,
        wide,
        seed,
    )
    if goal < 0:
        return None
    keep = np.concatenate([[True], np.diff(time) > 1e-9])
    return SpaceTimePath(time[keep], path[keep], int(goal), earliest)


def _improve(
    checker: SpaceTimeChecker,
    found: SpaceTimePath,
    query: Query,
    settings: RrtSettings,
    seed: int,
) -> SpaceTimePath:
    """Return a path that goes less far, and arrives no later."""
    for turn in range(3):
        before = found.arrival
        found = shorten(checker, found, query, settings.shortcuts, 8 * seed + turn)
        found = hasten(checker, found, query)
        if found.arrival > before - settings.good_enough:
            break
    return found
