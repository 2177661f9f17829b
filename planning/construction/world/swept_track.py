"""What one robot on a fixed timeline sweeps, piece by piece: capsules and boxes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numba import njit

from planning.cell.workcell import CellObject, PlacedRobot
from planning.construction.world.fleet import (
    Carrier,
    Fleet,
    build_fleet,
    carrier_kernel,
)
from planning.construction.world.hands import Hand, HandChange, pose_of
from planning.construction.world.motion_pieces import Pieces
from planning.geometry.swept import place_capsules
from planning.transforms import Array, Indices


class SweptTrack(NamedTuple):
    """The pieces of one robot, and what it sweeps in each.

    Attributes:
        pieces: in order.
        hands: what the robot has in its hand at some time, each once.
        hand: which of them it is, shape (p,).
        box: least and greatest corner of what a piece sweeps, shape (p, 6).
        body_first: where a piece's bodies begin in ``body_box``, shape (p + 1,).
        body_box: likewise of every body, shape (bodies of all pieces, 6).
        capsule_first: where a piece's capsules begin in the next three, shape (p + 1,).
        capsule_a, capsule_b, radius: swept capsules.
    """

    pieces: Pieces
    hands: tuple[Hand, ...]
    hand: Indices
    box: Array
    body_first: Indices
    body_box: Array
    capsule_first: Indices
    capsule_a: Array
    capsule_b: Array
    radius: Array

    def since(self, t: float) -> SweptTrack:
        """Return the pieces that end after a time [s]."""
        k = int(np.searchsorted(self.pieces.end, t, side="right"))
        b, c = self.body_first[k], self.capsule_first[k]
        return SweptTrack(
            self.pieces.later(k),
            self.hands,
            self.hand[k:],
            self.box[k:],
            self.body_first[k:] - b,
            self.body_box[b:],
            self.capsule_first[k:] - c,
            self.capsule_a[c:],
            self.capsule_b[c:],
            self.radius[c:],
        )


def carriers_of(
    robot: PlacedRobot, hands: Sequence[Hand], item: Callable[[str], CellObject]
) -> list[Carrier]:
    """Return a robot with each of the things that it holds at some time.

    Args:
        robot: who holds them.
        hands: what it holds.
        item: returns an object by its name.
    """
    return [
        (robot, tuple((item(name), pose_of(pose)) for name, pose in held))
        for held in hands
    ]


def sweep_track(
    robot: PlacedRobot,
    pieces: Pieces,
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
    hands = tuple(changes[k][1] for k in used.tolist())
    fleet = build_fleet(carriers_of(robot, hands, item), lambda _: 0)
    capsule_first = fleet.capsule_first[fleet.body_first]
    bodies = np.concatenate([[0], np.diff(fleet.body_first)[hand].cumsum()])
    capsules = np.concatenate([[0], np.diff(capsule_first)[hand].cumsum()])
    track = SweptTrack(
        pieces,
        hands,
        hand.astype(np.int64),
        np.empty((len(hand), 6)),
        bodies.astype(np.int64),
        np.empty((int(bodies[-1]), 6)),
        capsules.astype(np.int64),
        np.empty((int(capsules[-1]), 3)),
        np.empty((int(capsules[-1]), 3)),
        np.empty(int(capsules[-1])),
    )
    _sweep(
        fleet,
        pieces.q_a,
        pieces.q_b,
        track.hand,
        track.box,
        track.body_first,
        track.body_box,
        track.capsule_first,
        track.capsule_a,
        track.capsule_b,
        track.radius,
    )
    return track


@njit(cache=True, nogil=True)
def _sweep(
    fleet: Fleet,
    q_a: Array,
    q_b: Array,
    hand: Indices,
    box: Array,
    body_first: Indices,
    body_box: Array,
    capsule_first: Indices,
    capsule_a: Array,
    capsule_b: Array,
    radius: Array,
) -> None:
    """Fill in capsules and boxes."""
    n = q_a.shape[1]
    poses, q_mid = np.empty((n + 1, 4, 4)), np.empty(n)
    room = 0
    for p in range(len(hand)):
        room = max(room, capsule_first[p + 1] - capsule_first[p])
    moved = np.empty((room, n + 1))
    for p in range(len(hand)):
        v = hand[p]
        c0, c1 = capsule_first[p], capsule_first[p + 1]
        place_capsules(
            carrier_kernel(fleet, v),
            q_a[p],
            q_b[p],
            poses,
            q_mid,
            capsule_a[c0:c1],
            capsule_b[c0:c1],
            moved[: c1 - c0],
        )
        body = fleet.body_first[v]
        own = fleet.capsule_first[body]
        for c in range(c1 - c0):
            radius[c0 + c] = fleet.radius[own + c] + moved[c, 0]
        b0, b1 = body_first[p], body_first[p + 1]
        for b in range(b0, b1):
            low = c0 + fleet.capsule_first[body + b - b0] - own
            high = c0 + fleet.capsule_first[body + b - b0 + 1] - own
            bound_capsules(capsule_a, capsule_b, radius, low, high, body_box[b])
        for r in range(3):
            box[p, r] = np.min(body_box[b0:b1, r])
            box[p, r + 3] = np.max(body_box[b0:b1, r + 3])


@njit(cache=True, nogil=True)
def bound_capsules(
    a: Array, b: Array, radius: Array, first: int, last: int, out: Array
) -> None:
    """Write the least and greatest corner of capsules ``range(first, last)``, shape (6,)."""
    for r in range(3):
        low, high = np.inf, -np.inf
        for c in range(first, last):
            low = min(low, min(a[c, r], b[c, r]) - radius[c])
            high = max(high, max(a[c, r], b[c, r]) + radius[c])
        out[r], out[r + 3] = low, high
