"""Everything a moving robot may run into over time, laid out for compiled code."""

from __future__ import annotations

from itertools import count
from typing import NamedTuple

import numpy as np
from numba import njit

from planning.cell.compiled_robot import RobotKernel
from planning.construction.checks.arena import (
    Arena,
    Memory,
    column,
    counting,
    pack,
    row,
    table,
    truths,
)
from planning.construction.world.fleet import Fleet
from planning.construction.world.tracks import Tracks
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import Scratch
from planning.transforms import Array, Indices

_KEYS = count()

# The fleet; see Fleet. Movers are its first carriers, their bodies its first bodies.
JOINT_FIRST, BODY_FIRST, BODY_JOINT, BODY_ENTITY = (next(_KEYS) for _ in range(4))
CAPSULE_FIRST, CAPSULE_JOINT, CORNER_FIRST = (next(_KEYS) for _ in range(3))
PLACEMENT, AXIS, BASE = (next(_KEYS) for _ in range(3))
START, END, ENDS, RADIUS, CORNERS = (next(_KEYS) for _ in range(5))
# The other robots; see Tracks.
TRACK_FIRST, PIECE_WHOLE, PIECE_CARRIER = (next(_KEYS) for _ in range(3))
PIECE_BODY, PIECE_CAPSULE = (next(_KEYS) for _ in range(2))
PIECE_START, PIECE_END, PIECE_A, PIECE_B, PIECE_BOX = (next(_KEYS) for _ in range(5))
SWEPT_BOX, SWEPT_A, SWEPT_B, SWEPT_RADIUS, TREE = (next(_KEYS) for _ in range(5))
# What lies still; see StillBoxes.
BOX_POSE, BOX_HALF, BOX_BOUNDS, BOX_FROM, BOX_UNTIL = (next(_KEYS) for _ in range(5))
BOX_CORNERS, BOX_ENDS, BOX_RADIUS = (next(_KEYS) for _ in range(3))
BOX_JOINT, BOX_CORNER_FIRST, BOX_CAPSULE_FIRST = (next(_KEYS) for _ in range(3))
# Least distances of own bodies to boxes, to entities, and to each other (upper triangle).
BOX_LIMIT, ENTITY_LIMIT, OWN_LIMIT = (next(_KEYS) for _ in range(3))
# When each mover is free to move; the mover of each own body; see Settings.
BEGIN, MOVER, SETTINGS = (next(_KEYS) for _ in range(3))
# Room to work in: own bodies on a stretch, those of another robot, places to go on from.
OWN_QA, OWN_QB, OWN_A, OWN_B, OWN_MOVED = (next(_KEYS) for _ in range(5))
OWN_RADIUS, OWN_BOX, AROUND, NEAR = (next(_KEYS) for _ in range(4))
OTHER_QA, OTHER_QB, OTHER_A, OTHER_B = (next(_KEYS) for _ in range(4))
OTHER_MOVED, OTHER_RADIUS, OTHER_BOX = (next(_KEYS) for _ in range(3))
POSES, MIDDLE, STACK = (next(_KEYS) for _ in range(3))
HULL_POSES, HULL_CORNERS, HULL_STACK = (next(_KEYS) for _ in range(3))
HULL_POSED, HULL_WHERE, HULL_JOINTS, HULL_DIRECTION = (next(_KEYS) for _ in range(4))
PAIRS, BOX_NUMBER = (next(_KEYS) for _ in range(2))
KEYS = next(_KEYS)

STEP, HALVINGS, WIDEST = 0, 1, 2
"""Columns of SETTINGS: length of the cells of time [s], how often one may be halved, and the
greatest of all least distances [m]."""


class StillBoxes(NamedTuple):
    """Fixtures, and objects where they lie.

    Attributes:
        pose, half: of each, shapes (b, 4, 4), (b, 3).
        bounds: least and greatest corner, shape (b, 6).
        start, end: when it is there, shape (b,) [s].
        hulls: the bodies.
    """

    pose: Array
    half: Array
    bounds: Array
    start: Array
    end: Array
    hulls: HullTable


class Limits(NamedTuple):
    """Least distances of own bodies [m], SKIP where a pair is not checked.

    Attributes:
        boxes: to boxes, shape (o, b).
        entities: to bodies of other robots by entity, shape (o, entities).
        own: to each other, upper triangle, shape (o, o).
    """

    boxes: Array
    entities: Array
    own: Array


