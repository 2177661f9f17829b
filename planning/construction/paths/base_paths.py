"""Paths of a mobile base around obstacles on the floor, as waypoints for a roadmap, in compiled code.

Parts on the floor leave narrow gaps, in which few random configurations lie. So a path of the base is planned first, by
A* on a lattice of positions, with the arm at HOME. Moving robots are ignored: the roadmap also plans waits for them.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np

from planning.construction.checks.scene import MoverScene
from planning.construction.checks.still_checks import is_clear_of_still_objects
from planning.construction.paths.query import Query, tree_branch
from planning.kernels import copy_row, inner_kernel, kernel
from planning.transforms import Array

SPACING = 0.25
"""Distance of places on the lattice [m]."""

_BEYOND = 3.0
"""Margin of the lattice beyond start and goal [m]."""


class Lattice(NamedTuple):
    """Lattice of base positions.

    Attributes:
        origin: the place in row and column 0, shape (2,) [m].
        spacing: between neighbours [m].
        rows, columns: how many there are, along x and along y.
        first, last: row times columns plus column of the place where the base stands, and of the
            one that is nearest to the goal.
    """

    origin: Array
    spacing: float
    rows: int
    columns: int
    first: int
    last: int


@kernel
def base_path(scene: MoverScene, query: Query, goal: int, most: int) -> Array:
    """Return the corners of a path to a goal, clear of static obstacles.

    Args:
        scene: the robot and its obstacles. The first three joints of the robot are its base: x, y and a rotation.
        query: the query.
        goal: index of the goal.
        most: greatest number of lattice steps that are checked.

    Returns:
        Configurations, shape (w, n), none if no path is found. The first one is the start, the last one the goal
        with the arm at HOME; both may be in contact with obstacles.
    """
    lattice = lay_lattice(query, goal, SPACING)
    path, times = lattice_path(scene, query, goal, lattice, most)
    corners: Array = _corners(scene, path, times)
    return corners


@kernel
def lay_lattice(query: Query, goal: int, spacing: float) -> Lattice:
    """Return lattice positions around start and goal, the start among them."""
    a, b = query.start, query.goals[goal]
    origin, size = np.empty(2), np.empty(2, dtype=np.int64)
    start, end = np.empty(2, dtype=np.int64), np.empty(2, dtype=np.int64)
    for j in range(2):
        low = max(min(a[j], b[j]) - _BEYOND, query.lower[j])
        high = min(max(a[j], b[j]) + _BEYOND, query.upper[j])
        start[j] = int(np.floor((a[j] - low) / spacing))
        origin[j] = a[j] - start[j] * spacing
        size[j] = int(np.floor((high - origin[j]) / spacing)) + 1
        end[j] = int(np.round((b[j] - origin[j]) / spacing))
        end[j] = min(max(end[j], 0), size[j] - 1)
    return Lattice(
        origin,
        spacing,
        size[0],
        size[1],
        start[0] * size[1] + start[1],
        end[0] * size[1] + end[1],
    )


@kernel
def write_base_configuration(
    query: Query, goal: int, lattice: Lattice, at: int, q: Array
) -> None:
    """Write the configuration at a position: arm at HOME, turning towards the goal's as it gets nearer.

    The first place is the start itself, the last one the goal.
    """
    a, b = query.start, query.goals[goal]
    copy_row(q, query.rest)
    if at == lattice.first or at == lattice.last:
        copy_row(q[:3], a if at == lattice.first else b)
        return
    q[0] = lattice.origin[0] + (at // lattice.columns) * lattice.spacing
    q[1] = lattice.origin[1] + (at % lattice.columns) * lattice.spacing
    behind = np.hypot(q[0] - a[0], q[1] - a[1])
    ahead = np.hypot(q[0] - b[0], q[1] - b[1])
    q[2] = a[2] + behind / (behind + ahead) * (b[2] - a[2])


@kernel
def lattice_path(
    scene: MoverScene, query: Query, goal: int, lattice: Lattice, most: int
) -> tuple[Array, Array]:
    """Return the shortest path over the lattice, from neighbour to neighbour.

    Args:
        scene: what must be kept clear of.
        query: the query.
        goal: which goal is driven to.
        lattice: the places. The first and the last need not be clear, nor the steps from and to
            them.
        most: greatest number of steps.

    Returns:
        Configurations and times of arrival there, shapes (w, n) and (w,), empty where there is
        none or too much has been looked at.
    """
    n, count = len(query.start), lattice.rows * lattice.columns
    begin, speed = query.begin, min(query.velocity[0], query.velocity[1])
    cost, parent = np.full(count, np.inf), np.full(count, -1, dtype=np.int64)
    taken = np.zeros(count, dtype=np.bool_)
    q, before, looked = np.empty(n), np.empty(n), 0
    # A step is looked at only once no other one promises a shorter way; of those that promise
    # the same the one that has come furthest.
    steps = [(_between(lattice, lattice.first, lattice.last), 0.0, lattice.first, -1)]
    while len(steps) > 0 and looked < most and cost[lattice.last] == np.inf:
        _, come, at, source = heapq.heappop(steps)
        length = -come
        if cost[at] < np.inf or taken[at]:
            continue
        if source >= 0 and at != lattice.last:
            write_base_configuration(query, goal, lattice, at, q)
            t, clear = begin + length / speed, False
            if source != lattice.first:
                looked += 1
                write_base_configuration(query, goal, lattice, source, before)
                since = t - _between(lattice, source, at) / speed
                clear = is_clear_of_still_objects(scene, before, since, q, t, 0.0)
            if not clear:
                looked += 1
                here = is_clear_of_still_objects(scene, q, t, q, t, 0.0)
                taken[at] = not here
                if source != lattice.first or not here:
                    continue
        cost[at], parent[at] = length, source
        row, column = at // lattice.columns, at % lattice.columns
        for i in range(max(row - 1, 0), min(row + 2, lattice.rows)):
            for k in range(max(column - 1, 0), min(column + 2, lattice.columns)):
                to = i * lattice.columns + k
                if cost[to] == np.inf:
                    so_far = length + _between(lattice, at, to)
                    ahead = _between(lattice, to, lattice.last)
                    heapq.heappush(steps, (so_far + ahead, -so_far, to, at))
    if cost[lattice.last] == np.inf:
        return np.empty((0, n)), np.empty(0)
    places = tree_branch(parent, lattice.last)
    path, times = np.empty((len(places), n)), np.empty(len(places))
    for c in range(len(places)):
        write_base_configuration(query, goal, lattice, places[c], path[c])
        times[c] = begin + cost[places[c]] / speed
    return path, times


@inner_kernel
def _between(lattice: Lattice, a: int, b: int) -> float:
    """Return the distance of two positions [m]."""
    rows = a // lattice.columns - b // lattice.columns
    columns = a % lattice.columns - b % lattice.columns
    return lattice.spacing * float(np.hypot(rows, columns))


@inner_kernel
def _corners(scene: MoverScene, path: Array, times: Array) -> Array:
    """Return the positions of a path after bisection for the farthest straight drives."""
    keep = np.zeros(len(path), dtype=np.bool_)
    keep[:1] = True
    at = 0
    while at < len(path) - 1:
        # The next place is a neighbour.
        good, bad, to = at + 1, len(path), len(path) - 1
        while good < to:
            if is_clear_of_still_objects(
                scene, path[at], times[at], path[to], times[to], 0.0
            ):
                good = to
            else:
                bad = to
            to = (good + bad) // 2
        at = good
        keep[at] = True
    return path[keep]
