"""Which pieces of different robots that share time come too close, compiled search, exact enough.

The same capsules and hulls as in planning; contacts are allowed where the tasks of both pieces
allow them, as in a temporal plan graph.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.close_pairs import capsules_meet, proved_apart
from planning.construction.checks.obstacles import (
    BODY_ENTITY,
    BODY_FIRST,
    BODY_JOINT,
    CAPSULE_FIRST,
    JOINT_FIRST,
    PIECE_A,
    PIECE_B,
    PIECE_BODY,
    PIECE_BOX,
    PIECE_CAPSULE,
    PIECE_CARRIER,
    PIECE_END,
    PIECE_START,
    SWEPT_A,
    SWEPT_B,
    SWEPT_BOX,
    SWEPT_RADIUS,
    TRACK_FIRST,
    apart,
)
from planning.transforms import Indices


def contact_keys(
    touching: Sequence[frozenset[frozenset[str]]], number: dict[str, int]
) -> Indices:
    """Return a sorted key for every pair of entities that may touch in a task.

    Args:
        touching: pairs of each task.
        number: of all entities.
    """
    keys = set()
    for task, pairs in enumerate(touching):
        for pair in pairs:
            a, b = sorted(number[name] for name in pair)
            keys.add((task * len(number) + a) * len(number) + b)
    return np.array(sorted(keys), dtype=np.int64)


def conflicting_pieces(
    scene: Arena,
    tasks: Indices,
    keys: Indices,
    entities: int,
    robots: int,
    limits: tuple[float, float],
) -> Iterable[tuple[int, int]]:
    """Return pairs of pieces that share time and are not proved to stay apart.

    Args:
        scene: with the tracks of all robots.
        tasks: the tasks that each piece belongs to: one given twice, or for a stand those
            before and after it, shape (pieces, 2).
        keys: of allowed contacts, see ``contact_keys``.
        entities: how many there are.
        robots: how many of them belong to robots; they come first.
        limits: least distance between robots, and of anything to an object [m].
    """
    room = 1024
    while True:
        out = np.empty((room, 2), dtype=np.int64)
        count = _find(scene, tasks, keys, entities, robots, *limits, out)
        if count <= room:
            return [(int(a), int(b)) for a, b in out[:count]]
        room = int(count)


@njit(cache=True, nogil=True)
def _find(
    scene: Arena,
    tasks: Indices,
    keys: Indices,
    entities: int,
    robots: int,
    between: float,
    to_objects: float,
    out: Indices,
) -> int:
    first = row(scene, TRACK_FIRST)
    start, end = column(scene, PIECE_START), column(scene, PIECE_END)
    box = table(scene, PIECE_BOX)
    widest = max(between, to_objects)
    count = 0
    for r in range(len(first) - 1):
        for s in range(r):
            j0 = first[s]
            for i in range(first[r], first[r + 1]):
                while j0 < first[s + 1] and end[j0] <= start[i] + 1e-9:
                    j0 += 1
                j = j0
                while j < first[s + 1] and start[j] < end[i] - 1e-9:
                    if (
                        end[j] > start[i] + 1e-9
                        and not apart(box[i], box[j], widest)
                        and not _pair_clear(
                            scene,
                            i,
                            j,
                            tasks,
                            keys,
                            entities,
                            robots,
                            between,
                            to_objects,
                        )
                    ):
                        if count < len(out):
                            out[count, 0], out[count, 1] = i, j
                        count += 1
                    j += 1
    return count


@njit(cache=True, nogil=True)
def _pair_clear(
    scene: Arena,
    i: int,
    j: int,
    tasks: Indices,
    keys: Indices,
    entities: int,
    robots: int,
    between: float,
    to_objects: float,
) -> bool:
    bodies, joints = row(scene, BODY_FIRST), row(scene, JOINT_FIRST)
    capsules, entity = row(scene, CAPSULE_FIRST), row(scene, BODY_ENTITY)
    joint, carrier = row(scene, BODY_JOINT), row(scene, PIECE_CARRIER)
    first_body, first = row(scene, PIECE_BODY), row(scene, PIECE_CAPSULE)
    box = table(scene, SWEPT_BOX)
    a, b = table(scene, SWEPT_A), table(scene, SWEPT_B)
    radius = column(scene, SWEPT_RADIUS)
    q_a, q_b = table(scene, PIECE_A), table(scene, PIECE_B)
    v, w = carrier[i], carrier[j]
    n, m = joints[v + 1] - joints[v], joints[w + 1] - joints[w]
    v_low = first[i] - capsules[bodies[v]]
    w_low = first[j] - capsules[bodies[w]]
    for o in range(bodies[v], bodies[v + 1]):
        x = first_body[i] + o - bodies[v]
        for p in range(bodies[w], bodies[w + 1]):
            y = first_body[j] + p - bodies[w]
            if entity[o] == entity[p]:
                continue  # a part in the course of a handover, in both hands
            limit = to_objects
            if entity[o] < robots and entity[p] < robots:
                limit = between
            if apart(box[x], box[y], limit) or (joint[o] < 0 and joint[p] < 0):
                continue
            if not capsules_meet(
                a,
                b,
                radius,
                capsules[o] + v_low,
                capsules[o + 1] + v_low,
                a,
                b,
                radius,
                capsules[p] + w_low,
                capsules[p + 1] + w_low,
                limit,
            ):
                continue
            if _allowed(keys, tasks[i], entities, entity[o], entity[p]) and _allowed(
                keys, tasks[j], entities, entity[o], entity[p]
            ):
                continue
            if not proved_apart(
                scene,
                v,
                q_a[i, :n],
                q_b[i, :n],
                o,
                w,
                q_a[j, :m],
                q_b[j, :m],
                p,
                limit,
            ):
                return False
    return True


@njit(cache=True, nogil=True)
def _allowed(keys: Indices, tasks: Indices, entities: int, x: int, y: int) -> bool:
    low, high = min(x, y), max(x, y)
    for task in tasks:
        key = (task * entities + low) * entities + high
        at = np.searchsorted(keys, key)
        if at < len(keys) and keys[at] == key:
            return True
    return False
