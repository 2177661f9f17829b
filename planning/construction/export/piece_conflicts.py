"""Conflicts of a space-time plan: pieces of different robots that share time and come too close.

The same capsules and hulls as in planning; contacts are allowed where the tasks of both pieces
allow them, as in a temporal plan graph.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.construction.checks.body_pairs import capsules_meet, proved_apart
from planning.construction.world.fleet import (
    Carrier,
    Fleet,
    bodies_of,
    make_fleet,
    set_motion,
)
from planning.construction.world.tracks import Tracks
from planning.geometry.distance import boxes_apart
from planning.geometry.separation import Scratch, room_for
from planning.kernels import inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices


class Rules(NamedTuple):
    """Least distances between entities, and allowed contacts.

    Attributes:
        limits: least distance of two entities, shape (e, e) [m].
        allowed: whether two entities may touch in a task, shape (tasks, e, e).
    """

    limits: Array
    allowed: npt.NDArray[np.bool_]


def contact_rules(
    numbers: Mapping[str, int],
    robots: Collection[str],
    between: float,
    to_objects: float,
    touching: Sequence[frozenset[frozenset[str]]],
) -> Rules:
    """Return the rules of a plan.

    Args:
        numbers: of all entities.
        robots: those that are bodies of robots.
        between: least distance between robots [m].
        to_objects: least distance of anything to an object [m].
        touching: pairs of entities that may touch, by task.
    """
    count = len(numbers)
    limits = np.full((count, count), to_objects)
    own = [numbers[name] for name in robots]
    limits[np.ix_(own, own)] = between
    allowed = np.zeros((len(touching), count, count), dtype=np.bool_)
    for task, pairs in enumerate(touching):
        for pair in pairs:
            a, b = (numbers[name] for name in pair)
            allowed[task, a, b] = allowed[task, b, a] = True
    return Rules(limits, allowed)


class _Plan(NamedTuple):
    """What is searched: all carriers, the entity of each body, all pieces and their tasks."""

    fleet: Fleet
    entity: Indices
    tracks: Tracks
    tasks: Indices
    rules: Rules
    scratch: Scratch


def conflicting_pieces(
    carriers: Sequence[Carrier],
    numbers: Mapping[str, int],
    tracks: Tracks,
    tasks: Indices,
    rules: Rules,
) -> list[tuple[int, int]]:
    """Return pairs of pieces that share time and are not proved to stay apart.

    Args:
        carriers: those of the tracks.
        numbers: of all entities.
        tracks: of all robots.
        tasks: the tasks that each piece belongs to: one given twice, or for a stand those
            before and after it, shape (pieces, 2).
        rules: how near which bodies may come.
    """
    names = [name for carrier in carriers for name in carrier.names]
    joints = max(c.hulls.q_a.shape[1] for c in carriers)
    corners = max(c.hulls.most_corners for c in carriers)
    plan = packed(
        _Plan(
            make_fleet(carriers),
            np.array([numbers[name] for name in names], dtype=np.int64),
            tracks,
            tasks,
            packed(rules),
            room_for(joints, joints, corners, corners),
        )
    )
    room = 1024
    while True:
        out = np.empty((room, 2), dtype=np.int64)
        count = _find(plan, out)
        if count <= room:
            return [(int(a), int(b)) for a, b in out[:count]]
        room = int(count)


@kernel
def _find(plan: _Plan, out: Indices) -> int:
    first, box = plan.tracks.first, plan.tracks.sweeps.box
    start, end = plan.tracks.pieces.start, plan.tracks.pieces.end
    widest = np.max(plan.rules.limits)
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
                        and not boxes_apart(box, i, box, j, widest)
                        and not _pair_clear(plan, i, j)
                    ):
                        if count < len(out):
                            out[count, 0], out[count, 1] = i, j
                        count += 1
                    j += 1
    return count


@inner_kernel
def _pair_clear(plan: _Plan, i: int, j: int) -> bool:
    bodies, entity, limits = plan.fleet.body_first, plan.entity, plan.rules.limits
    pieces, sweeps, box = (
        plan.tracks.pieces,
        plan.tracks.sweeps,
        plan.tracks.sweeps.body_box,
    )
    v, w = plan.tracks.carrier[i], plan.tracks.carrier[j]
    a, b = bodies_of(plan.fleet, v), bodies_of(plan.fleet, w)
    a_first, b_first = sweeps.capsule_first[i], sweeps.capsule_first[j]
    for o in range(len(a.joint)):
        x, one = sweeps.body_first[i] + o, entity[bodies[v] + o]
        c0, c1 = a_first + a.capsule_first[o], a_first + a.capsule_first[o + 1]
        for p in range(len(b.joint)):
            y, two = sweeps.body_first[j] + p, entity[bodies[w] + p]
            if one == two:
                continue  # a part in the course of a handover, in both hands
            limit = limits[one, two]
            if boxes_apart(box, x, box, y, limit) or (
                a.joint[o] < 0 and b.joint[p] < 0
            ):
                continue
            d0, d1 = b_first + b.capsule_first[p], b_first + b.capsule_first[p + 1]
            if not capsules_meet(sweeps, c0, c1, sweeps, d0, d1, limit):
                continue
            if _allowed(plan, i, one, two) and _allowed(plan, j, one, two):
                continue
            set_motion(a, pieces.q_a[i], pieces.q_b[i])
            set_motion(b, pieces.q_a[j], pieces.q_b[j])
            if not proved_apart(plan.scratch, a, o, b, p, limit):
                return False
    return True


@inner_kernel
def _allowed(plan: _Plan, piece: int, x: int, y: int) -> bool:
    """Tell whether two entities may touch in a task that a piece belongs to."""
    for task in plan.tasks[piece]:
        if task >= 0 and plan.rules.allowed[task, x, y]:
            return True
    return False
