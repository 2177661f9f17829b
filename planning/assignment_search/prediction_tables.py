"""Arrays of the operations of all steps and alternatives, from which compiled code predicts makespans."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from planning.assignment_search.operations import (
    TRAVEL,
    RobotOperation,
    list_operations,
)
from planning.assignment_search.volumes import SAMPLES, Volumes, build_volumes
from planning.cell.workcell import Workcell
from planning.motion.full_turns import without_turns
from planning.motion.numbered_configurations import NumberedConfigurations
from planning.motion.sequential import MotionSettings
from planning.packed import packed
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import StepChoice, TaskPlan
from planning.tasks.task import Task
from planning.transforms import Array, Indices

_PIECES = {TRAVEL: 4}
_SKILL_PIECES = 3
"""Number of pieces of an operation; conflicts are predicted for whole pieces."""

_LEAVING = 0.4
"""Share of the straight motion to HOME after which a robot has left its place of work."""


class PredictionTables(NamedTuple):
    """Operations of all choices of all steps.

    Attributes:
        step: step of each choice, from 0, shape (c,).
        first: index of the first operation of each choice, shape (c + 1,).
        robot, kind: of each operation, shape (o,).
        seconds: duration of each operation, shape (o,) [s].
        start, end: numbers of its first and last configuration among those of its robot, shape (o,).
        gate: for a travel, the skill that it leads to, the next operation of its robot; otherwise the operation
            itself, shape (o,).
        after_first, after: predecessors of each operation, by their numbers within the same choice.
        piece_first: index of the first piece of each operation, shape (o + 1,).
        volume: of each piece, shape (p,).
        until: share of the operation that is complete after each piece, shape (p,).
        leaving: volume that the robot needs when it leaves after an operation, -1 for none, shape (o,).
        leaving_s: duration of that need, shape (o,) [s].
        travel_first: index in ``travel`` at which the table of each robot begins, shape (r,).
        starts: number of start configurations of each robot, shape (r,); number 0 is HOME.
        travel: seconds from each end to each start configuration of each robot, one after another [s].
        wait_first: index of the first wait of each kind at each step, shape (steps * kinds + 1,).
        wait_step, wait_kind: step and kind of the operation that each wait is for.
        kinds: number of kinds.
        most: greatest number of operations of a choice.
    """

    step: Indices
    first: Indices
    robot: Indices
    kind: Indices
    seconds: Array
    start: Indices
    end: Indices
    gate: Indices
    after_first: Indices
    after: Indices
    piece_first: Indices
    volume: Indices
    until: Array
    leaving: Indices
    leaving_s: Array
    travel_first: Indices
    starts: Indices
    travel: Array
    wait_first: Indices
    wait_step: Indices
    wait_kind: Indices
    kinds: int
    most: int


_COLUMNS = PredictionTables._fields[:-2]
_REAL = ("seconds", "until", "leaving_s", "travel")
"""Fields with an array each, and those whose values are no whole numbers."""


@dataclass(frozen=True)
class PredictionModel:
    """Choices of all steps in their order, their operations, the space that these need, and the number of robots."""

    choices: tuple[StepChoice, ...]
    tables: PredictionTables
    volumes: Volumes
    robots: int


def build_model(
    cell: Workcell,
    work: Assembly,
    plan: TaskPlan,
    choices: Sequence[StepChoice],
    settings: MotionSettings,
) -> PredictionModel:
    """Return the model of an assembly, given any plan of it and the choices of its steps in their order."""
    builder = _TableBuilder(cell, settings)
    for choice in choices:
        tasks = work.expand(plan.with_choice(choice), choice.step, 0)
        builder.add(choice.step - 1, list_operations(cell, tasks, settings))
    first, steps = 0, []
    for choice in plan.choices:
        steps.append(work.expand(plan, choice.step, first))
        first += len(steps[-1].tasks)
    waits = [(a, b) for a, b in work.waits(steps) if a.step != b.step]
    tables, volumes = builder.finish(waits, len(plan.choices))
    return PredictionModel(tuple(choices), tables, volumes, len(cell.robots))


class _TableBuilder:
    """Gathers the operations of choices."""

    def __init__(self, cell: Workcell, settings: MotionSettings) -> None:
        self._cell, self._settings = cell, settings
        self._number = {robot.name: k for k, robot in enumerate(cell.robots)}
        self._starts = [NumberedConfigurations(r.home) for r in cell.robots]
        self._ends = [NumberedConfigurations(r.home) for r in cell.robots]
        self._kinds: dict[str, int] = {TRAVEL: 0}
        self._volumes: dict[tuple[int, bytes], int] = {}
        self._pieces: list[tuple[str, Array]] = []
        self._columns: dict[str, list[Any]] = {name: [] for name in _COLUMNS}
        for name in ("first", "after_first", "piece_first", "wait_first"):
            self._columns[name].append(0)

    def add(self, step: int, operations: Sequence[RobotOperation]) -> None:
        """Add the operations of a choice."""
        columns = self._columns
        columns["step"].append(step)
        base = columns["first"][-1]
        following: dict[str, int] = {}
        gates, lasts = [0] * len(operations), [False] * len(operations)
        for k in reversed(range(len(operations))):
            item = operations[k]
            lasts[k] = item.robot not in following
            gates[k] = following[item.robot] if item.leads else k
            following[item.robot] = k
        for item, gate, last in zip(operations, gates, lasts, strict=True):
            robot = self._number[item.robot]
            columns["robot"].append(robot)
            kind = self._kinds.setdefault(item.kind, len(self._kinds))
            columns["kind"].append(kind)
            columns["seconds"].append(item.seconds)
            columns["start"].append(self._starts[robot].number(item.path[0]))
            columns["end"].append(self._ends[robot].number(item.path[-1]))
            columns["gate"].append(base + gate)
            leaving, leaving_s = self._leaving(item) if last else (-1, 0.0)
            columns["leaving"].append(leaving)
            columns["leaving_s"].append(leaving_s)
            columns["after"] += item.after
            columns["after_first"].append(len(columns["after"]))
            self._cut(item)
        columns["first"].append(base + len(operations))

    def finish(
        self, waits: Iterable[tuple[Task, Task]], steps: int
    ) -> tuple[PredictionTables, Volumes]:
        """Return the arrays, with waits between the steps: the second of two tasks waits for the first."""
        kinds, columns = self._kinds, self._columns
        waiting: list[set[tuple[int, int]]] = [set() for _ in range(steps * len(kinds))]
        for a, b in waits:
            if a.kind in kinds and b.kind in kinds:
                row = waiting[(b.step - 1) * len(kinds) + kinds[b.kind]]
                row.add((a.step - 1, kinds[a.kind]))
        for pairs in waiting:
            columns["wait_step"] += [step for step, _ in sorted(pairs)]
            columns["wait_kind"] += [kind for _, kind in sorted(pairs)]
            columns["wait_first"].append(len(columns["wait_step"]))
        for k, starts in enumerate(self._starts):
            columns["travel_first"].append(len(columns["travel"]))
            columns["starts"].append(len(starts.items))
            columns["travel"] += self._travel(k).ravel().tolist()
        arrays: dict[str, Any] = {
            name: np.array(column, np.float64 if name in _REAL else np.int64)
            for name, column in columns.items()
        }
        most = int(np.diff(arrays["first"]).max())
        found = PredictionTables(**arrays, kinds=len(kinds), most=most)
        names = [name for name, _ in self._pieces]
        pieces = [piece for _, piece in self._pieces]
        return packed(found), build_volumes(self._cell, names, pieces)

    def _cut(self, item: RobotOperation) -> None:
        """Add the pieces of an operation."""
        parts = _PIECES.get(item.kind, _SKILL_PIECES)
        if item.seconds == 0.0:
            parts = 1
        at = _at(item, np.linspace(0.0, 1.0, parts * (SAMPLES - 1) + 1))
        for k in range(parts):
            first = k * (SAMPLES - 1)
            piece = self._piece(item.robot, at[first : first + SAMPLES])
            self._columns["volume"].append(piece)
            self._columns["until"].append((k + 1) / parts)
        self._columns["piece_first"].append(len(self._columns["volume"]))

    def _leaving(self, item: RobotOperation) -> tuple[int, float]:
        robot = self._cell.robot(item.robot)
        start = item.path[-1]
        retreat = _LEAVING * without_turns(
            robot.home - start, ~robot.model.chain.prismatic
        )
        shares = np.linspace(0.0, 1.0, SAMPLES)[:, None]
        seconds = self._settings.speeds[item.robot].duration(start, start + retreat)
        return self._piece(item.robot, start + shares * retreat), seconds

    def _piece(self, robot: str, samples: Array) -> int:
        key = self._number[robot], samples.tobytes()
        if key not in self._volumes:
            self._volumes[key] = len(self._pieces)
            self._pieces.append((robot, samples))
        return self._volumes[key]

    def _travel(self, k: int) -> Array:
        """Return the seconds from each end to each start configuration of a robot [s]."""
        robot = self._cell.robots[k]
        starts, ends = np.array(self._starts[k].items), np.array(self._ends[k].items)
        speed, turning = self._settings.speeds[robot.name], ~robot.model.chain.prismatic
        rows = [speed.durations(without_turns(starts - end, turning)) for end in ends]
        return np.array(rows)


def _at(item: RobotOperation, shares: Array) -> Array:
    """Return the configurations of an operation at shares of its time, shape (s, n)."""
    times = shares * item.seconds
    columns = [np.interp(times, item.times, column) for column in item.path.T]
    return np.stack(columns, axis=1)
