"""Plans next to a plan: a step done otherwise, the robots of two exchanged, or a step moved.

Plans whose steps are in another order: one is moved past its neighbours, one after another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from planning.tasks.assignment import (
    AssignmentProblem,
    StepChoice,
    TaskPlan,
    alternatives,
)
from planning.tasks.work import AssemblyWork


def move_step(
    work: AssemblyWork, plan: TaskPlan, step: int, places: int
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan in which a step is done later or sooner, None where it stays in its place.

    It is moved as far as that can be: each of the orders between is one to build in as well.

    Args:
        work: what the plan is a plan of.
        plan: the plan.
        step: that is moved, counted from 1.
        places: by how many places it is moved on at most, negative to move it up.
    """
    moved: tuple[AssemblyWork, TaskPlan] | None = None
    for k in range(abs(places)):
        at = step + k if places > 0 else step - k - 1
        further = exchange_steps(*(moved or (work, plan)), at)
        if further is None:
            break
        moved = further
    return moved


def exchange_steps(
    work: AssemblyWork, plan: TaskPlan, at: int
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan in which a step and the next one are exchanged, None where that cannot be.

    Both are done as they were as far as that is possible in their new places.

    Args:
        work: what the plan is a plan of.
        plan: the plan.
        at: the first of the two, counted from 1.
    """
    if not 1 <= at < len(plan.choices):
        return None
    other = work.exchanged(at)
    if other is None:
        return None
    a, b = _at_step(plan[at + 1], at), _at_step(plan[at], at + 1)
    plan = plan.with_choice(a).with_choice(b)
    for wanted in (a, b):
        choice = _most_alike(other.problem, plan, wanted)
        if choice is None:
            return None
        plan = plan.with_choice(choice)
    return other, plan


def _at_step(choice: StepChoice, step: int) -> StepChoice:
    """Return a choice as one of another step."""
    support = choice.support and replace(choice.support, step=step)
    return StepChoice(replace(choice.primary, step=step), support)


def _most_alike(
    problem: AssignmentProblem, plan: TaskPlan, wanted: StepChoice
) -> StepChoice | None:
    """Return the way to do a step of a plan that differs least from what is wanted there."""
    # What is wanted may not be a way to do it: no way is taken for the present one.
    unlike = StepChoice(replace(wanted.primary, cost=-1.0), wanted.support)
    ways = alternatives(problem, plan.with_choice(unlike), wanted.step)

    def unalike(way: StepChoice) -> tuple[bool, bool, bool, bool, float]:
        a, b = way.primary, wanted.primary
        return (
            (a.robot, a.partner) != (b.robot, b.partner),
            a.object != b.object,
            a.grasp != b.grasp,
            (way.support and way.support.pose) != (b_support and b_support.pose),
            way.cost,
        )

    b_support = wanted.support
    return min(ways, key=unalike, default=None)


_CHEAPEST = 4
"""Of the ways to do a step that differ in the same, only so many are drawn from."""

_NEAR = 6
"""Steps whose robots are exchanged are less than this apart."""

_PLACES = 3
"""A step is moved by at most so many places."""

_MOVES = 6
"""So many steps are tried before no move is drawn."""

ROBOT, SUPPORT, OBJECT, GRASP, EXCHANGE, ORDER = range(6)

KINDS = (ROBOT, ROBOT, EXCHANGE, EXCHANGE, ORDER, ORDER, SUPPORT, OBJECT, GRASP)
"""What may change, each as likely as it stands here."""


def draw_neighbour(
    work: AssemblyWork,
    plan: TaskPlan,
    critical: Sequence[int],
    rng: np.random.Generator,
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan next to another one, None where the draw leads nowhere.

    Args:
        work: what the plan is a plan of.
        plan: the plan.
        critical: steps that the makespan hangs on; four of five draws begin with one of them.
        rng: of the draws.

    Returns:
        The plan, and what it is a plan of: the same work, or one with its steps in another order.
    """
    kind = KINDS[int(rng.integers(len(KINDS)))]
    count = len(plan.choices)
    if critical and rng.random() < 0.8:
        step = int(critical[int(rng.integers(len(critical)))])
    else:
        step = 1 + int(rng.integers(count))
    if kind == ORDER:
        return _moved(work, plan, step, rng)
    change = _exchanged if kind == EXCHANGE else partial(_changed, kind=kind)
    found = change(work.problem, plan, step, rng)
    return None if found is None else (work, found)


def _moved(
    work: AssemblyWork, plan: TaskPlan, step: int, rng: np.random.Generator
) -> tuple[AssemblyWork, TaskPlan] | None:
    """Return a plan with a step moved, one way or the other; another step if it cannot be."""
    for _ in range(_MOVES):
        places = (1 + int(rng.integers(_PLACES))) * (1 if rng.random() < 0.5 else -1)
        for way in (places, -places):
            found = move_step(work, plan, step, way)
            if found is not None:
                return found
        step = 1 + int(rng.integers(len(plan.choices)))
    return None


def _exchanged(
    problem: AssignmentProblem, plan: TaskPlan, step: int, rng: np.random.Generator
) -> TaskPlan | None:
    count = len(plan.choices)
    near = [
        k
        for k in range(max(1, step - _NEAR + 1), min(count, step + _NEAR - 1) + 1)
        if plan[k].robot != plan[step].robot
    ]
    if not near:
        return None
    other = near[int(rng.integers(len(near)))]
    robots = {step: plan[other].robot, other: plan[step].robot}
    for one, robot in robots.items():
        found = _drawn(
            [c for c in alternatives(problem, plan, one) if c.robot == robot], rng
        )
        if found is None:
            return None
        plan = plan.with_choice(found)
    return plan


def _changed(
    problem: AssignmentProblem,
    plan: TaskPlan,
    step: int,
    rng: np.random.Generator,
    *,
    kind: int,
) -> TaskPlan | None:
    now = plan[step]
    found = _drawn(
        [c for c in alternatives(problem, plan, step) if _difference(now, c) == kind],
        rng,
    )
    return None if found is None else plan.with_choice(found)


def _difference(now: StepChoice, other: StepChoice) -> int:
    """Return the first thing in which two ways to do a step differ."""
    if now.robot != other.robot or now.primary.partner != other.primary.partner:
        return ROBOT
    if now.support != other.support:
        return SUPPORT
    return OBJECT if now.object != other.object else GRASP


def _drawn(choices: list[StepChoice], rng: np.random.Generator) -> StepChoice | None:
    """Return one of the cheapest choices."""
    if not choices:
        return None
    best = sorted(choices, key=lambda choice: choice.cost)[:_CHEAPEST]
    return best[int(rng.integers(len(best)))]
