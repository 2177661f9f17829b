"""Plans that use only a subset of the robots, compared with the plan that may use all robots.

The integer program of the task assignment distributes steps over all robots and does not model waits between
robots. Where every step depends on the one before it, a third robot saves no time and only blocks the others.
Therefore, with more than two robots, the work is also planned for each subset of at least two of them, and each
plan is rated by its makespan. Unused robots stay at their home configuration. The plans for a cell with one more robot
thus include the plans for the cell without it, unless this robot is an obstacle even there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, islice

from planning.errors import InfeasibleStepError
from planning.progress import Progress, no_progress
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import AssignmentProblem, TaskPlan
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


def robot_subset_plans(
    work: Assembly, plan: TaskPlan
) -> list[tuple[Assembly, TaskPlan]]:
    """Return the plans of subsets of robots that differ from the plan of all of them, each with its work.

    Args:
        work: of all robots.
        plan: of all robots.
    """
    found: list[tuple[Assembly, TaskPlan]] = []
    for crew in robot_subsets(work.problem):
        own = replace(work, problem=work.problem.among(crew))
        with suppress(InfeasibleStepError):
            found.append((own, assign_steps(own.problem)))
    return [(own, other) for own, other in found if other != plan]


def rate_robot_subsets(
    rater: PlanRater,
    plans: Sequence[tuple[Assembly, TaskPlan]],
    start: RatedPlan,
    progress: Progress = no_progress,
) -> list[RatedPlan]:
    """Return the plan of all robots and those of subsets, without duplicates, best first.

    Args:
        rater: rates plans.
        plans: see ``robot_subset_plans``.
        start: the plan of all robots.
        progress: called with how many plans were rated, and of how many.
    """
    rated = {start.task_plan: start}
    for k, (own, plan) in enumerate(plans, start=1):
        if plan not in rated and (found := rater.rate(own, plan)) is not None:
            rated.setdefault(found.task_plan, replace(found, work=start.work))
        progress(k, len(plans))
    return sorted(rated.values(), key=lambda plan: plan.makespan_s)
