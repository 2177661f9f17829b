"""Robots on fixed timelines as obstacles: swept capsules in a tree over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.construction.world.swept_track import SweptTrack
from planning.transforms import Array, Indices


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
        tree: boxes of ever longer stretches of a track: a segment tree whose leaf i is piece i
            of its track; it begins at ``2 * first[r]``, shape (2 p, 6).
    """

    first: Indices
    start: Array
    end: Array
    q_a: Array
    q_b: Array
    whole: npt.NDArray[np.bool_]
    carrier: Indices
    box: Array
    body_first: Indices
    body_box: Array
    capsule_first: Indices
    capsule_a: Array
    capsule_b: Array
    radius: Array
    tree: Array


def build_tracks(swept: Sequence[SweptTrack], carrier: Sequence[Indices]) -> Tracks:
    """Put what robots sweep one after another, and grow a tree over each.

    Args:
        swept: of each robot.
        carrier: of each piece of each robot.
    """
    pieces = [s.pieces for s in swept]
    most = max((p.q_a.shape[1] for p in pieces), default=0)
    counts = [len(p.start) for p in pieces]
    first = np.cumsum([0, *counts]).astype(np.int64)
    none = np.empty(0)
    start = np.concatenate([none, *(p.start for p in pieces)])
    whole = np.concatenate([none, *(p.whole for p in pieces)]).astype(np.bool_)
    q_a, q_b = np.zeros((len(start), most)), np.zeros((len(start), most))
    for p, at in zip(pieces, first[:-1], strict=True):
        n = p.q_a.shape[1]
        q_a[at : at + len(p.start), :n] = p.q_a
        q_b[at : at + len(p.start), :n] = p.q_b
    box = np.concatenate([np.empty((0, 6)), *(s.box for s in swept)])
    tree = np.empty((2 * len(start), 6))
    _grow_trees(first, box, tree)
    return Tracks(
        first,
        start,
        np.concatenate([none, *(p.end for p in pieces)]),
        q_a,
        q_b,
        whole,
        np.concatenate([none, *carrier]).astype(np.int64),
        box,
        _joined([s.body_first for s in swept]),
        np.concatenate([np.empty((0, 6)), *(s.body_box for s in swept)]),
        _joined([s.capsule_first for s in swept]),
        np.concatenate([np.empty((0, 3)), *(s.capsule_a for s in swept)]),
        np.concatenate([np.empty((0, 3)), *(s.capsule_b for s in swept)]),
        np.concatenate([none, *(s.radius for s in swept)]),
        tree,
    )


def _joined(firsts: Sequence[Indices]) -> Indices:
    """Return where each piece's rows begin when those of all robots follow one another."""
    counts = [np.diff(first) for first in firsts]
    return np.cumsum(np.concatenate([[0], *counts])).astype(np.int64)


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
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
