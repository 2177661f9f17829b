"""Robots on fixed timelines as obstacles: swept capsules in a tree over time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from planning.construction.world.motion_pieces import Pieces
from planning.construction.world.swept_track import Sweeps, SweptTrack
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
    pieces, sweeps = [s.pieces for s in swept], [s.sweeps for s in swept]
    first = np.cumsum([0, *(len(p.start) for p in pieces)]).astype(np.int64)
    firsts = carriers + np.cumsum([0, *(len(s.carriers) for s in swept)])
    carrier = [at + s.hand for at, s in zip(firsts.tolist(), swept, strict=False)]
    most = max((p.q_a.shape[1] for p in pieces), default=0)
    ends = [
        [np.pad(q, ((0, 0), (0, most - q.shape[1]))) for q in path]
        for path in ([p.q_a for p in pieces], [p.q_b for p in pieces])
    ]
    box = _joined([s.box for s in sweeps], 6)
    tree = np.empty((2 * len(box), 6))
    _grow_trees(first, box, tree)
    tracks = Tracks(
        first,
        packed(
            Pieces(
                _joined([p.start for p in pieces]),
                _joined([p.end for p in pieces]),
                _joined(ends[0], most),
                _joined(ends[1], most),
                _joined([p.whole for p in pieces]).astype(np.bool_),
                _joined([p.moment for p in pieces]),
            )
        ),
        _joined(carrier).astype(np.int64),
        packed(
            Sweeps(
                box,
                _joined_firsts([s.body_first for s in sweeps]),
                _joined([s.body_box for s in sweeps], 6),
                _joined_firsts([s.capsule_first for s in sweeps]),
                _joined([s.capsule_a for s in sweeps], 3),
                _joined([s.capsule_b for s in sweeps], 3),
                _joined([s.radius for s in sweeps]),
            )
        ),
        tree,
    )
    return packed(tracks)


def _joined(arrays: Sequence[npt.NDArray[Any]], *columns: int) -> npt.NDArray[Any]:
    """Return arrays one after another, an empty one with so many columns where there are none."""
    return np.concatenate([np.empty((0, *columns)), *arrays])


def _joined_firsts(firsts: Sequence[Indices]) -> Indices:
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
