"""Lower bound of the makespan over all choices of robots, objects, grips and supports.

The relaxed problem ignores collisions: between two skills a robot moves straight. It keeps the tasks of each robot in the
order of the steps, the waits within a step and for the step before, and the least times between tasks. Dynamic
programming over the steps finds its shortest schedule.

A *label* is a state after some steps: the place of each robot, and the clocks of ``ChoiceTimes``. Labels that are
dominated by another one with the same places are dropped. If too many remain, neighbours are merged: the earliest of
their clocks are a lower bound for both. One object may be used by several steps.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.makespan_bound.choice_times import (
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

_AT_ONCE = 128
"""Rows that are compared with each other at once."""

_SAME = 1e-9
"""Clocks that differ by less are the same [s]."""


def makespan_bound_s(
    cell: Workcell, work: Assembly, plan: TaskPlan, settings: MotionSettings
) -> float | None:
    """Return a lower bound of the makespan at nominal durations over all choices [s].

    It holds for every plan in which each robot executes its tasks in the order of the steps.

    Args:
        cell: where it is built.
        work: what is built.
        plan: any plan of it.
        settings: how tasks are turned into motions.

    Returns:
        The bound, None where there are no choices, or too many.
    """
    choices = list(step_choices(work.problem))
    if not 0 < len(choices) <= _MOST_CHOICES:
        return None
    reader = ChoiceReader(cell, work, plan, settings)
    times = [reader.read(choice) for choice in choices]
    homes = {k: robot.home for k, robot in enumerate(cell.robots)}

    def seconds(k: int, apart: Array) -> Array:
        robot = cell.robots[k]
        turning = ~robot.model.chain.prismatic
        return least_seconds(settings.speeds[robot.name], turning, apart)

    return least_makespan(times, homes, seconds)


def least_makespan(
    times: Sequence[ChoiceTimes], homes: Mapping[int, Array], seconds: LeastSeconds
) -> float:
    """Return the least makespan over all choices, or a lower bound of it where labels are merged [s].

    Args:
        times: least times of the choices, in the order of the steps.
        homes: where robots begin and end, by number, shape (n,) [rad or m].
        seconds: least times of the motions of a robot, by its number, from differences of configurations.
    """
    steps: dict[int, list[ChoiceTimes]] = defaultdict(list)
    for item in times:
        steps[item.choice.step].append(item)
    most = max(1, min(_MOST_LABELS, _MOST_EXTENSIONS // len(times)))
    search = _LabelSearch(homes, seconds, most)
    clocks = np.zeros((1, len(times[0].matrix)))
    labels = _Labels(clocks, np.zeros((1, len(homes)), dtype=np.int64))
    for step in sorted(steps):
        labels = search.after(labels, steps[step])
    clocks = labels.clocks.copy()
    for k, home in homes.items():
        clocks[:, 1 + k] += search.travel(k, labels.places[:, k], home)
    return float(clocks.max(axis=1).min())


@dataclass(frozen=True)
class _Labels:
    """Labels after a step.

    Attributes:
        clocks: shape (l, 1 + r) [s].
        places: number of the configuration of each robot, -1 for any that one has ended a step in, shape (l, n).
    """

    clocks: Array
    places: Indices


class _LabelSearch:
    """Extends labels by choices; see ``least_makespan``."""

    def __init__(
        self, homes: Mapping[int, Array], seconds: LeastSeconds, most: int
    ) -> None:
        self._seconds, self._most = seconds, most
        self._ends = {k: NumberedConfigurations(home) for k, home in homes.items()}

    def after(self, labels: _Labels, step: Sequence[ChoiceTimes]) -> _Labels:
        """Return the labels after a step for all of its choices."""
        alike: dict[tuple[tuple[int, bytes], ...], list[ChoiceTimes]]
        alike = defaultdict(list)
        for item in step:
            ends = (*item.start.items(), *item.end.items())
            alike[tuple((k, q.tobytes()) for k, q in ends)].append(item)
        size = labels.clocks.shape[1]
        clocks, places = [], []
        for items in alike.values():
            arrivals, there = labels.clocks.copy(), labels.places.copy()
            for k, start in items[0].start.items():
                arrivals[:, 1 + k] += self.travel(k, labels.places[:, k], start)
                there[:, k] = self._ends[k].number(items[0].end[k])
            matrices = np.array([item.matrix for item in items])
            kept = matrices[_front(matrices.reshape(len(items), -1))]
            later = (kept[:, None] + arrivals[:, None]).max(axis=-1)
            clocks.append(later.reshape(-1, size))
            places.append(np.tile(there, (len(kept), 1)))
        found = _Labels(np.concatenate(clocks), np.concatenate(places))
        return _reduced(found, self._most)

    def travel(self, k: int, places: Indices, to: Array) -> Array:
        """Return the least times from the places of a robot to a configuration, shape (l,) [s]."""
        numbers, rows = np.unique(places, return_inverse=True)
        items = np.array(self._ends[k].items)
        least = self._seconds(k, to - items[numbers])
        if numbers[0] < 0:
            least[0] = self._seconds(k, to - items).min()
        return np.asarray(least[rows])


def _reduced(labels: _Labels, most: int) -> _Labels:
    """Return the labels that are not dominated, merged if they are too many."""
    places = labels.places.copy()
    while True:
        found, group = np.unique(places, axis=0, return_inverse=True)
        if len(found) <= most:
            break
        # A robot that may be anywhere is as near to its next work as it can be.
        several = [len(np.unique(column)) for column in places.T]
        places[:, int(np.argmax(several))] = -1
    alike = max(1, min(_MOST_ALIKE, most // len(found)))
    order = np.argsort(group.ravel(), kind="stable")
    borders = np.flatnonzero(np.diff(group.ravel()[order])) + 1
    clocks, rows = [], []
    for own in np.split(order, borders):
        front = own[_front(labels.clocks[own])]
        for part in np.array_split(front, min(alike, len(front))):
            clocks.append(labels.clocks[part].min(axis=0))
            rows.append(part[0])
    return _Labels(np.array(clocks), places[rows])


def _front(rows: Array) -> Indices:
    """Return the indices of the rows that no other row dominates, in order, shape (k,)."""
    if len(rows) == 1:
        return np.zeros(1, dtype=np.int64)
    order = np.lexsort(rows.T[::-1])
    kept = order[:0]
    for part in np.array_split(order, -(-len(order) // _AT_ONCE)):
        # Only earlier rows in lexicographic order can dominate a row.
        both = np.concatenate([kept, part])
        ahead = np.all(rows[both] <= rows[both][:, None] + _SAME, axis=-1)
        kept = both[~np.tril(ahead, -1).any(axis=1)]
    return kept
