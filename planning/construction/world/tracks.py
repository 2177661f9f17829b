"""Robots on fixed timelines as obstacles: swept capsules in a tree over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planning.construction.world.motion_pieces import Pieces
from planning.construction.world.swept_track import Sweeps, SweptTrack, no_sweeps
from planning.geometry.distance import boxes_apart
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices


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
    pieces: Pieces
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
    pieces = [Pieces(none, none, still, still, none.astype(np.bool_), none)]
    pieces += [_padded(s.pieces, most) for s in swept]
    sweeps = [no_sweeps(first[:0], first[:0]), *(s.sweeps for s in swept)]
    joined = Sweeps._make(map(np.concatenate, zip(*sweeps, strict=True)))
    tree = np.empty((2 * len(joined.box), 6))
    _grow_trees(first, joined.box, tree)
    tracks = Tracks(
        first,
        packed(Pieces._make(map(np.concatenate, zip(*pieces, strict=True)))),
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


def _padded(pieces: Pieces, joints: int) -> Pieces:
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
