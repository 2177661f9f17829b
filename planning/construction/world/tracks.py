"""Robots on fixed timelines as obstacles: what they sweep, piece by piece, in a tree over time.

Carriers, robots with what they hold, and their bodies for compiled code.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Attachment, CellObject, PlacedRobot, Workcell
from planning.construction.world.timeline import HandChange, MotionPieces, pose_of
from planning.geometry.distance import boxes_apart
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import entity_numbers, robot_bodies
from planning.geometry.swept import place_capsules
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import packed, packed_at
from planning.transforms import Array, Indices, Transform

Held = tuple[tuple[CellObject, Transform], ...]
"""The objects in a robot's hand, with their poses in the flange frame."""


class Carrier(NamedTuple):
    """A robot with something in its hand.

    Attributes:
        robot: who carries.
        names: entities of its bodies: the robot's parts, then what it holds.
        self_limits: least distance of two of them, see RobotBodies.
        hulls: these bodies on a motion of one segment, packed.
    """

    robot: PlacedRobot
    names: tuple[str, ...]
    self_limits: Array
    hulls: HullTable


def make_carrier(robot: PlacedRobot, held: Held = ()) -> Carrier:
    """Return a robot with what it holds."""
    hand = [(item, Attachment(robot.name, pose)) for item, pose in held]
    bodies = robot_bodies(robot, hand)
    hulls = bodies.hulls.on_a_motion()
    return Carrier(robot, bodies.entities, bodies.self_limits, hulls)


class Fleet(NamedTuple):
    """Many carriers. It keeps none of them alive.

    Attributes:
        hulls: addresses of their bodies, shape (carriers,).
        one: the bodies of one of them.
        body_first: bodies of carrier v are ``range(body_first[v], body_first[v + 1])``.
    """

    hulls: Indices
    one: HullTable
    body_first: Indices


def make_fleet(carriers: Sequence[Carrier]) -> Fleet:
    """Return carriers, at least one, for compiled code; they must outlive what is returned."""
    hulls = [carrier.hulls for carrier in carriers]
    addresses = np.array([h.address for h in hulls], dtype=np.int64)  # type: ignore[attr-defined]
    return packed(
        Fleet(addresses, hulls[0], np.cumsum([0, *(len(c.names) for c in carriers)]))
    )


@inner_kernel
def bodies_of(fleet: Fleet, v: int) -> HullTable:
    """Return the bodies of a carrier."""
    hulls: HullTable = packed_at(fleet.hulls, v, fleet.one)
    return hulls


@inner_kernel
def set_motion(hulls: HullTable, q_a: Array, q_b: Array) -> None:
    """Let a carrier's bodies be on a straight motion, whose ends have its joints first."""
    for j in range(hulls.q_a.shape[1]):
        hulls.q_a[0, j] = q_a[j]
        hulls.q_b[0, j] = q_b[j]


def cell_entities(cell: Workcell) -> dict[str, int]:
    """Return the number of every entity: arm and tool of each robot, fixtures, objects."""
    things = [f.name for f in cell.fixtures] + [o.name for o in cell.objects]
    return entity_numbers((robot.name for robot in cell.robots), things)


class Sweeps(NamedTuple):
    """Bounds of what bodies sweep in pieces of motion.

    Attributes:
        box: least and greatest corner of what a piece sweeps, shape (p, 6).
        body_first: where a piece's bodies begin in ``body_box``, shape (p + 1,).
        body_box: likewise of every body, shape (bodies of all pieces, 6).
        capsule_first: where a piece's capsules begin in the next three, shape (p + 1,).
        capsule_a, capsule_b, radius: swept capsules, shapes (c, 3), (c, 3), (c,).
    """

    box: Array
    body_first: Indices
    body_box: Array
    capsule_first: Indices
    capsule_a: Array
    capsule_b: Array
    radius: Array


class SweptTrack(NamedTuple):
    """The pieces of one robot, and what it sweeps in each.

    Attributes:
        pieces: in order.
        carriers: the robot with each of the things that it holds at some time.
        hand: which of them it is, shape (p,).
        sweeps: what it sweeps.
    """

    pieces: MotionPieces
    carriers: tuple[Carrier, ...]
    hand: Indices
    sweeps: Sweeps

    def since(self, t: float) -> SweptTrack:
        """Return the pieces that end after a time [s]."""
        k = int(np.searchsorted(self.pieces.end, t, side="right"))
        s = self.sweeps
        b, c = s.body_first[k], s.capsule_first[k]
        return SweptTrack(
            self.pieces.later(k),
            self.carriers,
            self.hand[k:],
            Sweeps(
                s.box[k:],
                s.body_first[k:] - b,
                s.body_box[b:],
                s.capsule_first[k:] - c,
                s.capsule_a[c:],
                s.capsule_b[c:],
                s.radius[c:],
            ),
        )


