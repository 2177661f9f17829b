"""Plans that use only a subset of the robots, compared with the plan that may use all robots.

The integer program of the task assignment distributes steps over all robots and does not model waits between
robots. Where every step depends on the one before it, a third robot saves no time and only blocks the others.
Therefore, with more than two robots, the work is also planned for each subset of at least two of them, and each
plan is rated by its makespan. Unused robots stay at their home configuration. The plans for a cell with one more robot
thus include the plans for the cell without it, unless this robot is an obstacle even there.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations, islice

from planning.errors import InfeasibleStepError
from planning.progress import Progress, no_progress
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import AssignmentProblem
from planning.tasks.highs_solver import assign_steps
from scheduling.ordering.plan_rating import PlanRater, RatedPlan

_SMALLEST = 2
"""Robots of the smallest crew that is tried."""

_MOST_CREWS = 32
"""Greatest number of crews to try, larger ones first: all there are of up to five robots."""


def robot_subsets(problem: AssignmentProblem) -> Iterator[tuple[str, ...]]:
    """Yield subsets of robots that do all the work while the other robots stay idle.

    Args:
        problem: the work of all robots.
    """
    able = problem.capable_robots
    smaller = (
        crew
        for size in range(len(able) - 1, _SMALLEST - 1, -1)
        for crew in combinations(able, size)
    )
    return islice(smaller, _MOST_CREWS)


def rate_robot_subsets(
    rater: PlanRater,
    work: Assembly,
    start: RatedPlan,
    progress: Progress = no_progress,
) -> list[RatedPlan]:
    """Return the plan of all robots and those of subsets, without duplicates, best first.

    Args:
        rater: rates plans.
        work: of all robots.
        start: the plan of all robots.
        progress: called with how many crews were looked at, and of how many.
    """
    rated = {start.task_plan: start}
    tried = list(robot_subsets(work.problem))
    for k, crew in enumerate(tried, start=1):
        own = replace(work, problem=work.problem.among(crew))
        try:
            plan = assign_steps(own.problem)
        except InfeasibleStepError:
            plan = start.task_plan
        if plan not in rated and (found := rater.rate(own, plan)) is not None:
            rated.setdefault(found.task_plan, replace(found, work=work))
        progress(k, len(tried))
    return sorted(rated.values(), key=lambda plan: plan.makespan_s)
