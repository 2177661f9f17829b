"""Shortcutting of a temporal plan graph (APEX-MR IV-C): anytime, seeded, HOME skipped.

A candidate joins two places of a run of transits: by what smoothing makes of the way between them
where nothing but standing things counts, by a straight line, over a corner, or with a single joint
straightened. It is taken when it is free, when it can be ordered with everyone else's nodes, and
when the plan does not end later. Only runs that the makespan hangs on are drawn: elsewhere a robot
would move less only to wait more. Each is first smoothed as a whole, then in parts. What a candidate
does not change is not worked out again. The search ends when candidates do not pay any more, or
after a number of them, so that the same seed gives the same plan; or, if that is asked for, it goes
on for a time, as in the paper. Sidesteps may follow.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np

from planning.motion.speed import SpeedModel
from planning.progress import Progress, no_progress
from scheduling.conflicts.derived_tpg import DerivedTpg, StretchConflicts
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.invariant import check_invariant
from scheduling.shortcuts.board import Board
from scheduling.shortcuts.candidates import join_nodes
from scheduling.shortcuts.scenery import KnownWays
from scheduling.shortcuts.sidesteps import take_sidesteps

_QUICK = 8
"""Most candidates for each run in a quick look ahead."""


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
        progress: told candidates done and in all.
        sidesteps: most sidesteps drawn after that, see ``take_sidesteps``.
        seconds: how long candidates are drawn, whether they pay or not; the one that is looked at
            then is the last. 0 for as long as they pay [s].
        clock: returns the time [s].

    Raises:
        PlanInvariantError: the result breaks the invariant, a fault of this program.
    """
    board = Board(tpg, speeds, step)
    rng = np.random.default_rng(seed)
    since, before, begin = 0, board.makespan, clock()
    for done in range(candidates):
        spent = clock() - begin
        if seconds and spent >= seconds:
            break
        if since == board.window:
            if not seconds and not board.worth(before):
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
        take_sidesteps(board, sidesteps, seed, progress)
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
    known: KnownWays | None = None,
    conflicts: StretchConflicts | None = None,
) -> DerivedTpg:
    """Return a graph with the runs that matter smoothed as a whole, once: a quick look ahead.

    It has not been checked as ``shorten_tpg`` does, whose arguments these are. To ``known`` and
    ``conflicts``, what was found for other graphs of the same cell and speeds, what is found is added;
    each path is then smoothed with draws of its own.
    """
    board = Board(tpg, speeds, step, passes=1, known=known, conflicts=conflicts)
    rng = np.random.default_rng(seed)
    for _ in range(_QUICK * len(board.spans)):
        if board.searched:
            break
        board.step(rng)
    return board.graph
