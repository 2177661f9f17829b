"""Assignment of many steps by a rolling horizon.

The size of the complete integer program grows with steps times objects, and the time of branch and bound grows
faster. A window is the same program for a few steps. Choices of earlier windows are fixed: used objects are
absent, objects stacked on others may be absent, and the workload balance continues from the last steps. Only the
first choices of each window are kept; its other steps serve as look-ahead.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace

from planning.tasks.assignment import AssignmentProblem, StepChoice, TaskPlan, Tools

MOST_CONTESTED = 4000
"""Greatest number of candidates with single-use objects for one solve of the whole program."""

_WINDOW, _KEPT = 16, 8
"""Steps of a window, and how many of its choices are kept."""

Solve = Callable[[AssignmentProblem], TaskPlan | None]
"""Returns the cheapest plan of a problem, None where there is none."""


def needs_rolling_horizon(problem: AssignmentProblem) -> bool:
    """Tell whether a problem is better solved window by window.

    Endless supplies tie steps together by the balance of robots alone, which the whole program
    bears at any size: what counts is what can be used once.
    """
    limited = sum(p.object not in problem.unlimited for p in problem.primaries)
    return limited > MOST_CONTESTED


def solve_in_windows(problem: AssignmentProblem, solve: Solve) -> TaskPlan | None:
    """Return a plan that is cheapest in every window, None where no such plan is found.

    Where the choices kept leave a later step without an object, windows of twice as many steps are
    tried, up to half of the whole.

    Args:
        problem: with a candidate for every step.
        solve: of the problem of one window.
    """
    size, kept = _WINDOW, _KEPT
    while 2 * size <= max(len(problem.steps), 2 * _WINDOW):
        plan = _roll(problem, solve, size, kept)
        if plan is not None:
            return plan
        size, kept = 2 * size, 2 * kept
    return None


def _roll(
    problem: AssignmentProblem, solve: Solve, size: int, kept: int
) -> TaskPlan | None:
    settled: list[StepChoice] = []
    count = len(problem.steps)
    while len(settled) < count:
        first = len(settled) + 1
        last = min(first + size - 1, count)
        window, before = _window(problem, settled, last)
        plan = solve(window)
        if plan is None:
            return None
        ahead = count if last == count else first + kept - 1
        for choice in plan.choices[before : before + ahead - first + 1]:
            settled.append(_whole(problem, settled, choice))
    return TaskPlan(tuple(settled))


def _window(
    problem: AssignmentProblem, settled: list[StepChoice], last: int
) -> tuple[AssignmentProblem, int]:
    """Return the problem of the steps after the fixed ones, up to a last one.

    It begins with the settled steps that share a window of balance with the first open one.

    Returns:
        The problem, whose steps count from 1, and how many of them are settled.
    """
    open_from = len(settled) + 1
    before = min(len(settled), len(problem.capable_robots) - 1)
    away = open_from - before - 1
    used = {choice.object for choice in settled} - problem.unlimited
    mounted = dict(problem.mounted)
    for choice in settled[:away]:
        mounted |= dict(choice.tools)
    primaries, supports = [], []
    number_of: dict[int, int] = {}
    place_of: dict[int, int] = {}
    for choice in settled[len(settled) - before :]:
        own = replace(choice.primary, step=choice.step - away, after=frozenset())
        primaries.append(own)
        if choice.support is not None:
            supports.append(replace(choice.support, step=choice.step - away))
    for step in range(open_from, last + 1):
        for p in _window_candidates(problem, step, last - open_from + 1, used):
            item = problem.primaries[p]
            number_of[p] = len(primaries)
            primaries.append(replace(item, step=step - away, after=item.after - used))
        for s in problem.supports_of.get(step, []):
            place_of[s] = len(supports)
            supports.append(replace(problem.supports[s], step=step - away))
    steps = slice(away, last)
    clashes = {
        (number_of[p], place_of[s])
        for p, s in problem.incompatible
        if p in number_of and s in place_of
    }
    window = replace(
        problem,
        steps=problem.steps[steps],
        needs_support=problem.needs_support[steps],
        primaries=tuple(primaries),
        supports=tuple(supports),
        incompatible=frozenset(clashes),
        balance=1.0,
        mounted=mounted,
        returns=False,
        rejections=(),
    )
    unit = window.balance_weight
    if unit > 0.0:  # lambda is that of the whole problem
        window = replace(window, balance=problem.balance_weight / unit)
    return window, before


def _window_candidates(
    problem: AssignmentProblem, step: int, steps: int, used: set[str]
) -> list[int]:
    """Return the candidates of a step that a window may need.

    That many steps use at most so many objects: of those that a robot can place, the cheapest are
    enough, along with whatever stands on them.
    """
    by_robot: dict[tuple[str, str | None, Tools], list[int]] = defaultdict(list)
    for p in problem.primaries_of.get(step, []):
        item = problem.primaries[p]
        if item.object not in used:
            by_robot[item.robot, item.partner, item.tools].append(p)
    kept: set[int] = set()
    for own in by_robot.values():
        own.sort(key=lambda p: problem.primaries[p].cost)
        wanted: set[str] = set()
        for p in own:
            item = problem.primaries[p]
            if len(wanted) < steps or item.object in wanted:
                wanted |= {item.object, *(item.after - used)}
        kept.update(p for p in own if problem.primaries[p].object in wanted)
    return sorted(kept)


def _whole(
    problem: AssignmentProblem, settled: list[StepChoice], choice: StepChoice
) -> StepChoice:
    """Return a choice of a window as a choice of the whole problem."""
    step = len(settled) + 1
    for p in problem.primaries_of[step]:
        item = problem.primaries[p]
        same = replace(choice.primary, step=step, after=item.after)
        if item == same:
            support = choice.support
            return StepChoice(
                item, None if support is None else replace(support, step=step)
            )
    raise AssertionError(f"no candidate of step {step} is {choice.primary}")
