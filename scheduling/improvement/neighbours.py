"""Plans next to a plan: one step done otherwise, or the robots of two steps exchanged."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.tasks.assignment import (
    AssignmentProblem,
    StepChoice,
    TaskPlan,
    alternatives,
)

_CHEAPEST = 4
"""Of the ways to do a step that differ in the same, only so many are drawn from."""

_NEAR = 6
"""Steps whose robots are exchanged are less than this apart."""

ROBOT, SUPPORT, OBJECT, GRASP, EXCHANGE = range(5)

KINDS = (ROBOT, ROBOT, EXCHANGE, EXCHANGE, SUPPORT, OBJECT, GRASP)
"""What may change, each as likely as it stands here."""


def draw_neighbour(
    problem: AssignmentProblem,
    plan: TaskPlan,
    critical: Sequence[int],
    rng: np.random.Generator,
) -> TaskPlan | None:
    """Return a plan next to another one, None where the draw leads nowhere.

    Args:
        problem: what the plan is a solution of.
        plan: the plan.
        critical: steps that the makespan hangs on; four of five draws begin with one of them.
        rng: of the draws.
    """
    kind = KINDS[int(rng.integers(len(KINDS)))]
    count = len(plan.choices)
    if critical and rng.random() < 0.8:
        step = int(critical[int(rng.integers(len(critical)))])
    else:
        step = 1 + int(rng.integers(count))
    if kind != EXCHANGE:
        return _changed(problem, plan, step, kind, rng)
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
    kind: int,
    rng: np.random.Generator,
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
