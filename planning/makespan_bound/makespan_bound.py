"""Lower bound of the makespan over all choices of robots, objects, grips and supports.

The relaxed problem ignores collisions: between two skills a robot moves straight. It keeps the tasks of each robot in the
order of the steps, the waits within a step and for the step before, and the least times between tasks. Dynamic
programming over the steps finds its shortest schedule.

A *label* is a state after some steps: the place of each robot, and the clocks of ``ChoiceTimes``. Labels that are
dominated by another one with the same places are dropped. If too many remain, neighbours are merged: the earliest of
their clocks are a lower bound for both.

One object may be used by several steps. Each use costs its price, and one use of each object is refunded, which makes
no plan longer that uses objects once: a lower bound for all prices that are not negative (Lagrangian relaxation).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.makespan_bound.choice_times import (
    NEVER,
    ChoiceReader,
    ChoiceTimes,
    LeastSeconds,
    least_seconds,
)
from planning.motion.numbered_configurations import NumberedConfigurations
from planning.motion.sequential import MotionSettings
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan, step_choices
from planning.transforms import Array, Indices

_MOST_CHOICES = 8000
"""Greatest number of choices of an assembly for which a bound is computed: they are expanded one by one."""

_MOST_LABELS, _MOST_ALIKE = 1000, 4
"""Greatest number of labels after a step, and of those with the same places."""

_MOST_EXTENSIONS = 1_300_000
"""Greatest number of labels times choices of all steps: about a second."""

_ROUNDS, _LAST_ROUNDS = 80, 20
"""Subgradient steps, and those at the end of which the mean of the prices is taken."""

_MOST_ROUND_EXTENSIONS = 54_000
"""Greatest number of labels times choices in each of them."""

_STRIDE, _FADING, _DEFLECTION = 0.15, 0.955, 0.7
"""First change of all prices as a share of the bound, and shares of the last stride and direction that are kept."""

_SAME = 1e-9
"""Clocks that differ by less are the same [s]."""

_STAYS = -2
"""In place of the number of a configuration: the robot takes no part."""


def makespan_bound_s(
    cell: Workcell, work: Assembly, plan: TaskPlan, settings: MotionSettings
) -> float | None:
    """Return a lower bound of the makespan at nominal durations over all choices [s].

    It holds for every plan in which each robot executes its tasks in the order of the steps. Robots return to HOME where
    they do in the given plan, which may be any.

    Returns:
        The bound, None where there are no choices, or too many.
    """
    choices = list(step_choices(work.problem))
    if not 0 < len(choices) <= _MOST_CHOICES:
        return None
    reader = ChoiceReader(cell, work, plan, settings)
    times = [reader.read(choice) for choice in choices]
    homes = [robot.home for robot in cell.robots]

    def seconds(k: int, apart: Array) -> Array:
        robot = cell.robots[k]
        turning = ~robot.model.chain.prismatic
        return least_seconds(settings.speeds[robot.name], turning, apart)

    schedules = PricedSchedules(times, homes, seconds, reader.ends_elsewhere)
    return raised_bound(schedules, work.problem.unlimited)


def raised_bound(schedules: PricedSchedules, unlimited: frozenset[str]) -> float:
    """Return the lower bound of the makespan that a deflected subgradient method finds [s].

    Its rounds keep few labels; the bounds without prices, and with the mean of the last ones, keep many. Directions are
    deflected as in Camerini, Fratta and Maffioli, On improving relaxation methods by modified gradient techniques, 1975.
    Unlimited objects may be used several times.
    """
    total = sum(len(step.objects) for step in schedules.steps)
    most, few = (
        max(1, min(_MOST_LABELS, extensions // total))
        for extensions in (_MOST_EXTENSIONS, _MOST_ROUND_EXTENSIONS)
    )
    limited = np.array([name not in unlimited for name in schedules.objects])
    bound, uses = schedules.shortest(np.zeros(len(limited)), most)
    if np.all(uses[limited] <= 1):
        return bound
    prices, direction, mean = np.zeros((3, len(limited)))
    for number in range(_ROUNDS):
        direction = np.where(limited, uses - 1, 0) + _DEFLECTION * direction
        change = np.where((direction > 0.0) | (prices > 0.0), direction, 0.0)
        stride = _STRIDE * bound * _FADING**number / max(1.0, np.abs(change).sum())
        prices = np.maximum(0.0, prices + stride * change)
        if number >= _ROUNDS - _LAST_ROUNDS:
            mean += prices / _LAST_ROUNDS
        _, uses = schedules.shortest(prices, few)
    return max(bound, schedules.shortest(mean, most)[0])


@dataclass(frozen=True)
class _Step:
    """The c choices of a step as arrays, for n robots, and r robots and machines.

    Attributes:
        objects: number of the object of each choice, shape (c,).
        matrices: those of ``ChoiceTimes``, shape (c, 1 + r, 1 + r) [s].
        start: row of each choice in ``travel``, shape (c, n).
        end: numbers of the last configurations, or _STAYS, shape (c, n).
        travel: for each robot the least times to its s - 1 first configurations, below a row of zeros, shape
            (s, p + 1): from those that it has ended a step in, by number, and from the nearest one [s].
    """

    objects: Indices
    matrices: Array
    start: Indices
    end: Indices
    travel: tuple[Array, ...]


@dataclass(frozen=True)
class _Labels:
    """Labels after a step.

    Attributes:
        clocks: shape (l, 1 + r) [s].
        places: number of the configuration of each robot, -1 for any that one has ended a step in, shape (l, n).
        choice: number of the choice by which each was reached, shape (l,).
        before: number of the label before it, shape (l,).
    """

    clocks: Array
    places: Indices
    choice: Indices
    before: Indices


class PricedSchedules:
    """Schedules of the relaxed problem, in which the use of an object has a price.

    Args:
        times: least times of the choices, in the order of the steps.
        homes: where each robot begins and, as a rule, ends, shape (n,) [rad or m].
        seconds: least times of the motions of a robot, by its number, from differences of configurations.
        ends_elsewhere: numbers of the robots that do not return to HOME.

    Attributes:
        objects: names of the objects, in the order of their prices.
        steps: the choices of each step.
    """

    def __init__(
        self,
        times: Sequence[ChoiceTimes],
        homes: Sequence[Array],
        seconds: LeastSeconds,
        ends_elsewhere: Collection[int] = (),
    ) -> None:
        self._seconds = seconds
        self._ends = [NumberedConfigurations(home) for home in homes]
        self.objects = sorted({item.choice.object for item in times})
        found: dict[int, list[ChoiceTimes]] = defaultdict(list)
        for item in times:
            found[item.choice.step].append(item)
        self.steps = [self._step(found[step]) for step in sorted(found)]
        self._back = [
            self._travel(k, home[None])[0] * (k not in ends_elsewhere)
            for k, home in enumerate(homes)
        ]

    def shortest(self, prices: Array, most: int) -> tuple[float, Indices]:
        """Return the least makespan plus prices of repeated uses, or less [s], and how often its schedule uses each object.

        Args:
            prices: of the objects, shape (o,) [s].
            most: greatest number of labels after a step.
        """
        none, size = np.zeros(1, dtype=np.int64), self.steps[0].matrices.shape[-1]
        places = np.zeros((1, len(self._ends)), dtype=np.int64)
        found = [_Labels(np.zeros((1, size)), places, none, none)]
        for step in self.steps:
            found.append(_reduced(_extended(found[-1], step, prices), most))
        clocks = found[-1].clocks.copy()
        for k, back in enumerate(self._back):
            clocks[:, 1 + k] += back[found[-1].places[:, k]]
        makespans, uses = clocks.max(axis=1), np.zeros(len(prices), dtype=np.int64)
        at = least = int(np.argmin(makespans))
        for labels, step in zip(found[:0:-1], self.steps[::-1], strict=True):
            uses[step.objects[labels.choice[at]]] += 1
            at = int(labels.before[at])
        return float(makespans[least] - prices.sum()), uses

    def _step(self, items: Sequence[ChoiceTimes]) -> _Step:
        start = np.zeros((len(items), len(self._ends)), dtype=np.int64)
        end, travel = np.full_like(start, _STAYS), []
        for k, ends in enumerate(self._ends):
            own = [row for row, item in enumerate(items) if k in item.start]
            # From configurations of steps before: those of this one have no numbers yet.
            table = np.zeros((1, len(ends.items) + 1))
            if own:
                firsts = np.array([items[row].start[k] for row in own])
                distinct, rows = np.unique(firsts, axis=0, return_inverse=True)
                start[own, k] = 1 + rows.ravel()
                table = np.vstack([table, self._travel(k, distinct)])
            travel.append(table)
            end[own, k] = [ends.number(items[row].end[k]) for row in own]
        number = {name: k for k, name in enumerate(self.objects)}
        objects = np.array([number[item.choice.object] for item in items])
        matrices = np.array([item.matrix for item in items])
        return _Step(objects, matrices, start, end, tuple(travel))

    def _travel(self, k: int, to: Array) -> Array:
        """Return the least times of a robot to configurations of shape (s, n), shape (s, p + 1) [s]."""
        least = self._seconds(k, to[:, None] - np.array(self._ends[k].items))
        return np.hstack([least, least.min(axis=1, keepdims=True)])


def _extended(labels: _Labels, step: _Step, prices: Array) -> _Labels:
    """Return the labels after a step for all of its choices."""
    size, count = len(step.objects), len(labels.clocks)
    arrivals = np.tile(labels.clocks, (size, 1, 1))
    for k, table in enumerate(step.travel):
        arrivals[..., 1 + k] += table[step.start[:, k]][:, labels.places[:, k]]
    clocks = np.full_like(arrivals, NEVER)
    for b in range(clocks.shape[-1]):
        later = step.matrices[:, None, :, b] + arrivals[..., b, None]
        np.maximum(clocks, later, out=clocks)
    clocks += prices[step.objects][:, None, None]
    end = step.end[:, None]
    places = np.where(end == _STAYS, labels.places, end)
    return _Labels(
        clocks.reshape(size * count, -1),
        places.reshape(size * count, -1),
        np.repeat(np.arange(size), count),
        np.tile(np.arange(count), size),
    )


def _reduced(labels: _Labels, most: int) -> _Labels:
    """Return the labels that are not dominated, merged if they are too many."""
    clocks, places = labels.clocks, labels.places.copy()
    while True:
        group = np.zeros(len(places), dtype=np.int64)
        for column in (places - places.min()).T:
            ranked = group * (column.max() + 1) + column
            group = np.unique(ranked, return_inverse=True)[1]
        count = int(group.max()) + 1
        if count <= most:
            break
        # A robot that may be anywhere is as near to its next work as it can be.
        several = [len(np.unique(column)) for column in places.T]
        places[:, int(np.argmax(several))] = -1
    keys = clocks[:, 0], clocks[:, 1:].sum(axis=1), clocks.max(axis=1), group
    order, merged, rows = np.lexsort(keys), list[Array](), list[Indices]()
    for more in range(max(1, min(_MOST_ALIKE, most // count)) - 1, -1, -1):
        starts = np.flatnonzero(np.diff(group[order], prepend=-1))
        rows.append(order[starts])
        if more == 0:
            merged.append(np.minimum.reduceat(clocks[order], starts))
            break
        merged.append(clocks[rows[-1]])
        best = np.repeat(rows[-1], np.diff(starts, append=len(order)))
        order = order[~np.all(clocks[best] <= clocks[order] + _SAME, axis=1)]
        if not len(order):
            break
    found = np.concatenate(rows)
    choice, before = labels.choice[found], labels.before[found]
    return _Labels(np.concatenate(merged), places[found], choice, before)