def sweep_track(
    robot: PlacedRobot,
    pieces: MotionPieces,
    changes: Sequence[HandChange],
    item: Callable[[str], CellObject],
) -> SweptTrack:
    """Sweep all pieces of a robot.

    Args:
        robot: who moves.
        pieces: how.
        changes: what it holds from when on; pieces end there.
        item: returns an object by its name.
    """
    times = np.array([t for t, _ in changes])
    at = np.searchsorted(times, pieces.moment + 1e-9, side="right") - 1
    used, hand = np.unique(at, return_inverse=True)
    carriers = [
        make_carrier(robot, tuple((item(name), pose_of(pose)) for name, pose in held))
        for held in (changes[k][1] for k in used.tolist())
    ]
    bodies = np.array([len(c.names) for c in carriers])[hand]
    capsules = np.array([len(c.hulls.radius) for c in carriers])[hand]
    sweeps = no_sweeps(bodies, capsules)
    hand = hand.astype(np.int64)
    q_a, q_b = pieces.q_a, pieces.q_b
    room = packed(Room(np.empty((q_a.shape[1] + 1, 4, 4)), np.empty(q_a.shape[1])))
    _sweep_pieces(make_fleet(carriers), q_a, q_b, hand, packed(sweeps), room)
    return SweptTrack(pieces, tuple(carriers), hand, sweeps)


def no_sweeps(bodies: Indices, capsules: Indices) -> Sweeps:
    """Return room for what is swept in pieces, with so many bodies and capsules each."""
    body_first, capsule_first = (
        np.cumsum([0, *counts]).astype(np.int64) for counts in (bodies, capsules)
    )
    count = int(capsule_first[-1])
    return Sweeps(
        np.zeros((len(bodies), 6)),
        body_first,
        np.zeros((int(body_first[-1]), 6)),
        capsule_first,
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros(count),
    )


class Room(NamedTuple):
    """Room to sweep a carrier in.

    Attributes:
        poses: of its joints, shape (n + 1, 4, 4).
        middle: a configuration, shape (n,).
    """

    poses: Array
    middle: Array


@kernel
def _sweep_pieces(
    fleet: Fleet, q_a: Array, q_b: Array, hand: Indices, sweeps: Sweeps, room: Room
) -> None:
    most = 0
    for p in range(len(hand)):
        most = max(most, sweeps.capsule_first[p + 1] - sweeps.capsule_first[p])
    moved = np.empty((most, q_a.shape[1] + 1))
    box, body_box = sweeps.box, sweeps.body_box
    for p in range(len(hand)):
        first = sweeps.body_first[p], sweeps.capsule_first[p]
        hulls = bodies_of(fleet, hand[p])
        sweep_carrier(hulls, q_a[p], q_b[p], first, sweeps, moved, room)
        b0, b1 = sweeps.body_first[p], sweeps.body_first[p + 1]
        for r in range(3):
            box[p, r] = np.min(body_box[b0:b1, r])
            box[p, r + 3] = np.max(body_box[b0:b1, r + 3])


@inner_kernel
def sweep_carrier(
    hulls: HullTable,
    q_a: Array,
    q_b: Array,
    first: tuple[int, int],
    out: Sweeps,
    moved: Array,
    room: Room,
) -> None:
    """Write the capsules and the boxes of the bodies of a carrier on a straight motion.

    Args:
        hulls: its bodies.
        q_a, q_b: ends of its motion, shape (n,).
        first: where its bodies and its capsules begin in ``out``.
        out: ``body_box``, ``capsule_a``, ``capsule_b`` and ``radius`` are written.
        moved: how far capsules stray, see ``place_capsules``, shape (at least c, n + 1), written.
        room: room to work in.
    """
    body, start = first
    capsules, count = hulls.capsule_first, len(hulls.radius)
    a, b, radius = out.capsule_a, out.capsule_b, out.radius
    place_capsules(
        hulls,
        q_a,
        q_b,
        room.poses,
        room.middle[: len(q_a)],
        a[start : start + count],
        b[start : start + count],
        moved,
    )
    bare, box = hulls.radius, out.body_box
    for c in range(count):
        radius[start + c] = bare[c] + moved[c, 0]
    for k in range(len(hulls.joint)):
        low, high = start + capsules[k], start + capsules[k + 1]
        for r in range(3):
            least, most = np.inf, -np.inf
            for c in range(low, high):
                least = min(least, min(a[c, r], b[c, r]) - radius[c])
                most = max(most, max(a[c, r], b[c, r]) + radius[c])
            box[body + k, r], box[body + k, r + 3] = least, most


