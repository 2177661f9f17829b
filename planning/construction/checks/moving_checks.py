"""Whether a motion is clear of robots that move, compiled; when it meets them, when they have left.

A motion is cut at the cells of time: in each cell the whole of its stretch must clear the whole
of what every other robot sweeps in the cell, and where that fails the cell is halved a few
times. So what is found free can become nodes of a temporal plan graph, see ``motion_pieces``.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.movers import own_at, sweep_between, sweep_own
from planning.construction.checks.obstacles import (
    AROUND,
    BEGIN,
    HALVINGS,
    NEAR,
    OWN_QA,
    OWN_QB,
    PIECE_BOX,
    PIECE_END,
    PIECE_START,
    SETTINGS,
    STACK,
    STEP,
    TRACK_FIRST,
    TREE,
    WIDEST,
    apart,
)
from planning.construction.checks.own_checks import movers_clear
from planning.construction.checks.piece_checks import clear_of_pieces
from planning.construction.world.tracks import near_stretch, pieces_at
from planning.transforms import Array, Indices

_PROBE = 0.4
"""Places on motions longer than this are looked at first [s, rad or m]."""


@njit(cache=True, nogil=True)
def moving_clear_until(
    scene: Arena, q0: Array, t0: float, q1: Array, t1: float
) -> tuple[bool, float]:
    """Tell whether a motion is clear of robots that move, and until when it is.

    Args:
        scene: the scene.
        q0, t0: where it begins, and when, shape (n,).
        q1, t1: where it ends, and when.
    """
    q_a, q_b = column(scene, OWN_QA), column(scene, OWN_QB)
    settings, around = column(scene, SETTINGS), column(scene, AROUND)
    start, end = column(scene, PIECE_START), column(scene, PIECE_END)
    tree, firsts = table(scene, TREE), row(scene, TRACK_FIRST)
    widest = settings[WIDEST]
    several = len(column(scene, BEGIN)) > 1
    own_at(scene, q0, t0, q1, t1, t0, q_a)
    own_at(scene, q0, t0, q1, t1, t1, q_b)
    sweep_own(scene, t0, t1)
    near = row(scene, NEAR)
    begin, finish = _cells(settings[STEP], t0, t1)
    tracks = len(firsts) * 0
    for r in range(len(firsts) - 1):
        p, q = _near_pieces(start, end, tree, firsts, r, begin, finish, around, widest)
        if p < q:
            near[tracks] = r
            tracks += 1
    if tracks == 0 and not several:
        return True, t1
    stack = table(scene, STACK)
    stack[0, 0], stack[0, 1], stack[0, 2] = t0, t1, 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        lo, hi = stack[depth, 0], stack[depth, 1]
        level = int(stack[depth, 2])
        if lo > t0 or hi < t1:
            own_at(scene, q0, t0, q1, t1, lo, q_a)
            own_at(scene, q0, t0, q1, t1, hi, q_b)
            sweep_own(scene, lo, hi)
        size = settings[STEP] / (1 << level)
        begin, finish = _cells(size, lo, hi)
        single = finish - begin < 1.5 * size
        clear = True
        for k in range(tracks):
            p, q = _near_pieces(
                start, end, tree, firsts, near[k], begin, finish, around, widest
            )
            if p < q and not (single and clear_of_pieces(scene, p, q, begin, finish)):
                clear = False
                break
        if clear and several:
            clear = movers_clear(scene, single)
        if clear:
            continue
        if single:
            if level >= settings[HALVINGS] or hi - lo < 1e-9:
                return False, lo
            level += 1
            middle = begin + 0.5 * size
            if middle <= lo + 1e-9 or middle >= hi - 1e-9:
                stack[depth, 2] = level
                depth += 1
                continue
        else:
            middle = begin + size * np.round(0.5 * (finish - begin) / size)
        if depth + 2 > len(stack):
            return False, lo
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = middle, hi, level
        stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
        stack[depth + 1, 2] = level
        depth += 2
    return True, t1


@njit(cache=True, nogil=True)
def _cells(size: float, lo: float, hi: float) -> tuple[float, float]:
    """Return the cells of time that a span lies in; an instant is left as it is."""
    if hi - lo < 1e-12:
        return lo, hi
    return np.floor(lo / size + 1e-6) * size, np.ceil(hi / size - 1e-6) * size


@njit(cache=True, nogil=True)
def _near_pieces(
    start: Array,
    end: Array,
    tree: Array,
    firsts: Indices,
    track: int,
    begin: float,
    finish: float,
    around: Array,
    widest: float,
) -> tuple[int, int]:
    """Return the pieces of a track in a span, none where all are out of the movers' reach."""
    first, last = firsts[track], firsts[track + 1]
    p, q = pieces_at(start, end, first, last, begin, finish)
    # The tree of a track has two nodes for each of its pieces.
    count, base = last - first, 2 * first
    if near_stretch(tree, base, count, p - first, q - first, around, widest):
        return p, q
    return p, p


