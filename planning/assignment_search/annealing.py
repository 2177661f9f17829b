"""Simulated annealing over the choices of all steps, by the predicted makespan."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.assignment_search.prediction_tables import (
    PredictionModel,
    PredictionTables,
)
from planning.assignment_search.rollout import Scratch, make_scratch, run_rollout
from planning.assignment_search.volumes import Volumes
from planning.kernels import inner_kernel, kernel
from planning.packed import packed
from planning.tasks.assignment import AssignmentProblem
from planning.transforms import Array, Indices

_WARM, _COLD = 0.01, 0.0002
"""First and last temperature as shares of the makespan at the start."""

_NONE = -1


class Neighbours(NamedTuple):
    """What may be chosen in place of what.

    Attributes:
        first: where the choices of a step begin, shape (steps + 1,).
        item: number of the object of each choice, shape (c,).
        unlimited: whether an object may be used more than once, shape (objects,).
        after_first, after: objects that steps before must have used, of each choice.
    """

    first: Indices
    item: Indices
    unlimited: np.ndarray
    after_first: Indices
    after: Indices


def list_neighbours(model: PredictionModel, problem: AssignmentProblem) -> Neighbours:
    """Return the neighbours of assignments.

    Args:
        model: with the choices of all steps in their order.
        problem: what they are choices of.
    """
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
    """Return the shortest assignment that was found, with its predicted makespan [s].

    Args:
        model: predicts makespans.
        neighbours: of its choices.
        start: number of the choice of each step, shape (steps,).
        moves: assignments to look at.
        seed: of the draws.
    """
    scratch = make_scratch(model)
    chosen, best = start.copy(), start.copy()
    users = np.full(len(neighbours.unlimited), _NONE, dtype=np.int64)
    draws = np.random.default_rng(seed).random((moves, 4))
    found = run_annealing(
        model.tables, model.volumes, scratch, neighbours, chosen, best, users, draws
    )
    return float(found), best


@kernel
def run_annealing(
    tables: PredictionTables,
    volumes: Volumes,
    scratch: Scratch,
    neighbours: Neighbours,
    chosen: Indices,
    best: Indices,
    users: Indices,
    draws: Array,
) -> float:
    """Anneal an assignment in place; return the least predicted makespan [s].

    Args:
        tables, volumes, scratch: of the predictions.
        neighbours: of the choices.
        chosen: the assignment, shape (steps,).
        best: the best one, written here.
        users: step that uses an object, -1 for none, shape (objects,); scratch.
        draws: four numbers from 0 to 1 for each move, shape (moves, 4).
    """
    item = neighbours.item
    for step in range(len(chosen)):
        users[item[chosen[step]]] = step
    current = run_rollout(tables, volumes, scratch, chosen, True)
    least, warm, cold = current, _WARM * current, _COLD * current
    for move in range(len(draws)):
        warmth = warm * (cold / warm) ** (move / len(draws))
        step = int(draws[move, 0] * len(chosen))
        first, end = neighbours.first[step], neighbours.first[step + 1]
        old, new = chosen[step], first + int(draws[move, 1] * (end - first))
        if new == old:
            continue
        other = other_old = _NONE
        if item[new] != item[old] and not neighbours.unlimited[item[new]]:
            other = users[item[new]]
        if other != _NONE:
            # The step that has used the object takes the one that is free now.
            other_old = chosen[other]
            swapped = _draw_choice(neighbours, other, item[old], draws[move, 2])
            if swapped == _NONE:
                continue
            chosen[other] = swapped
        chosen[step] = new
        users[item[old]] = other
        users[item[new]] = step
        if _is_in_order(neighbours, chosen, users):
            makespan = run_rollout(tables, volumes, scratch, chosen, True)
            worse = makespan - current
            if worse <= 0.0 or draws[move, 3] < np.exp(-worse / warmth):
                current = makespan
                if makespan < least - 1e-9:
                    least = makespan
                    best[:] = chosen
                continue
        chosen[step] = old
        users[item[new]] = other
        users[item[old]] = step
        if other != _NONE:
            chosen[other] = other_old
    return least


@inner_kernel
def _draw_choice(neighbours: Neighbours, step: int, item: int, draw: float) -> int:
    """Return a choice of a step that uses an object, -1 for none."""
    first, end = neighbours.first[step], neighbours.first[step + 1]
    count = 0
    for k in range(first, end):
        count += neighbours.item[k] == item
    left = int(draw * count)
    for k in range(first, end):
        if neighbours.item[k] == item:
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
