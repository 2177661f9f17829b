"""Motions cleared by compiled code: what it cannot clear is left to the exact decision.

Capsules propose pairs of bodies; those whose hulls are proved apart are dropped.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.cell.compiled_robot import RobotKernel
from planning.geometry.exact import TOLERANCE
from planning.geometry.hull_table import HullTable
from planning.geometry.proposals import BOX, SELF, Scene, propose
from planning.geometry.separation import (
    APART,
    CONFLICT,
    Scratch,
    judge_hulls,
    pose_segments,
)
from planning.transforms import Array, Indices

_ROOM = 512

HIT = -1
"""In the place of a probe: somewhere the robot is too close to something."""


@njit(cache=True, nogil=True)
def _room(n: int, m: int, a_corners: int, b_corners: int) -> Scratch:
    """Return room for bodies of chains of n and m joints."""
    return Scratch(
        np.empty((n + 1, 4, 4)),
        np.empty((m + 1, 4, 4)),
        np.empty((n + 1, 4, 4)),
        np.empty((m + 1, 4, 4)),
        np.empty((2 * a_corners, 3)),
        np.empty((2 * b_corners, 3)),
        np.empty((64, 4)),
        np.full(2, -1, dtype=np.int64),
        np.empty(2),
        np.zeros((5, n)),
        np.zeros((5, m)),
        np.zeros(3),
    )


@njit(cache=True, nogil=True)
def _with_motion(table: HullTable, q_a: Array, q_b: Array) -> HullTable:
    """Return the same bodies on a motion of their own, shapes (1, n)."""
    return HullTable(
        table.kernel,
        q_a,
        q_b,
        table.solid,
        table.joint,
        table.corner_first,
        table.corners,
        table.capsule_first,
        table.ends,
        table.radius,
    )


@njit(cache=True, nogil=True)
def _pose_above(
    table: HullTable, root: int, q_a: Array, q_b: Array, scratch: Scratch
) -> None:
    """Pose a motion as it is seen from a joint: only the joints above it move."""
    n = q_a.shape[0]
    for j in range(n):
        if j <= root:
            table.q_a[0, j] = table.q_b[0, j] = 0.5 * (q_a[j] + q_b[j])
        else:
            table.q_a[0, j], table.q_b[0, j] = q_a[j], q_b[j]
    scratch.posed[0] = scratch.posed[1] = -1
    pose_segments(table, 0, table, 0, scratch)


@njit(cache=True, nogil=True)
def _keep_unproved(
    scene: Scene,
    moving: HullTable,
    boxes: HullTable,
    others: HullTable,
    corners: Indices,
    q_a: Array,
    q_b: Array,
    when: Array,
    what: Indices,
    count: int,
    stop: bool,
) -> int:
    """Move the proposals that are not proved apart to the front; return how many there are.

    With ``stop`` set, HIT as soon as one of them is proved too close.
    """
    n = q_a.shape[0]
    on_boxes = _room(n, boxes.q_a.shape[1], corners[0], corners[1])
    on_others = _room(n, others.q_a.shape[1], corners[0], corners[2])
    on_itself = _room(n, n, corners[0], corners[0])
    whole = _with_motion(moving, np.empty((1, n)), np.empty((1, n)))
    above = _with_motion(moving, np.empty((1, n)), np.empty((1, n)))
    step = q_b - q_a
    lo = hi = -1.0
    root = -2
    kept = 0
    for k in range(count):
        kind, i, j = what[k]
        if when[k, 0] != lo or when[k, 1] != hi:
            lo, hi = when[k]
            whole.q_a[0] = q_a + lo * step
            whole.q_b[0] = q_a + hi * step
            on_boxes.posed[0] = on_others.posed[0] = -1
            root = -2
        if kind == SELF:
            lower = min(moving.joint[i], moving.joint[j])
            if lower != root:
                root = lower
                _pose_above(above, root, whole.q_a[0], whole.q_b[0], on_itself)
            on_itself.direction[:] = 0.0
            # What the exact decision tolerates is left to it.
            limit = scene.self_limit[i, j] + TOLERANCE
            answer = judge_hulls(above, 0, i, above, 0, j, limit, on_itself)
        elif kind == BOX:
            pose_segments(whole, 0, boxes, 0, on_boxes)
            limit = scene.box_limit[i, j]
            answer = judge_hulls(whole, 0, i, boxes, 0, j, limit, on_boxes)
        else:
            pose_segments(whole, 0, others, 0, on_others)
            limit = scene.solid_limit[i, j]
            answer = judge_hulls(whole, 0, i, others, 0, j, limit, on_others)
        if stop and answer == CONFLICT and kind != SELF:
            return HIT
        if answer != APART:
            when[kept, 0], when[kept, 1] = lo, hi
            for c in range(3):
                what[kept, c] = what[k, c]
            kept += 1
    return kept


@njit(cache=True, nogil=True)
def find_undecided(
    kernel: RobotKernel,
    scene: Scene,
    moving: HullTable,
    boxes: HullTable,
    others: HullTable,
    corners: Indices,
    q_a: Array,
    q_b: Array,
    probes: Array,
    begin: int,
    stop: bool,
    resolution: float,
) -> tuple[int, Array, Indices]:
    """Look at some configurations of a motion, then at all of it, until something is undecided.

    Args:
        kernel: the moving robot.
        scene: what stands around it.
        moving, boxes, others: corners of its bodies, the boxes and the other robots.
        corners: most corners of a solid in each of these three, shape (3,).
        q_a, q_b: ends of the motion, shape (n,).
        probes: parameters in [0, 1] of the configurations to look at first, shape (p,).
        begin: the first of them to look at; p for the motion as a whole.
        stop: whether one pair that is proved too close is enough to know.
        resolution: see ``propose``.

    Returns:
        The number of the probe (p for the whole motion, p + 1 when all is clear, HIT for a pair
        that is too close), and of what
        is undecided there the stretches, shape (k, 2), and rows (kind, own body, other), shape
        (k, 3). Stretches are parameters of the whole motion, and [0, 0] for a probe.
    """
    for k in range(begin, len(probes) + 1):
        first, last = q_a, q_b
        if k < len(probes):
            first = q_a + probes[k] * (q_b - q_a)
            last = first
        room = _ROOM
        when, what, count = propose(kernel, scene, first, last, resolution, room)
        while count < 0:
            room *= 8
            when, what, count = propose(kernel, scene, first, last, resolution, room)
        if count > 0:
            count = _keep_unproved(
                scene,
                moving,
                boxes,
                others,
                corners,
                first,
                last,
                when,
                what,
                count,
                stop,
            )
        if count == HIT:
            return HIT, when[:0].copy(), what[:0].copy()
        if count > 0:
            return k, when[:count].copy(), what[:count].copy()
    return len(probes) + 1, np.empty((0, 2)), np.empty((0, 3), dtype=np.int64)
