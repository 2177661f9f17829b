"""Random roadmaps (PRM) for space-time planning, in compiled code.

Each vertex is a configuration with its safe intervals: the spans of time in which the robot can stay there without
collision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.construction.checks.scene import MoverScene
from planning.construction.checks.still_checks import is_clear_of_still_objects
from planning.construction.checks.time_windows import (
    mark_blocked_cells,
    write_free_spans,
)
from planning.construction.paths.query import (
    Query,
    arrival_time,
    draw_between,
    random_normal,
    random_uniform,
)
from planning.kernels import copy_row, inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices

SPANS = 12
"""Greatest number of safe intervals stored for a vertex."""

_NEAR_ENDS, _BETWEEN = 0.35, 0.85
"""Cumulative shares of random vertices near the start or a goal, and anywhere between them; the others are near the
straight path."""


class Roadmap(NamedTuple):
    """Vertices of a roadmap, and the state of the search at each.

    Attributes:
        q: configurations of the vertices, shape (v, n).
        number: number of safe intervals of each vertex, -1 if not computed yet, shape (v,).
        spans: safe intervals, all of time if not computed yet, shape (v, SPANS, 2) [s].
        come: arrival time in each interval, infinity if not reached yet, shape (v, SPANS) [s].
        left: departure time from the previous vertex, shape (v, SPANS) [s].
        parent: previous vertex and interval, as vertex * SPANS + interval, shape (v, SPANS).
        rest: least time from each vertex to a goal, shape (v,) [s].
        blocked: whether the motion between two vertices collides with a static obstacle, shape (v, v).
        free: work array, shape (cells,).
    """

    q: Array
    number: Indices
    spans: Array
    come: Array
    left: Array
    parent: Indices
    rest: Array
    blocked: npt.NDArray[np.bool_]
    free: npt.NDArray[np.bool_]


@inner_kernel
def _draw_near_ends(query: Query, state: npt.NDArray[np.uint64], out: Array) -> None:
    """Draw a configuration up to about two seconds away from the start or a goal.

    If the robot must leave early or can only arrive late, only short motions are free. An arm on a mobile base that
    reaches over an obstacle may have to drive away without moving its arm.
    """
    near = int(random_uniform(state) * (1 + len(query.goals)))
    far = 0.2 + 2.0 * random_uniform(state)
    drives = random_uniform(state) < 0.6 and not np.all(query.leans)
    for j in range(len(out)):
        at = 2.0 * random_uniform(state) - 1.0
        if drives and query.leans[j]:
            at = 0.0
        end = query.start[j] if near == 0 else query.goals[near - 1, j]
        at = end + far * query.velocity[j] * at
        out[j] = min(max(at, query.lower[j]), query.upper[j])


@inner_kernel
def _draw_along(
    query: Query, goal: int, wide: float, state: npt.NDArray[np.uint64], out: Array
) -> None:
    """Draw a configuration near the straight path to a goal, for joint positions at a given time."""
    share = random_uniform(state)
    spread = 0.25 * random_uniform(state)
    for j in range(len(out)):
        middle = query.start[j] + share * (query.goals[goal, j] - query.start[j])
        far = spread * min(
            query.upper[j] - query.lower[j],
            query.velocity[j] * max(wide - query.begin, 0.0),
        )
        at = middle + far * random_normal(state)
        out[j] = min(max(at, query.lower[j]), query.upper[j])


@kernel
def draw_vertices(
    scene: MoverScene,
    query: Query,
    extra: Array,
    vertices: int,
    wide: float,
    seed: int,
) -> tuple[Array, Array]:
    """Draw at most a given number of vertices: start, goals, extra ones, and random ones.

    Returns:
        Configurations, shape (v, n), and the least time from each to a goal, shape (v,) [s].
    """
    n, goals = len(query.start), len(query.goals)
    state = np.zeros(1, dtype=np.uint64)
    state[0] = np.uint64(seed) * np.uint64(7919) + np.uint64(11)
    start = query.begin
    q = np.empty((vertices, n))
    copy_row(q[0], query.start)
    for g in range(goals):
        copy_row(q[1 + g], query.goals[g])
    number = 1 + goals
    for e in range(len(extra)):
        if number < vertices:
            copy_row(q[number], extra[e])
            number += 1
    tries = 0
    while number < vertices and tries < 3 * vertices:
        tries += 1
        goal = int(random_uniform(state) * goals)
        kind = random_uniform(state)
        if kind < _NEAR_ENDS:
            _draw_near_ends(query, state, q[number])
        elif kind < _BETWEEN:
            draw_between(query, goal, wide, state, q[number])
        else:
            _draw_along(query, goal, wide, state, q[number])
        if is_clear_of_still_objects(scene, q[number], start, q[number], start, 0.0):
            number += 1
    q = q[:number]
    rest = np.full(number, np.inf)
    for k in range(number):
        for g in range(goals):
            rest[k] = min(
                rest[k], arrival_time(query, q[k], start, query.goals[g]) - start
            )
    return q, rest


def new_roadmap(q: Array, rest: Array, cells: int) -> Roadmap:
    """Return an unexplored roadmap of vertices, in the form that kernels take."""
    count = len(q)
    spans = np.full((count, SPANS, 2), np.inf)
    spans[:, :, 0] = -np.inf
    return packed(
        Roadmap(
            q,
            np.full(count, -1, dtype=np.int64),
            spans,
            np.full((count, SPANS), np.inf),
            np.full((count, SPANS), np.inf),
            np.full((count, SPANS), -1, dtype=np.int64),
            rest,
            np.zeros((count, count), dtype=np.bool_),
            np.empty(cells, dtype=np.bool_),
        )
    )


@inner_kernel
def find_stands(scene: MoverScene, road: Roadmap, v: int, first: int) -> None:
    """Find the time spans in which the robot may stand at a vertex."""
    road.free[:] = True
    mark_blocked_cells(scene, road.q[v], road.q[v], first, road.free)
    road.number[v] = write_free_spans(road.free, first, scene.step, road.spans[v])
