"""Plans whose steps are in another order: one is moved past its neighbours, one after another."""

from __future__ import annotations

from dataclasses import replace

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
