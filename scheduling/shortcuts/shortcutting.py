"""Shortcutting of a temporal plan graph (APEX-MR, section IV-C): an anytime search with seeded random candidates.

A candidate joins two points of consecutive transits: by path smoothing among static obstacles, by a straight
line, by two lines with one corner, or by straightening the motion of a single joint. It is accepted if it is free
of collisions, if it can be ordered with all other nodes, and if the makespan does not increase. Only transits on
a critical path are shortened, because on other transits a robot would only wait longer. Each span of transits is
first smoothed as a whole, then in parts. The search ends when candidates hardly reduce the makespan any more, or
after a fixed number of them, so the same seed gives the same plan. It can also end after a time limit, as in the
paper. Optionally, sidesteps follow: paths around a corner that avoid a wait.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from planning.motion.speed import SpeedModel
from planning.progress import Progress, no_progress
from planning.transforms import Array
from scheduling.conflicts.derived_tpg import DerivedTpg, OccupantConflicts
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.shortcuts.candidates import CORNER, candidate_path, join_nodes
from scheduling.shortcuts.shortcut_search import ShortcutSearch
from scheduling.shortcuts.static_scene import SmoothedPathCache

_SAME = 1e-7
"""Times that differ by less are the same [s]."""

_LEAST = 1e-6
"""Least time by which a sidestep has to make the plan end sooner [s]."""

_ASIDE = 0.3
"""Spread of corners around the straight path [rad or m]."""

_SPREAD = 0x51DE
"""Second seed: the draws of sidesteps differ from those of shortcuts with the same seed."""

_QUICK = 8
"""Most candidates for each span in a quick estimate."""


def _apply_sidesteps(
    search: ShortcutSearch, candidates: int, seed: int, progress: Progress = no_progress
) -> None:
    """Shorten the makespan of a search by sidesteps: corners that avoid critical waits.

    A shortcut must save time of its own robot. If a wait of one robot for another is critical, a
    path of the same length may also help: one that blocks the other robot later, or lets it pass sooner. The
    transits of both robots at such waits get a random corner, which is kept if the whole plan ends sooner.

    Args:
        search: the graph, with its transit spans, after shortcuts.
        candidates: most candidates drawn. The search ends earlier if a window of them, as long
            as those of shortcuts, hardly shortens the makespan.
        seed: of the draws.
        progress: called with candidates done and in all.
    """
    rng = np.random.default_rng([seed, _SPREAD])
    candidates_at_waits = spans_beside_waits(search)
    since, before = 0, search.makespan
    for done in range(candidates):
        if not candidates_at_waits:
            break
        if since == search.window:
            if not search.has_saved_enough(before):
                break
            since, before = 0, search.makespan
        since += 1
        which, node = candidates_at_waits[int(rng.integers(len(candidates_at_waits)))]
        span = search.spans[which]
        # Half of the candidates begin or end at an end of the span: long paths have the most room.
        first = (
            span.first
            if rng.random() < 0.5
            else int(rng.integers(span.first, node + 1))
        )
        last = (
            span.last if rng.random() < 0.5 else int(rng.integers(node, span.last + 1))
        )
        path = _around_corner(
            search, span.chain, search.waypoints(span.chain, first, last), rng
        )
        if search.try_candidate(which, first, last, path, sooner=_LEAST):
            candidates_at_waits = spans_beside_waits(search)
        if done % 16 == 0:
            progress(done, candidates)
    progress(candidates, candidates)


def spans_beside_waits(search: ShortcutSearch) -> list[tuple[int, int]]:
    """Return the transit spans at both sides of critical waits for motions.

    Returns:
        Number of the span, and its node that waits or is waited for.
    """
    spans = search.spans
    found = []
    for chain, node in critical_conflict_nodes(search.graph):
        found += [
            (which, node)
            for which, span in enumerate(spans)
            if span.chain == chain and span.first <= node <= span.last
        ]
    return found


def critical_conflict_nodes(graph: DerivedTpg) -> list[tuple[int, int]]:
    """Return the end nodes of the conflict edges on a critical path of a graph.

    The path is followed from its end: from each node to the previous one of its robot if there is no
    wait between them, else to the node that it waits for.
    """
    tpg, rollout = graph.tpg, graph.rollout
    before: dict[tuple[int, int], list[tuple[int, int, bool]]] = {}
    for (i, u, k, v), cause in zip(tpg.edges.tolist(), tpg.cause.tolist(), strict=True):
        before.setdefault((k, v), []).append((i, u, cause == MOTION_CONFLICT))
    ends = [float(end[-1]) if len(end) else 0.0 for end in rollout.end]
    chain = int(np.argmax(ends))
    node = len(rollout.end[chain]) - 1
    found: list[tuple[int, int]] = []
    while node >= 0:
        begin = float(rollout.start[chain][node])
        if node > 0 and begin - float(rollout.end[chain][node - 1]) < _SAME:
            node -= 1
            continue
        late = [
            (i, u, conflict)
            for i, u, conflict in before.get((chain, node), ())
            if begin - float(rollout.end[i][u]) < _SAME
        ]
        if not late:
            break
        other, waited_for, conflict = late[0]
        if conflict:
            found += [(chain, node), (other, waited_for)]
        chain, node = other, waited_for
    return found


def _around_corner(
    search: ShortcutSearch, chain: int, path: Array, rng: np.random.Generator
) -> Array:
    """Return a path with the same ends over one corner, on the straight line or around it."""
    if rng.random() < 0.5:
        return candidate_path(path, CORNER, rng)
    tpg = search.graph.tpg
    model = tpg.cell.robot(tpg.chains[chain].robot).model
    corner = path[0] + rng.random() * (path[-1] - path[0])
    corner = corner + rng.normal(0.0, _ASIDE, len(corner))
    return np.array([path[0], np.clip(corner, model.lower, model.upper), path[-1]])


def shorten_tpg(
    tpg: TemporalPlanGraph,
    speeds: Mapping[str, SpeedModel],
    *,
    step: float,
    candidates: int,
    seed: int = 0,
    progress: Progress = no_progress,
    sidesteps: int = 0,
    seconds: float = 0.0,
    clock: Callable[[], float] = time.monotonic,
) -> TemporalPlanGraph:
    """Return a graph with transits replaced by shorter ones; the same graph if none was found.

    Args:
        tpg: a graph that keeps its invariant.
        speeds: speed model of each robot.
        step: longest time between pose nodes [s].
        candidates: most candidates drawn.
        seed: of the draws.
        progress: called with candidates done and in all.
        sidesteps: most sidesteps drawn after that, see ``_apply_sidesteps``.
        seconds: time limit, up to which candidates are drawn even without success; 0 to end when
            candidates no longer shorten the makespan [s].
        clock: returns the time [s].

    Raises:
        PlanInvariantError: the result breaks the invariant, a fault of this program.
    """
    search = ShortcutSearch(tpg, speeds, step)
    rng = np.random.default_rng(seed)
    since, before, begin = 0, search.makespan, clock()
    for done in range(candidates):
        spent = clock() - begin
        if seconds and spent >= seconds:
            break
        if since == search.window:
            if not seconds and not search.has_saved_enough(before):
                break
            since, before = 0, search.makespan
        searched = search.searched
        search.step(rng)
        # Progress is judged only after every span has been smoothed as a whole.
        since, before = (since + 1, before) if searched else (0, search.makespan)
        if done % 16 == 0:
            progress(*((spent, seconds) if seconds else (done, candidates)))
    progress(candidates, candidates)
    if sidesteps:
        _apply_sidesteps(search, sidesteps, seed, progress)
    if search.graph.tpg is tpg:
        return tpg
    shortened = join_nodes(search.graph, search.spans, step)
    check_invariant(DerivedTpg(shortened))
    return shortened


def smooth_spans(
    tpg: TemporalPlanGraph,
    speeds: Mapping[str, SpeedModel],
    *,
    step: float,
    seed: int = 0,
    known: SmoothedPathCache | None = None,
    conflicts: OccupantConflicts | None = None,
) -> DerivedTpg:
    """Return a graph with each critical span smoothed as a whole, once: a quick estimate of shortcutting.

    The arguments are those of ``shorten_tpg``, but the invariant is not checked. ``known`` and ``conflicts``
    are caches shared by graphs of the same cell and speeds; results are added to them. With ``known``,
    each path is smoothed with its own random draws.
    """
    search = ShortcutSearch(
        tpg, speeds, step, passes=1, known=known, conflicts=conflicts
    )
    rng = np.random.default_rng(seed)
    for _ in range(_QUICK * len(search.spans)):
        if search.searched:
            break
        search.step(rng)
    return search.graph
