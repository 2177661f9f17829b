"""Search for an assignment with a short predicted makespan, by simulated annealing from that of the integer program."""

from __future__ import annotations

from itertools import islice
from typing import NamedTuple

import numpy as np

from planning.assignment_search.prediction_tables import (
    PredictionModel,
    PredictionTables,
    build_model,
)
from planning.assignment_search.rollout import (
    RolloutState,
    make_state,
    predict_makespan,
    run_rollout,
)
from planning.assignment_search.volumes import Volumes
from planning.cell.workcell import Workcell
from planning.kernels import inner_kernel, kernel
from planning.motion.sequential import MotionSettings
from planning.packed import packed
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import AssignmentProblem, TaskPlan, step_choices
from planning.tasks.found_assignment import FoundAssignment
from planning.transforms import Array, Indices

MOST_CHOICES = 4000
"""Greatest number of alternatives of all steps for a search, since each is expanded to tasks."""

_MOVES_PER_STEP, _MOST_STEPS_SEEN = 400, 500_000
"""Default number of moves per step, and the greatest product of the numbers of moves and steps."""

_RUNS = 3
"""Number of runs that share the moves: plans that are predicted to be as long differ by several per cent."""

_WARM, _COLD = 0.01, 0.0002
"""First and last temperature as shares of the makespan at the start."""

_NONE = -1

_DRAWS = 9
"""Random numbers of a move: step, number of steps, two for each of three steps, and one for the acceptance."""


def search_assignments(
    cell: Workcell,
    work: Assembly,
    plan: TaskPlan,
    settings: MotionSettings,
    moves: int | None = None,
) -> FoundAssignment | None:
    """Return the assignments that are predicted to end first among those that each run looks at.

    There is no search if robots change tools or keep holding what they placed, or if there are machines: the prediction
    of the makespan does not model these. The search begins with the plan of the integer program, and looks at so many
    assignments, by default as many as the number of steps asks for.
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


class Neighbours(NamedTuple):
    """Alternatives of each step, and the objects that they use.

    Attributes:
        first: index of the first choice of each step, shape (steps + 1,).
        item: number of the object of each choice, shape (c,).
        unlimited: whether an object may be used more than once, shape (objects,).
        after_first, after: objects that earlier steps must have used, for each choice.
    """

    first: Indices
    item: Indices
    unlimited: np.ndarray
    after_first: Indices
    after: Indices


def list_neighbours(model: PredictionModel, problem: AssignmentProblem) -> Neighbours:
    """Return the neighbours of assignments, given the problem of all choices of a model."""
    objects = sorted({choice.object for choice in model.choices})
    number = {name: k for k, name in enumerate(objects)}
    after = [
        [number[name] for name in sorted(choice.primary.after) if name in number]
        for choice in model.choices
    ]
    steps = len(problem.steps)
    return packed(
        Neighbours(
            np.searchsorted(model.tables.step, np.arange(steps + 1)).astype(np.int64),
            np.array([number[c.object] for c in model.choices], dtype=np.int64),
            np.array([name in problem.unlimited for name in objects]),
            np.cumsum([0, *map(len, after)]).astype(np.int64),
            np.array([k for row in after for k in row], dtype=np.int64),
        )
    )


def anneal(
    model: PredictionModel,
    neighbours: Neighbours,
    start: Indices,
    moves: int,
    seed: int,
) -> tuple[float, Indices]:
    """Return the shortest predicted makespan found in some moves [s], and the choice of each step, shape (steps,)."""
    state = make_state(model)
    chosen, best = start.copy(), start.copy()
    users = np.full(len(neighbours.unlimited), _NONE, dtype=np.int64)
    draws = np.random.default_rng(seed).random((moves, _DRAWS))
    found = run_annealing(
        model.tables, model.volumes, state, neighbours, chosen, best, users, draws
    )
    return float(found), best


@kernel
def run_annealing(
    tables: PredictionTables,
    volumes: Volumes,
    state: RolloutState,
    neighbours: Neighbours,
    chosen: Indices,
    best: Indices,
    users: Indices,
    draws: Array,
) -> float:
    """Anneal an assignment in place; return the least predicted makespan [s].

    Args:
        tables, volumes, state: of the predictions.
        neighbours: of the choices.
        chosen: the assignment, shape (steps,).
        best: the best one, written here.
        users: step that uses an object, -1 for none, shape (objects,); scratch.
        draws: numbers from 0 to 1 for each move, shape (moves, _DRAWS).
    """
    current = run_rollout(tables, volumes, state, chosen, True, np.inf)
    least, warm, cold = current, _WARM * current, _COLD * current
    trial = chosen.copy()
    for move in range(len(draws)):
        warmth = warm * (cold / warm) ** (move / len(draws))
        trial[:] = chosen
        users[:] = _NONE
        for step in range(len(trial)):
            users[neighbours.item[trial[step]]] = step
        step, count = int(draws[move, 0] * len(trial)), int(draws[move, 1] * 6)
        # Mostly one step, else two or three in a row, as when robots change places.
        count = max(1, count - 2)
        changed = True
        for k in range(count):
            if changed and step + k < len(trial):
                share, other = draws[move, 2 + 2 * k], draws[move, 3 + 2 * k]
                changed = _change(neighbours, trial, users, step + k, share, other)
        if not changed or not _is_in_order(neighbours, trial, users):
            continue
        most = current - warmth * np.log(1.0 - draws[move, 8])
        makespan = run_rollout(tables, volumes, state, trial, True, most)
        if makespan > most:
            continue
        current = makespan
        chosen[:] = trial
        if makespan < least - 1e-9:
            least = makespan
            best[:] = chosen
    return least


@inner_kernel
def _change(
    neighbours: Neighbours,
    trial: Indices,
    users: Indices,
    step: int,
    share: float,
    other_share: float,
) -> bool:
    """Give a step another choice; return False if the step that used its object has no other choice left."""
    item = neighbours.item
    first, end = neighbours.first[step], neighbours.first[step + 1]
    old, new = trial[step], first + int(share * (end - first))
    other = _NONE
    if item[new] != item[old] and not neighbours.unlimited[item[new]]:
        other = users[item[new]]
    users[item[old]] = _NONE
    if other != _NONE:
        replaced = _draw_choice(neighbours, users, other, other_share)
        if replaced == _NONE:
            return False
        trial[other] = replaced
        users[item[replaced]] = other
    trial[step] = new
    users[item[new]] = step
    return True


@inner_kernel
def _draw_choice(neighbours: Neighbours, users: Indices, step: int, draw: float) -> int:
    """Return a choice of a step whose object no step uses, -1 for none."""
    first, end = neighbours.first[step], neighbours.first[step + 1]
    item, unlimited = neighbours.item, neighbours.unlimited
    count = 0
    for k in range(first, end):
        count += unlimited[item[k]] or users[item[k]] == _NONE
    left = int(draw * count)
    for k in range(first, end):
        if unlimited[item[k]] or users[item[k]] == _NONE:
            if left == 0:
                return k
            left -= 1
    return _NONE


@inner_kernel
def _is_in_order(neighbours: Neighbours, chosen: Indices, users: Indices) -> bool:
    """Tell whether objects that block others are used before these."""
    for step in range(len(chosen)):
        k = chosen[step]
        for a in range(neighbours.after_first[k], neighbours.after_first[k + 1]):
            user = users[neighbours.after[a]]
            if user == _NONE or user >= step:
                return False
    return True
