"""Prediction of the makespan of an assignment by a simulation of robots that work in parallel.

Operations are dispatched in the order of their earliest possible starts. An operation waits for the operations that
it depends on. It is divided into pieces of motion. A piece also waits until the robots of operations that were
dispatched before have left the volume that it sweeps.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.assignment_search.prediction_tables import (
    PredictionModel,
    PredictionTables,
)
from planning.assignment_search.volumes import Volumes, do_volumes_meet
from planning.kernels import inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices

_PENDING = -1.0

_SAME = 1e-9
"""Makespans that differ by less are the same: sums in different orders are [s]."""


class RolloutState(NamedTuple):
    """State of a rollout.

    Attributes:
        queue, queue_step: operations of each robot in order, and their steps, shape (r, q).
        queued, head: number of operations in each queue, and index of the next one, shape (r,).
        done: time at which each operation of a step is complete, shape (steps, most) [s].
        done_kind: time at which the last operation of each kind is complete in a step, shape (steps, kinds) [s].
        clock: time until which each robot is busy, shape (r,) [s].
        left_s: least total duration of each robot's operations that are not dispatched, with the travel between
            them and to HOME, shape (r,) [s].
        at: number of each robot's configuration, shape (r,).
        held, held_step: volumes that each robot has occupied, with their steps, shape (r, h).
        held_until: time at which it leaves each of them, shape (r, h) [s].
        held_count: number of these volumes, shape (r,).
    """

    queue: Indices
    queue_step: Indices
    queued: Indices
    head: Indices
    done: Array
    done_kind: Array
    clock: Array
    left_s: Array
    at: Indices
    held: Indices
    held_step: Indices
    held_until: Array
    held_count: Indices


def make_state(model: PredictionModel) -> RolloutState:
    """Return a state with arrays large enough for every rollout of a model."""
    tables, robots = model.tables, model.robots
    steps = int(tables.step.max()) + 1
    most = steps * tables.most
    pieces = int(np.diff(tables.piece_first).max()) + 1
    rows = robots, most
    whole = np.int64
    return packed(
        RolloutState(
            np.zeros(rows, whole),
            np.zeros(rows, whole),
            np.zeros(robots, whole),
            np.zeros(robots, whole),
            np.zeros((steps, tables.most)),
            np.zeros((steps, tables.kinds)),
            np.zeros(robots),
            np.zeros(robots),
            np.zeros(robots, whole),
            np.zeros((robots, most * pieces), whole),
            np.zeros((robots, most * pieces), whole),
            np.zeros((robots, most * pieces)),
            np.zeros(robots, whole),
        )
    )


def predict_makespan(
    model: PredictionModel,
    chosen: Indices,
    *,
    conflicts: bool = True,
    most: float = np.inf,
) -> float:
    """Return the predicted makespan of an assignment [s].

    Args:
        model: of the assembly.
        chosen: number of the choice of each step, shape (steps,).
        conflicts: whether robots wait where others are in their way.
        most: makespan above which the prediction is infinity [s].
    """
    tables, volumes, state = model.tables, model.volumes, make_state(model)
    return float(run_rollout(tables, volumes, state, chosen, conflicts, most))


@kernel
def run_rollout(
    tables: PredictionTables,
    volumes: Volumes,
    state: RolloutState,
    chosen: Indices,
    conflicts: bool,
    most: float,
) -> float:
    """Return the predicted makespan of an assignment, infinity where it exceeds ``most`` [s]."""
    left = _queue_operations(tables, state, chosen)
    queue, head, queued = state.queue, state.head, state.queued
    most += _SAME
    for r in range(len(queued)):
        if state.left_s[r] > most:
            return np.inf
    while left > 0:
        best, soonest = -1, np.inf
        for r in range(len(queued)):
            if head[r] == queued[r]:
                continue
            start = _earliest_start(tables, state, chosen, r, queue[r, head[r]])
            if start >= 0.0 and start < soonest:
                best, soonest = r, start
        if best < 0:
            return np.inf
        _dispatch(tables, volumes, state, chosen, best, soonest, conflicts)
        left -= 1
        if state.clock[best] + state.left_s[best] > most:
            return np.inf
    makespan = 0.0
    for r in range(len(queued)):
        makespan = max(makespan, state.clock[r] + _travel_s(tables, state, r, 0))
    return makespan


@inner_kernel
def _travel_s(
    tables: PredictionTables, state: RolloutState, r: int, start: int
) -> float:
    """Return the duration of a robot's straight motion to a start configuration, 0 for HOME [s]."""
    row = tables.travel_first[r] + state.at[r] * tables.starts[r]
    return float(tables.travel[row + start])


