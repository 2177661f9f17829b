"""Robots on fixed timelines as obstacles: swept capsules in a tree over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.construction.fleet import Fleet, Integers, carrier_kernel
from planning.construction.motion_pieces import Pieces
from planning.geometry.swept import place_capsules
from planning.transforms import Array


class Tracks(NamedTuple):
    """The pieces of many robots.

    Attributes:
        first: pieces of track r are ``range(first[r], first[r + 1])``.
        start, end: the time for which a piece counts, shape (p,) [s].
        q_a, q_b: ends of its motion, padded to the most joints, shape (p, most).
        whole: True where it counts as a whole all the time, shape (p,).
        carrier: which carrier of the fleet it is, shape (p,).
        box: least and greatest corner of what it sweeps, shape (p, 6).
        body_first: where a piece's bodies begin in ``body_box``, shape (p + 1,).
        body_box: likewise of every body, shape (bodies of all pieces, 6).
        capsule_first: where a piece's capsules begin in the next three, shape (p + 1,).
        capsule_a, capsule_b, radius: swept capsules.
        tree_first: where the tree of a track begins in ``tree``, shape (r + 1,).
        tree: boxes of ever longer stretches of a track: a segment tree whose leaf i is piece i
            of its track, shape (nodes, 6).
    """

    first: Integers
    start: Array
    end: Array
    q_a: Array
    q_b: Array
    whole: npt.NDArray[np.bool_]
    carrier: Integers
    box: Array
    body_first: Integers
    body_box: Array
    capsule_first: Integers
    capsule_a: Array
    capsule_b: Array
    radius: Array
    tree_first: Integers
    tree: Array


def build_tracks(
    fleet: Fleet, pieces: Sequence[Pieces], carrier: Sequence[Integers]
) -> Tracks:
    """Sweep all pieces.

    Args:
        fleet: the carriers.
        pieces: of each robot.
        carrier: of each piece of each robot.
    """
    most = int(np.max(np.diff(fleet.joint_first)))
    counts = [len(p.start) for p in pieces]
    first = np.cumsum([0, *counts]).astype(np.int64)
    none = np.empty(0)
    start = np.concatenate([none, *(p.start for p in pieces)])
    end = np.concatenate([none, *(p.end for p in pieces)])
    whole = np.concatenate([none, *(p.whole for p in pieces)]).astype(np.bool_)
    q_a, q_b = np.zeros((len(start), most)), np.zeros((len(start), most))
    for p, at in zip(pieces, first[:-1], strict=True):
        n = p.q_a.shape[1]
        q_a[at : at + len(p.start), :n] = p.q_a
        q_b[at : at + len(p.start), :n] = p.q_b
    of = np.concatenate([none, *carrier]).astype(np.int64)
    bodies = fleet.body_first[of + 1] - fleet.body_first[of]
    capsules = (
        fleet.capsule_first[fleet.body_first[of + 1]]
        - fleet.capsule_first[fleet.body_first[of]]
    )
    body_first = np.concatenate([[0], np.cumsum(bodies)]).astype(np.int64)
    capsule_first = np.concatenate([[0], np.cumsum(capsules)]).astype(np.int64)
    tree_first = 2 * first
    box = np.empty((len(start), 6))
    body_box = np.empty((int(body_first[-1]), 6))
    capsule_a = np.empty((int(capsule_first[-1]), 3))
    capsule_b = np.empty_like(capsule_a)
    radius = np.empty(len(capsule_a))
    tree = np.empty((int(tree_first[-1]), 6))
    tracks = Tracks(
        first,
        start,
        end,
        q_a,
        q_b,
        whole,
        of,
        box,
        body_first,
        body_box,
        capsule_first,
        capsule_a,
        capsule_b,
        radius,
        tree_first,
        tree,
    )
    _sweep(fleet, tracks)
    return tracks


@njit(cache=True)
def _sweep(fleet: Fleet, tracks: Tracks) -> None:
    """Fill in capsules, boxes and trees."""
    most = tracks.q_a.shape[1]
    poses, q_mid = np.empty((most + 1, 4, 4)), np.empty(most)
    room = 0
    for v in range(len(fleet.body_first) - 1):
        c0 = fleet.capsule_first[fleet.body_first[v]]
        c1 = fleet.capsule_first[fleet.body_first[v + 1]]
        room = max(room, c1 - c0)
    moved = np.empty((room, most + 1))
    for p in range(len(tracks.start)):
        v = tracks.carrier[p]
        n = fleet.joint_first[v + 1] - fleet.joint_first[v]
        c0, c1 = tracks.capsule_first[p], tracks.capsule_first[p + 1]
        place_capsules(
            carrier_kernel(fleet, v),
            tracks.q_a[p, :n],
            tracks.q_b[p, :n],
            poses,
            q_mid[:n],
            tracks.capsule_a[c0:c1],
            tracks.capsule_b[c0:c1],
            moved[: c1 - c0],
        )
        own = fleet.capsule_first[fleet.body_first[v]]
        for c in range(c1 - c0):
            tracks.radius[c0 + c] = fleet.radius[own + c] + moved[c, 0]
        b0, b1 = tracks.body_first[p], tracks.body_first[p + 1]
        body = fleet.body_first[v]
        for b in range(b0, b1):
            low = c0 + fleet.capsule_first[body + b - b0] - own
            high = c0 + fleet.capsule_first[body + b - b0 + 1] - own
            bound_capsules(
                tracks.capsule_a,
                tracks.capsule_b,
                tracks.radius,
                low,
                high,
                tracks.body_box[b],
            )
        for r in range(3):
            tracks.box[p, r] = np.min(tracks.body_box[b0:b1, r])
            tracks.box[p, r + 3] = np.max(tracks.body_box[b0:b1, r + 3])
    for t in range(len(tracks.first) - 1):
        first = tracks.first[t]
        count = tracks.first[t + 1] - first
        base = tracks.tree_first[t]
        for i in range(count):
            tracks.tree[base + count + i] = tracks.box[first + i]
        for i in range(count - 1, 0, -1):
            for r in range(3):
                a, b = tracks.tree[base + 2 * i], tracks.tree[base + 2 * i + 1]
                tracks.tree[base + i, r] = min(a[r], b[r])
                tracks.tree[base + i, r + 3] = max(a[r + 3], b[r + 3])


@njit(cache=True)
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


@njit(cache=True)
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


@njit(cache=True)
def near_stretch(
    tree: Array, base: int, count: int, a: int, b: int, box: Array, limit: float
) -> bool:
    """Tell whether a box comes within a limit of the boxes of a stretch of a track.

    Few nodes of the track's tree make up any stretch.

    Args:
        tree: of all tracks.
        base, count: where that of the track begins, and how many pieces the track has.
        a, b: the stretch, ``range(a, b)``, counted within the track.
        box: shape (6,).
        limit: [m].
    """
    a += count
    b += count
    while a < b:
        if a & 1:
            if _meet(tree, base + a, box, limit):
                return True
            a += 1
        if b & 1:
            b -= 1
            if _meet(tree, base + b, box, limit):
                return True
        a >>= 1
        b >>= 1
    return False


@njit(cache=True, inline="always")
def _meet(tree: Array, i: int, box: Array, limit: float) -> bool:
    return bool(
        box[0] - tree[i, 3] <= limit
        and tree[i, 0] - box[3] <= limit
        and box[1] - tree[i, 4] <= limit
        and tree[i, 1] - box[4] <= limit
        and box[2] - tree[i, 5] <= limit
        and tree[i, 2] - box[5] <= limit
    )