def lay_out(
    fleet: Fleet,
    tracks: Tracks,
    boxes: StillBoxes,
    limits: Limits,
    begin: Array,
    step: float,
    halvings: int,
) -> Memory:
    """Return the scene, with room to work in: one for each thread.

    Args:
        fleet: movers, then all other carriers.
        tracks: the other robots.
        boxes: what lies still.
        limits: least distances.
        begin: time from which on each mover moves; until then it is one of the tracks, shape
            (movers,) [s].
        step: cells of time begin at multiples of this [s].
        halvings: how often a cell may be halved where robots are close.
    """
    movers = len(begin)
    most = int(np.diff(fleet.joint_first).max())
    capsules = np.diff(fleet.capsule_first[fleet.body_first])
    own = int(fleet.capsule_first[fleet.body_first[movers]])
    own_bodies = int(fleet.body_first[movers])
    other, bodies = int(capsules.max()), int(np.diff(fleet.body_first).max())
    corners = int(np.diff(fleet.corner_first).max())
    corners = max(corners, int(np.diff(boxes.hulls.corner_first).max(initial=0)))
    n = int(fleet.joint_first[movers])
    counts = np.diff(fleet.body_first[: movers + 1])
    widest = max(0.0, *(float(t.max(initial=0.0)) for t in limits))
    tables: dict[int, Array] = {
        PLACEMENT: fleet.placement,
        AXIS: fleet.axis,
        BASE: fleet.base,
        START: fleet.start,
        END: fleet.end,
        ENDS: fleet.ends,
        RADIUS: fleet.radius,
        CORNERS: fleet.corners,
        PIECE_START: tracks.start,
        PIECE_END: tracks.end,
        PIECE_A: tracks.q_a,
        PIECE_B: tracks.q_b,
        PIECE_BOX: tracks.box,
        SWEPT_BOX: tracks.body_box,
        SWEPT_A: tracks.capsule_a,
        SWEPT_B: tracks.capsule_b,
        SWEPT_RADIUS: tracks.radius,
        TREE: tracks.tree,
        BOX_POSE: boxes.pose,
        BOX_HALF: boxes.half,
        BOX_BOUNDS: boxes.bounds,
        BOX_FROM: boxes.start,
        BOX_UNTIL: boxes.end,
        BOX_CORNERS: boxes.hulls.corners,
        BOX_ENDS: boxes.hulls.ends,
        BOX_RADIUS: boxes.hulls.radius,
        BOX_LIMIT: limits.boxes,
        ENTITY_LIMIT: limits.entities,
        OWN_LIMIT: limits.own,
        BEGIN: begin,
        SETTINGS: np.array([step, float(halvings), widest]),
        OWN_QA: np.zeros(n),
        OWN_QB: np.zeros(n),
        OWN_A: np.zeros((own, 3)),
        OWN_B: np.zeros((own, 3)),
        OWN_MOVED: np.zeros((own, most + 1)),
        OWN_RADIUS: np.zeros(own),
        OWN_BOX: np.zeros((own_bodies, 6)),
        AROUND: np.zeros(6),
        OTHER_QA: np.zeros(most),
        OTHER_QB: np.zeros(most),
        OTHER_A: np.zeros((other, 3)),
        OTHER_B: np.zeros((other, 3)),
        OTHER_MOVED: np.zeros((other, most + 1)),
        OTHER_RADIUS: np.zeros(other),
        OTHER_BOX: np.zeros((bodies, 6)),
        POSES: np.zeros((most + 1, 4, 4)),
        MIDDLE: np.zeros(most),
        STACK: np.zeros((256, 3)),
        HULL_POSES: np.zeros((4 * (most + 1), 4, 4)),
        HULL_CORNERS: np.zeros((4 * corners, 3)),
        HULL_STACK: np.zeros((64, 4)),
        HULL_WHERE: np.zeros(2),
        HULL_JOINTS: np.zeros((10, most)),
        HULL_DIRECTION: np.zeros(3),
    }
    rows: dict[int, Indices] = {
        JOINT_FIRST: fleet.joint_first,
        BODY_FIRST: fleet.body_first,
        BODY_JOINT: fleet.joint,
        BODY_ENTITY: fleet.entity,
        CAPSULE_FIRST: fleet.capsule_first,
        CAPSULE_JOINT: fleet.capsule_joint,
        CORNER_FIRST: fleet.corner_first,
        TRACK_FIRST: tracks.first,
        PIECE_WHOLE: tracks.whole.astype(np.int64),
        PIECE_CARRIER: tracks.carrier,
        PIECE_BODY: tracks.body_first,
        PIECE_CAPSULE: tracks.capsule_first,
        BOX_JOINT: boxes.hulls.joint,
        BOX_NUMBER: np.arange(len(boxes.pose)),
        BOX_CORNER_FIRST: boxes.hulls.corner_first,
        BOX_CAPSULE_FIRST: boxes.hulls.capsule_first,
        MOVER: np.repeat(np.arange(movers), counts),
        NEAR: np.zeros(max(len(tracks.first), len(boxes.pose), 1), dtype=np.int64),
        HULL_POSED: np.zeros(2, dtype=np.int64),
        PAIRS: np.zeros(own_bodies * max(bodies, len(boxes.pose), 1), dtype=np.int64),
    }
    most_solids = max(bodies, len(boxes.pose))
    return pack(KEYS, tables, rows, fleet.prismatic, most_solids)