@inner_kernel
def _queue_operations(
    tables: PredictionTables, state: RolloutState, chosen: Indices
) -> int:
    """Queue the operations of all robots; return their number."""
    for r in range(len(state.queued)):
        state.queued[r] = state.head[r] = state.at[r] = 0
        state.held_count[r] = 0
        state.clock[r] = state.left_s[r] = 0.0
    total = 0
    for step in range(len(chosen)):
        for kind in range(state.done_kind.shape[1]):
            state.done_kind[step, kind] = _PENDING
        first = tables.first[chosen[step]]
        for k in range(first, tables.first[chosen[step] + 1]):
            state.done[step, k - first] = _PENDING
            r = tables.robot[k]
            state.queue[r, state.queued[r]] = k
            state.queue_step[r, state.queued[r]] = step
            state.queued[r] += 1
            state.left_s[r] += _travel_s(tables, state, r, tables.start[k])
            state.left_s[r] += tables.seconds[k]
            state.at[r] = tables.end[k]
            total += 1
    for r in range(len(state.queued)):
        state.left_s[r] += _travel_s(tables, state, r, 0)
        state.at[r] = 0
    return total


@inner_kernel
def _earliest_start(
    tables: PredictionTables, state: RolloutState, chosen: Indices, r: int, k: int
) -> float:
    """Return when an operation could start [s]; -1 while one that it depends on is not dispatched."""
    step = state.queue_step[r, state.head[r]]
    start = state.clock[r] + _travel_s(tables, state, r, tables.start[k])
    gate = tables.gate[k]
    for a in range(tables.after_first[k], tables.after_first[k + 1]):
        before = state.done[step, tables.after[a]]
        if before < 0.0:
            return _PENDING
        start = max(start, before)
    row = step * tables.kinds + tables.kind[k]
    for w in range(tables.wait_first[row], tables.wait_first[row + 1]):
        before = state.done_kind[tables.wait_step[w], tables.wait_kind[w]]
        if before < 0.0:
            return _PENDING
        start = max(start, before)
    if gate != k:
        for a in range(tables.after_first[gate], tables.after_first[gate + 1]):
            if state.done[step, tables.after[a]] < 0.0:
                return _PENDING
        row = step * tables.kinds + tables.kind[gate]
        for w in range(tables.wait_first[row], tables.wait_first[row + 1]):
            if state.done_kind[tables.wait_step[w], tables.wait_kind[w]] < 0.0:
                return _PENDING
    return float(start)


@inner_kernel
def _dispatch(
    tables: PredictionTables,
    volumes: Volumes,
    state: RolloutState,
    chosen: Indices,
    r: int,
    start: float,
    conflicts: bool,
) -> None:
    """Carry out the next operation of a robot."""
    k = state.queue[r, state.head[r]]
    step = state.queue_step[r, state.head[r]]
    now, past = start, 0.0
    if conflicts:
        for p in range(tables.piece_first[k], tables.piece_first[k + 1]):
            now = _time_when_free(volumes, state, r, step, tables.volume[p], now)
            now += (tables.until[p] - past) * tables.seconds[k]
            past = tables.until[p]
            _occupy(state, r, step, tables.volume[p], now)
        if tables.leaving[k] >= 0:
            _occupy(state, r, step, tables.leaving[k], now + tables.leaving_s[k])
    else:
        now += tables.seconds[k]
    state.clock[r] = now
    state.left_s[r] -= _travel_s(tables, state, r, tables.start[k])
    state.left_s[r] -= tables.seconds[k]
    state.at[r] = tables.end[k]
    state.head[r] += 1
    state.done[step, k - tables.first[chosen[step]]] = now
    state.done_kind[step, tables.kind[k]] = now


@inner_kernel
def _time_when_free(
    volumes: Volumes, state: RolloutState, r: int, step: int, volume: int, now: float
) -> float:
    """Return the earliest time from ``now`` at which other robots have left a volume [s]."""
    for other in range(len(state.held_count)):
        if other == r:
            continue
        past = 0
        for h in range(state.held_count[other] - 1, -1, -1):
            if state.held_until[other, h] <= now:
                past += 1
                if past > 3:
                    break
                continue
            if state.held_step[other, h] != step and do_volumes_meet(
                volumes, volume, state.held[other, h]
            ):
                now = float(state.held_until[other, h])
    return now


@inner_kernel
def _occupy(state: RolloutState, r: int, step: int, volume: int, until: float) -> None:
    count = state.held_count[r]
    state.held[r, count] = volume
    state.held_step[r, count] = step
    state.held_until[r, count] = until
    state.held_count[r] = count + 1
