"""Shortcutting of a temporal plan graph (APEX-MR IV-C): anytime, seeded, HOME skipped.

A candidate joins two points of a run of transits: by smoothing among static obstacles, by a straight line,
over a corner, or with a single joint straightened. It is accepted when it is free, when it can be ordered
with all other nodes, and when the makespan does not grow. Only critical runs are drawn: elsewhere a robot
would move less only to wait more. Each is first smoothed as a whole, then in parts. Whatever a candidate
does not change is reused. The search ends when candidates no longer pay, or after a number of them, so that
the same seed gives the same plan; or, on request, after a time limit, as in the paper. Sidesteps may
follow.
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
"""Sets the draws of sidesteps apart from those of shortcuts with the same seed."""

_QUICK = 8
"""Most candidates for each run in a quick look ahead."""


def _apply_sidesteps(
    board: ShortcutSearch, candidates: int, seed: int, progress: Progress = no_progress
) -> None:
    """Change the graph of a search by sidesteps as long as they pay.

    A shortcut has to save its robot time. Where the makespan hangs on a wait of one robot for another, a
    path of the same length may do as well: one that comes into the other's way later, or lets the other
    pass sooner. Runs
    of transits on both sides of such waits get a corner at random, and keep it where the whole plan ends sooner.

    Args:
        board: the graph, with its runs, after shortcuts.
        candidates: most candidates drawn. The search ends before when a window of them, as long
            as those of shortcuts, makes the plan hardly shorter.
        seed: of the draws.
        progress: called with candidates done and in all.
    """
    rng = np.random.default_rng([seed, _SPREAD])
    candidates_at_waits = runs_beside_waits(board)
    since, before = 0, board.makespan
    for done in range(candidates):
        if not candidates_at_waits:
            break
        if since == board.window:
            if not board.has_saved_enough(before):
                break
            since, before = 0, board.makespan
        since += 1
        which, node = candidates_at_waits[int(rng.integers(len(candidates_at_waits)))]
        span = board.spans[which]
        # Ends of the run are kept as often as not: most of the way there is the most room.
        first = (
            span.first
            if rng.random() < 0.5
            else int(rng.integers(span.first, node + 1))
        )
        last = (
            span.last if rng.random() < 0.5 else int(rng.integers(node, span.last + 1))
        )
        path = _around_corner(
            board, span.chain, board.waypoints(span.chain, first, last), rng
        )
        if board.try_candidate(which, first, last, path, sooner=_LEAST):
            candidates_at_waits = runs_beside_waits(board)
        if done % 16 == 0:
            progress(done, candidates)
    progress(candidates, candidates)


def runs_beside_waits(board: ShortcutSearch) -> list[tuple[int, int]]:
    """Return the runs next to critical waits for motions, at either end.

    Returns:
        Each as the number of a span and the node of it that waits, or is waited for.
    """
    spans = board.spans
    found = []
    for chain, node in critical_conflict_nodes(board.graph):
        found += [
            (which, node)
            for which, span in enumerate(spans)
            if span.chain == chain and span.first <= node <= span.last
        ]
    return found


def critical_conflict_nodes(graph: DerivedTpg) -> list[tuple[int, int]]:
    """Return the end nodes of the conflict edges on a critical path of a graph.

    It is followed from its end: from each node to the one before it on its robot where they
    follow each other at once, else to the node that it waits for.
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
    board: ShortcutSearch, chain: int, path: Array, rng: np.random.Generator
) -> Array:
    """Return a path with the same ends over one corner, on the straight line or around it."""
    if rng.random() < 0.5:
        return candidate_path(path, CORNER, rng)
    tpg = board.graph.tpg
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
    """Return a graph with runs of transit nodes replaced by shorter ones.

    It is the same graph where no replacement was found.

    Args:
        tpg: a graph that keeps its invariant.
        speeds: speed model of each robot.
        step: longest time between pose nodes [s].
        candidates: most candidates drawn.
        seed: of the draws.
        progress: called with candidates done and in all.
        sidesteps: most sidesteps drawn after that, see ``_apply_sidesteps``.
        seconds: how long candidates are drawn, whether they pay or not; the one that is looked at
            then is the last. 0 for as long as they pay [s].
        clock: returns the time [s].

    Raises:
        PlanInvariantError: the result breaks the invariant, a fault of this program.
    """
    board = ShortcutSearch(tpg, speeds, step)
    rng = np.random.default_rng(seed)
    since, before, begin = 0, board.makespan, clock()
    for done in range(candidates):
        spent = clock() - begin
        if seconds and spent >= seconds:
            break
        if since == board.window:
            if not seconds and not board.has_saved_enough(before):
                break
            since, before = 0, board.makespan
        searched = board.searched
        board.step(rng)
        # Every run is smoothed as a whole in any case.
        since, before = (since + 1, before) if searched else (0, board.makespan)
        if done % 16 == 0:
            progress(*((spent, seconds) if seconds else (done, candidates)))
    progress(candidates, candidates)
    if sidesteps:
        _apply_sidesteps(board, sidesteps, seed, progress)
    if board.graph.tpg is tpg:
        return tpg
    shortened = join_nodes(board.graph, board.spans, step)
    check_invariant(DerivedTpg(shortened))
    return shortened


def smooth_runs(
    tpg: TemporalPlanGraph,
    speeds: Mapping[str, SpeedModel],
    *,
    step: float,
    seed: int = 0,
    known: SmoothedPathCache | None = None,
    conflicts: OccupantConflicts | None = None,
) -> DerivedTpg:
    """Return a graph with each relevant run smoothed as a whole, once: a quick estimate.

    It has not been checked as ``shorten_tpg`` does, whose arguments these are. To ``known`` and
    ``conflicts``, what was found for other graphs of the same cell and speeds, what is found is added;
    each path is then smoothed with draws of its own.
    """
    board = ShortcutSearch(
        tpg, speeds, step, passes=1, known=known, conflicts=conflicts
    )
    rng = np.random.default_rng(seed)
    for _ in range(_QUICK * len(board.spans)):
        if board.searched:
            break
        board.step(rng)
    return board.graph
