"""Conflicts of a space-time plan: pieces of different robots that overlap in time and come too close.

Distances are checked with the same capsules and convex hulls as in planning. A contact is allowed if the tasks of
both pieces allow it, as in a temporal plan graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Workcell
from planning.construction.world.fleet import (
    LoadedRobot,
    RobotFleet,
    bodies_of,
    make_fleet,
    set_motion,
)
from planning.construction.world.tracks import Tracks
from planning.geometry.distance import are_boxes_apart
from planning.geometry.exact import TOLERANCE
from planning.geometry.robot_bodies import cell_entities, limits_of_entities
from planning.geometry.separation import Scratch, make_scratch_for
from planning.geometry.swept import SKIP
from planning.joint_motion.moving_pairs import are_pairs_apart, write_near_pairs
from planning.kernels import ZERO, inner_kernel, kernel
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
        least: the least distance [m].
        allowed: whether two entities may touch in a task, shape (tasks, e, e).
        near: work array for pairs of bodies.
        scratch: work array.
    """

    fleet: RobotFleet
    entity: Indices
    tracks: Tracks
    tasks: Indices
    limits: Array
    least: float
    allowed: npt.NDArray[np.bool_]
    near: Indices
    scratch: Scratch


def conflicting_pieces(
    cell: Workcell,
    carriers: Sequence[LoadedRobot],
    tracks: Tracks,
    tasks: Indices,
    touching: Sequence[Pairs],
) -> list[tuple[int, int]]:
    """Return pairs of pieces that share time and are not proved to keep the cell's clearances.

    Args:
        cell: the static cell.
        carriers: those of the tracks.
        tracks: of all robots.
        tasks: the tasks that each piece belongs to: one given twice, or for a hold those
            before and after it, shape (pieces, 2).
        touching: pairs of entities that may touch, by task.
    """
    numbers = cell_entities(cell)
    least = cell.clearances.robot_robot + _MARGIN
    limits = limits_of_entities(numbers, least, ())
    # What is in both hands in the course of a handover.
    np.fill_diagonal(limits, SKIP)
    allowed = [limits_of_entities(numbers, 0.0, pairs) < 0.0 for pairs in touching]
    bodies, joints, corners = (
        max(values)
        for values in zip(
            *((len(h.joint), h.q_a.shape[1], h.most_corners) for _, h in carriers),
            strict=True,
        )
    )
    plan = packed(
        _CarrierPieces(
            make_fleet(carriers),
            np.concatenate([carrier.bodies.numbered(numbers) for carrier in carriers]),
            tracks,
            tasks,
            limits,
            least,
            np.array(allowed, dtype=np.bool_).reshape(-1, *limits.shape),
            np.empty(bodies * bodies, dtype=np.int64),
            make_scratch_for(joints, joints, corners, corners),
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
                        and not are_boxes_apart(box, i, box, j, plan.least)
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
    pieces, sweeps, near = plan.tracks.pieces, plan.tracks.sweeps, plan.near
    v, w = plan.tracks.carrier[i], plan.tracks.carrier[j]
    a, b = bodies_of(plan.fleet, v), bodies_of(plan.fleet, w)
    rows = entity[bodies[v] : bodies[v + 1]]
    columns = entity[bodies[w] : bodies[w + 1]]
    one, other = (a, sweeps, i, rows), (b, sweeps, j, columns)
    count = write_near_pairs(one, other, limits, plan.least, near)
    kept = ZERO
    for k in range(count):
        x, y = rows[near[k] // len(columns)], columns[near[k] % len(columns)]
        if not (_allowed(plan, i, x, y) and _allowed(plan, j, x, y)):
            near[kept] = near[k]
            kept += 1
    set_motion(a, pieces.q_a[i], pieces.q_b[i])
    set_motion(b, pieces.q_a[j], pieces.q_b[j])
    return are_pairs_apart(near, kept, (a, rows), (b, columns), limits, plan.scratch)


@inner_kernel
def _allowed(plan: _CarrierPieces, piece: int, x: int, y: int) -> bool:
    """Tell whether two entities may touch in a task that a piece belongs to."""
    allowed, before, after = plan.allowed, plan.tasks[piece, 0], plan.tasks[piece, 1]
    if before >= 0 and allowed[before, x, y]:
        return True
    return bool(after >= 0 and allowed[after, x, y])
