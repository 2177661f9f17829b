"""Anytime search for a better plan, from the one that the integer program chose.

That program adds up distances; it does not see who waits for whom. Here a plan is worth the
makespan of its own graph, with its own motions, the best order of its tasks that is found, and
transits smoothed past HOME. A plan next to the present one is drawn, mostly where the makespan hangs on, and becomes the present
one unless it is clearly worse than the best so far (record-to-record travel, Dueck 1993).
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from planning.progress import Progress, no_progress
from scheduling.improvement.neighbours import draw_neighbour
from scheduling.improvement.rated_plans import PlanRater, RatedPlan

_WORSE = 0.005
"""Share of the best makespan by which a plan may be worse and still be gone on from."""

_FAR = 0.05
"""Share by which a plan may be worse by way of HOME and still be looked at past HOME."""

_DRAWS = 200
"""Draws without a plan that is new after which the search ends."""


def improve_plan(
    rater: PlanRater,
    start: RatedPlan,
    *,
    seconds: float,
    tries: int,
    seed: int,
    clock: Callable[[], float] = time.monotonic,
    progress: Progress = no_progress,
) -> RatedPlan:
    """Return the best plan found; the given one where none is better.

    Args:
        rater: rates plans.
        start: where to begin.
        seconds: how long to search; a plan found so depends on the machine. 0 for no limit.
        tries: most plans rated; 0 for no limit.
        seed: of the draws.
        clock: that the seconds are read from.
        progress: told how much is done, and of how much.
    """
    begin = clock()
    rng = np.random.default_rng([seed, 7])
    best = present = start
    seen = {(start.work.order, start.task_plan)}
    idle = done = 0
    while (not tries or done < tries) and idle < _DRAWS:
        spent = clock() - begin
        if seconds and spent >= seconds:
            break
        drawn = draw_neighbour(present.work, present.task_plan, present.critical, rng)
        if drawn is None or (drawn[0].order, drawn[1]) in seen:
            idle += 1
            continue
        work, plan = drawn
        idle, done = 0, done + 1
        seen.add((work.order, plan))
        progress(done if tries else spent, tries or seconds)
        rated = rater.rate(work, plan, present.by_home_s * (1.0 + _FAR))
        if rated is None or rated.makespan_s > best.makespan_s * (1.0 + _WORSE):
            continue
        present = rated
        if rated.makespan_s < best.makespan_s - 1e-9:
            best = rated
    progress(1, 1)
    return best