class Tracks(NamedTuple):
    """The pieces of many robots.

    Attributes:
        first: pieces of track r are ``range(first[r], first[r + 1])``.
        pieces: of all tracks; configurations are padded to the most joints.
        carrier: which carrier of the fleet a piece is, shape (p,).
        sweeps: what pieces sweep.
        tree: boxes of ever longer stretches of a track: a segment tree whose leaf i is piece i
            of its track; it begins at ``2 * first[r]``, shape (2 p, 6).
    """

    first: Indices
    pieces: MotionPieces
    carrier: Indices
    sweeps: Sweeps
    tree: Array


def build_tracks(swept: Sequence[SweptTrack], carriers: int) -> Tracks:
    """Put what robots sweep one after another, and grow a tree over each.

    Args:
        swept: of each robot.
        carriers: how many carriers come before those of the tracks in the fleet.
    """
    counts = np.array([len(s.hand) for s in swept], dtype=np.int64)
    first = np.cumsum([0, *counts])
    hands = carriers + np.cumsum([0, *(len(s.carriers) for s in swept)])
    most = max((s.pieces.q_a.shape[1] for s in swept), default=0)
    none, still = np.empty(0), np.empty((0, most))
    pieces = [MotionPieces(none, none, still, still, none.astype(np.bool_), none)]
    pieces += [_padded(s.pieces, most) for s in swept]
    sweeps = [no_sweeps(first[:0], first[:0]), *(s.sweeps for s in swept)]
    joined = Sweeps._make(map(np.concatenate, zip(*sweeps, strict=True)))
    tree = np.empty((2 * len(joined.box), 6))
    _grow_trees(first, joined.box, tree)
    tracks = Tracks(
        first,
        packed(MotionPieces._make(map(np.concatenate, zip(*pieces, strict=True)))),
        np.repeat(hands[:-1], counts)
        + np.concatenate([first[:0], *(s.hand for s in swept)]),
        packed(
            joined._replace(
                body_first=_joined([s.body_first for s in sweeps]),
                capsule_first=_joined([s.capsule_first for s in sweeps]),
            )
        ),
        tree,
    )
    return packed(tracks)


def _padded(pieces: MotionPieces, joints: int) -> MotionPieces:
    """Return pieces with configurations of so many joints, zero beyond those that there are."""
    wider = ((0, 0), (0, joints - pieces.q_a.shape[1]))
    return pieces._replace(q_a=np.pad(pieces.q_a, wider), q_b=np.pad(pieces.q_b, wider))


def _joined(firsts: Sequence[Indices]) -> Indices:
    """Return where each piece's rows begin when those of all robots follow one another."""
    counts = [np.diff(first) for first in firsts]
    return np.cumsum(np.concatenate([[0], *counts])).astype(np.int64)


@kernel
def _grow_trees(firsts: Indices, box: Array, tree: Array) -> None:
    """Fill in the tree of each track."""
    for t in range(len(firsts) - 1):
        first, base = firsts[t], 2 * firsts[t]
        count = firsts[t + 1] - first
        for i in range(count):
            tree[base + count + i] = box[first + i]
        for i in range(count - 1, 0, -1):
            a, b = tree[base + 2 * i], tree[base + 2 * i + 1]
            for r in range(3):
                tree[base + i, r] = min(a[r], b[r])
                tree[base + i, r + 3] = max(a[r + 3], b[r + 3])


@inner_kernel
def pieces_at(
    start: Array, end: Array, first: int, last: int, lo: float, hi: float
) -> tuple[int, int]:
    """Return which of the pieces ``range(first, last)`` share time with a span, as a range.

    Args:
        start, end: the time for which each piece counts, shape (p,) [s].
        first, last: the pieces of one track.
        lo, hi: the span; equal for one instant [s].
    """
    eps = 1e-9
    a, b = first, last
    while a < b:
        m = (a + b) // 2
        if end[m] > lo + eps:
            b = m
        else:
            a = m + 1
    p = a
    b = last
    while a < b:
        m = (a + b) // 2
        if start[m] < hi - eps:
            a = m + 1
        else:
            b = m
    if a == p and hi - lo < eps and p < last and start[p] <= lo + eps:
        a = p + 1
    return p, a


@inner_kernel
def near_stretch(
    tree: Array, base: int, count: int, a: int, b: int, box: Array, limit: float
) -> bool:
    """Tell whether a box comes within a limit of the boxes of a stretch of a track.

    Few nodes of the track's tree make up any stretch.

    Args:
        tree: of all tracks.
        base, count: where that of the track begins, and how many pieces the track has.
        a, b: the stretch, ``range(a, b)``, counted within the track.
        box: shape (1, 6).
        limit: [m].
    """
    a += count
    b += count
    while a < b:
        if a & 1:
            if not boxes_apart(tree, base + a, box, ZERO, limit):
                return True
            a += 1
        if b & 1:
            b -= 1
            if not boxes_apart(tree, base + b, box, ZERO, limit):
                return True
        a >>= 1
        b >>= 1
    return False
