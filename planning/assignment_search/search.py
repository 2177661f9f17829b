"""Search for assignments that are predicted to end soon, started from that of the integer program."""

from __future__ import annotations

from itertools import islice

import numpy as np

from planning.assignment_search.annealing import anneal, list_neighbours
from planning.assignment_search.prediction_tables import build_model
from planning.assignment_search.rollout import predict_makespan
from planning.cell.workcell import Workcell
from planning.motion.sequential import MotionSettings
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan, step_choices

MOST_CHOICES = 4000
"""Greatest number of alternatives of all steps that are searched: they are expanded one by one."""

_MOVES_PER_STEP, _MOST_STEPS_SEEN = 2000, 3_000_000
"""Moves of a search, and the greatest number of them times the steps that each goes through."""

_SEARCHES = 2
"""Searches with different draws."""


def search_assignments(
    cell: Workcell, work: Assembly, plan: TaskPlan, settings: MotionSettings
) -> list[TaskPlan]:
    """Return assignments that are predicted to end sooner than a plan, the most promising first.

    There are none where robots change tools or keep holding what they placed, or where machines work:
    predictions know neither.

    Args:
        cell: where it is built.
        work: what is built.
        plan: that of the integer program.
        settings: how tasks are turned into motions.
    """
    problem = work.problem
    if problem.kept or problem.changes or cell.machines:
        return []
    choices = list(islice(step_choices(problem), MOST_CHOICES + 1))
    if len(choices) > MOST_CHOICES:
        return []
    number = {choice: k for k, choice in enumerate(choices)}
    if any(choice not in number for choice in plan.choices):
        return []
    model = build_model(cell, work, plan, choices, settings)
    start = np.array([number[choice] for choice in plan.choices])
    neighbours, steps = list_neighbours(model, problem), len(start)
    moves = min(_MOVES_PER_STEP * steps, _MOST_STEPS_SEEN // steps)
    planned, found = predict_makespan(model, start), dict[TaskPlan, float]()
    for search in range(_SEARCHES):
        seed = settings.seed + search
        makespan, best = anneal(model, neighbours, start, moves, seed)
        if makespan < planned:
            found[TaskPlan(tuple(choices[k] for k in best))] = makespan
    return sorted(found, key=found.__getitem__)