@njit(cache=True, nogil=True)
def kernel_of(scene: Arena, v: int) -> RobotKernel:
    """Return the joints and capsules of one carrier."""
    j0, j1 = row(scene, JOINT_FIRST)[v], row(scene, JOINT_FIRST)[v + 1]
    first, capsules = row(scene, BODY_FIRST), row(scene, CAPSULE_FIRST)
    c0, c1 = capsules[first[v]], capsules[first[v + 1]]
    joint = row(scene, CAPSULE_JOINT)[c0:c1]
    placement = table(scene, PLACEMENT)[4 * j0 : 4 * j1]
    return RobotKernel(
        placement.reshape(j1 - j0, 4, 4),
        table(scene, AXIS)[j0:j1],
        truths(scene)[j0:j1],
        table(scene, BASE)[4 * v : 4 * v + 4],
        joint,
        table(scene, START)[c0:c1],
        table(scene, END)[c0:c1],
        column(scene, RADIUS)[c0:c1],
        # Bodies are ranges of capsules here; nothing that sweeps looks at this.
        joint,
    )


@njit(cache=True, nogil=True)
def hulls_of(scene: Arena, v: int, q_a: Array, q_b: Array) -> HullTable:
    """Return the hulls of one carrier on one segment, ends of shape (1, n)."""
    b0, b1 = row(scene, BODY_FIRST)[v], row(scene, BODY_FIRST)[v + 1]
    ends = table(scene, ENDS)
    return HullTable(
        kernel_of(scene, v),
        q_a,
        q_b,
        counting(scene),
        row(scene, BODY_JOINT)[b0:b1],
        row(scene, CORNER_FIRST)[b0 : b1 + 1],
        table(scene, CORNERS),
        row(scene, CAPSULE_FIRST)[b0 : b1 + 1],
        ends.reshape(ends.shape[0] // 2, 2, 3),
        column(scene, RADIUS),
    )


@njit(cache=True, nogil=True)
def still_hulls(scene: Arena) -> HullTable:
    """Return the hulls of what lies still."""
    ends = table(scene, BOX_ENDS)
    # No robot carries them; any one's joints will do, and no one looks where they are.
    n = row(scene, JOINT_FIRST)[1]
    q = column(scene, OTHER_QA)[:n].reshape(1, n)
    return HullTable(
        kernel_of(scene, 0),
        q,
        q,
        counting(scene),
        row(scene, BOX_JOINT),
        row(scene, BOX_CORNER_FIRST),
        table(scene, BOX_CORNERS),
        row(scene, BOX_CAPSULE_FIRST),
        ends.reshape(ends.shape[0] // 2, 2, 3),
        column(scene, BOX_RADIUS),
    )


@njit(cache=True, nogil=True)
def scratch_of(scene: Arena) -> Scratch:
    """Return the room in which hulls are compared."""
    poses = table(scene, HULL_POSES)
    k = poses.shape[0] // 16
    poses = poses.reshape(4 * k, 4, 4)
    corners = table(scene, HULL_CORNERS)
    half = corners.shape[0] // 2
    joints = table(scene, HULL_JOINTS)
    return Scratch(
        poses[:k],
        poses[k : 2 * k],
        poses[2 * k : 3 * k],
        poses[3 * k :],
        corners[:half],
        corners[half:],
        table(scene, HULL_STACK),
        row(scene, HULL_POSED),
        column(scene, HULL_WHERE),
        joints[:5],
        joints[5:],
        column(scene, HULL_DIRECTION),
    )


@njit(cache=True, inline="always")
def apart(a: Array, b: Array, limit: float) -> bool:
    """Tell whether two boxes, shape (6,), are further apart than a limit."""
    return bool(
        a[0] - b[3] > limit
        or b[0] - a[3] > limit
        or a[1] - b[4] > limit
        or b[1] - a[4] > limit
        or a[2] - b[5] > limit
        or b[2] - a[5] > limit
    )