@njit(cache=True, nogil=True)
def clear_of_tracks(scene: Arena, begin: float, finish: float) -> bool:
    """Check the swept movers against all pieces in a span."""
    start, end = column(scene, PIECE_START), column(scene, PIECE_END)
    tree, firsts = table(scene, TREE), row(scene, TRACK_FIRST)
    around, widest = column(scene, AROUND), column(scene, SETTINGS)[WIDEST]
    for r in range(len(firsts) - 1):
        p, q = _near_pieces(start, end, tree, firsts, r, begin, finish, around, widest)
        if p < q and not clear_of_pieces(scene, p, q, begin, finish):
            return False
    return True


@njit(cache=True, nogil=True)
def met_by_robots(scene: Arena, q0: Array, t0: float, q1: Array, t1: float) -> float:
    """Return when a motion of one mover is in the way of other robots, infinity for never [s].

    Some places on it are looked at first, so it need not be the first such time.
    """
    q = np.empty_like(q0)
    if worth_probing(q0, t0, q1, t1):
        for share in (0.5, 0.25, 0.75):
            t = t0 + share * (t1 - t0)
            own_at(scene, q0, t0, q1, t1, t, q)
            if not _clear_at(scene, q, t):
                return t
    clear, until = moving_clear_until(scene, q0, t0, q1, t1)
    return np.inf if clear else until


@njit(cache=True, nogil=True)
def left_by_robots(scene: Arena, q: Array, t: float, latest: float) -> float:
    """Return from when on other robots leave room for the only mover to be at a place [s].

    Args:
        scene: the scene.
        q: the place, shape (n,).
        t: no earlier time is looked at [s].
        latest: nor a later one: some time after it may be returned though it is not free [s].
    """
    sweep_between(scene, q, q, t, t)
    start, end = column(scene, PIECE_START), column(scene, PIECE_END)
    box, firsts = table(scene, PIECE_BOX), row(scene, TRACK_FIRST)
    around, widest = column(scene, AROUND), column(scene, SETTINGS)[WIDEST]
    waited = True
    while waited and t < latest:
        waited = False
        for r in range(len(firsts) - 1):
            last = firsts[r + 1]
            p, _ = pieces_at(start, end, firsts[r], last, t, t)
            while p < last and start[p] <= t + 1e-9 and t < latest:
                if apart(around, box[p], widest):
                    break
                if clear_of_pieces(scene, p, p + 1, start[p], end[p]):
                    break
                t, waited = end[p], True
                p += 1
    return t


@njit(cache=True, nogil=True)
def worth_probing(q0: Array, t0: float, q1: Array, t1: float) -> bool:
    """Tell whether a motion is so long that places on it are looked at before all of it."""
    widest = t1 - t0
    for j in range(len(q0)):
        widest = max(widest, abs(q1[j] - q0[j]))
    return bool(widest > _PROBE)


@njit(cache=True, nogil=True)
def _clear_at(scene: Arena, q: Array, t: float) -> bool:
    """Tell whether the only mover may be at ``q``, shape (n,), at one instant, among robots."""
    sweep_between(scene, q, q, t, t)
    return clear_of_tracks(scene, t, t)
