"""Conflicts of a space-time plan: pieces of different robots that share time and come too close.

The same capsules and hulls as in planning; contacts are allowed where the tasks of both pieces
allow them, as in a temporal plan graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Workcell
from planning.construction.checks.still_checks import capsules_meet, proved_apart
from planning.construction.world.tracks import (
    Carrier,
    Fleet,
    Tracks,
    bodies_of,
    cell_entities,
    make_fleet,
    set_motion,
)
from planning.geometry.distance import boxes_apart
from planning.geometry.exact import TOLERANCE
from planning.geometry.separation import Scratch, room_for
from planning.kernels import inner_kernel, kernel
from planning.packed import packed
from planning.steps.skill import Pairs
from planning.transforms import Array, Indices

_MARGIN = 1.5 * TOLERANCE
"""Kept on top of the clearances: enough for the exact decisions of the conflict search [m]."""


class _CarrierPieces(NamedTuple):
    """Pieces of all carriers, and how close they may come to each other.

    Attributes:
        fleet: all carriers.
        entity: of each of their bodies.
        tracks: all pieces.
        tasks: to which a piece belongs, shape (pieces, 2).
        limits: least distance of two entities, shape (e, e) [m].
        allowed: whether two entities may touch in a task, shape (tasks, e, e).
        scratch: room to work in.
    """

    fleet: Fleet
    entity: Indices
    tracks: Tracks
    tasks: Indices
    limits: Array
    allowed: npt.NDArray[np.bool_]
    scratch: Scratch


def conflicting_pieces(
    cell: Workcell,
    carriers: Sequence[Carrier],
    tracks: Tracks,
    tasks: Indices,
    touching: Sequence[Pairs],
) -> list[tuple[int, int]]:
    """Return pairs of pieces that share time and are not proved to keep the cell's clearances.

    Args:
        cell: the static cell.
        carriers: those of the tracks.
        tracks: of all robots.
        tasks: the tasks that each piece belongs to: one given twice, or for a stand those
            before and after it, shape (pieces, 2).
        touching: pairs of entities that may touch, by task.
    """
    numbers = cell_entities(cell)
    count = len(numbers)
    limits = np.full((count, count), cell.clearances.robot_robot + _MARGIN)
    allowed = np.zeros((len(touching), count, count), dtype=np.bool_)
    for task, pairs in enumerate(touching):
        for pair in pairs:
            a, b = (numbers[name] for name in pair)
            allowed[task, a, b] = allowed[task, b, a] = True
    names = [name for carrier in carriers for name in carrier.names]
    joints = max(c.hulls.q_a.shape[1] for c in carriers)
    corners = max(c.hulls.most_corners for c in carriers)
    plan = packed(
        _CarrierPieces(
            make_fleet(carriers),
            np.array([numbers[name] for name in names], dtype=np.int64),
            tracks,
            tasks,
            limits,
            allowed,
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
def _find(plan: _CarrierPieces, out: Indices) -> int:
    first, box = plan.tracks.first, plan.tracks.sweeps.box
    start, end = plan.tracks.pieces.start, plan.tracks.pieces.end
    widest = np.max(plan.limits)
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
def _pair_clear(plan: _CarrierPieces, i: int, j: int) -> bool:
    bodies, entity, limits = plan.fleet.body_first, plan.entity, plan.limits
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
def _allowed(plan: _CarrierPieces, piece: int, x: int, y: int) -> bool:
    """Tell whether two entities may touch in a task that a piece belongs to."""
    allowed, before, after = plan.allowed, plan.tasks[piece, 0], plan.tasks[piece, 1]
    if before >= 0 and allowed[before, x, y]:
        return True
    return bool(after >= 0 and allowed[after, x, y])
