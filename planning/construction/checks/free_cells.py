"""In which cells of time a motion, or a stand, is clear of everything, compiled.

The motion is swept once; what comes near it strikes out the cells for which it is there.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.motion_checks import clear_throughout
from planning.construction.checks.movers import sweep_between
from planning.construction.checks.obstacles import (
    AROUND,
    BEGIN,
    BOX_FROM,
    BOX_UNTIL,
    PIECE_BOX,
    PIECE_END,
    PIECE_START,
    SETTINGS,
    TRACK_FIRST,
    WIDEST,
    apart,
)
from planning.construction.checks.piece_checks import clear_of_pieces
from planning.construction.checks.still_checks import still_clear_until
from planning.construction.world.tracks import pieces_at
from planning.transforms import Array


@njit(cache=True, nogil=True)
def strike_out(
    scene: Arena,
    q0: Array,
    q1: Array,
    first: int,
    step: float,
    free: npt.NDArray[np.bool_],
) -> None:
    """Mark the cells of time in which a motion is not clear, wherever it is in the cell.

    Args:
        scene: what must be kept clear of.
        q0, q1: ends of the motion, shape (n,); equal for a stand.
        first: number of the first cell: it begins at ``first * step``.
        step: length of the cells [s].
        free: shape (cells,); False is written where the motion is not clear.
    """
    cells = len(free)
    begin, finish = first * step, (first + cells) * step
    if len(column(scene, BEGIN)) > 1:
        # Movers are there from different times on.
        for k in range(cells):
            lo = (first + k) * step
            free[k] = free[k] and clear_throughout(scene, q0, q1, lo, lo + step)
        return
    clear, _ = still_clear_until(scene, q0, begin, q1, finish, finish - begin)
    k = cells * int(clear)
    while k < cells:
        # Until something comes to lie there or is taken away, one cell is like another.
        same = _unchanged(scene, first + k, first + cells, step) - first
        lo, hi = (first + k) * step, (first + same) * step
        clear, _ = still_clear_until(scene, q0, lo, q1, hi, hi - lo)
        if not clear:
            free[k:same] = False
        k = same
    sweep_between(scene, q0, q1, begin, finish)
    around, widest = column(scene, AROUND), column(scene, SETTINGS)[WIDEST]
    start, end = column(scene, PIECE_START), column(scene, PIECE_END)
    box, firsts = table(scene, PIECE_BOX), row(scene, TRACK_FIRST)
    for r in range(len(firsts) - 1):
        p, q = pieces_at(start, end, firsts[r], firsts[r + 1], begin, finish)
        for i in range(p, q):
            if apart(around, box[i], widest):
                continue
            low = int(np.floor(max(start[i], begin) / step + 1e-6)) - first
            high = int(np.ceil(min(end[i], finish) / step - 1e-6)) - first
            struck = True
            for k in range(max(low, 0), min(high, cells)):
                struck = struck and not free[k]
            if struck or clear_of_pieces(scene, i, i + 1, start[i], end[i]):
                continue
            for k in range(max(low, 0), min(high, cells)):
                free[k] = False


@njit(cache=True, nogil=True)
def _unchanged(scene: Arena, cell: int, last: int, step: float) -> int:
    """Return the cell before which the same lies still all along, no later than the last one."""
    lo, until = cell * step, last * step
    start, end = column(scene, BOX_FROM), column(scene, BOX_UNTIL)
    for b in range(len(start)):
        for t in (start[b], end[b]):
            if lo < t < until:
                # A cell in which that happens is one of its own.
                k = int(np.floor(t / step))
                k -= int(k * step > t)
                until = max(k, cell + 1) * step
    return int(np.round(until / step))


@njit(cache=True, nogil=True)
def spans_of(free: npt.NDArray[np.bool_], first: int, step: float, out: Array) -> int:
    """Write the spans of time that free cells make up; return how many there are.

    Args:
        free: shape (cells,).
        first: number of the first cell.
        step: length of the cells [s].
        out: shape (most, 2); the last span has no end where the last cell is free [s].
    """
    cells = len(free)
    count = cells * 0
    k = cells * 0
    while k < cells and count < len(out):
        if free[k]:
            a = k
            while k < cells and free[k]:
                k += 1
            out[count, 0] = (first + a) * step
            out[count, 1] = (first + k) * step if k < cells else np.inf
            count += 1
        else:
            k += 1
    return count
