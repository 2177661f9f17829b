"""Search for an assignment with a short predicted makespan, starting from the result of the integer program."""

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
from planning.tasks.found_assignment import FoundAssignment

MOST_CHOICES = 4000
"""Greatest number of alternatives of all steps for a search, since each is expanded to tasks."""

_MOVES_PER_STEP, _MOST_STEPS_SEEN = 400, 500_000
"""Default number of moves per step, and the greatest product of the numbers of moves and steps."""

_RUNS = 3
"""Number of runs that share the moves: plans that are predicted to be as long differ by several per cent."""


def search_assignments(
    cell: Workcell,
    work: Assembly,
    plan: TaskPlan,
    settings: MotionSettings,
    moves: int | None = None,
) -> FoundAssignment | None:
    """Return the assignments that are predicted to end first among those that each run looks at.

    There is no search if robots change tools or keep holding what they placed, or if there are machines: the prediction
    of the makespan does not model these.

    Args:
        cell: where it is built.
        work: what is built.
        plan: that of the integer program.
        settings: how tasks are turned into motions.
        moves: assignments to look at; by default as many as the number of steps asks for.
    """
    problem = work.problem
    if problem.kept or problem.changes or cell.machines:
        return None
    choices = list(islice(step_choices(problem), MOST_CHOICES + 1))
    if len(choices) > MOST_CHOICES:
        return None
    number = {choice: k for k, choice in enumerate(choices)}
    if any(choice not in number for choice in plan.choices):
        return None
    model = build_model(cell, work, plan, choices, settings)
    start = np.array([number[choice] for choice in plan.choices])
    neighbours, steps = list_neighbours(model, problem), len(start)
    if moves is None:
        moves = min(_MOVES_PER_STEP * steps, _MOST_STEPS_SEEN // steps)
    predicted: dict[TaskPlan, float] = {}
    for run in range(_RUNS):
        share, seed = -(-(moves - run) // _RUNS), settings.seed * _RUNS + run
        makespan, best = anneal(model, neighbours, start, share, seed)
        predicted[TaskPlan(tuple(choices[k] for k in best))] = makespan
    plans = sorted(((s, plan) for plan, s in predicted.items()), key=lambda p: p[0])
    return FoundAssignment(tuple(plans), predict_makespan(model, start), moves)
