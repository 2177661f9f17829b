"""Time windows in which a robot can arrive at the start of a skill and finish it without collisions.

Time is divided into cells of ``STEP`` seconds. The swept volume of the skill is computed once. A time cell is blocked
if a moving obstacle overlaps that volume in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from planning.construction.checks.checker import SpaceTimeChecker, straight_runs
from planning.construction.checks.moving_checks import is_clear_of_pieces
from planning.construction.checks.scene import MoverScene, sweep_stretch
from planning.construction.checks.still_checks import is_clear_of_still_objects
from planning.construction.world.timeline import STEP
from planning.construction.world.tracks import pieces_at
from planning.geometry.distance import are_boxes_apart
from planning.kernels import ZERO, inner_kernel, kernel
from planning.transforms import Array

Part = tuple[SpaceTimeChecker, Array]
"""A piece of a skill: the checker for what is held in it, and the path, shape (w, n)."""


def arrival_windows(
    parts: Sequence[Part], duration: float, earliest: float, latest: float = np.inf
) -> Array:
    """Return the windows of arrival times after which a skill, or a stay, is free of collisions.

    For all of the skill's duration, all its parts must be free of collisions.

    Args:
        parts: of the skill, such as the way to a part with an empty hand and the retreat
            with it; for a stay, one path of one waypoint.
        duration: of the skill; infinity to stay for good [s].
        earliest, latest: first and last arrival time to consider [s].

    Returns:
        Spans in order, shape (w, 2); the last one may have no end.
    """
    first = int(np.floor(earliest / STEP + 1e-6))
    # Once nothing moves any more, all cells are alike.
    last = max(int(np.ceil(parts[0][0].world.end / STEP - 1e-6)), first) + 1
    if np.isfinite(latest) and np.isfinite(duration):
        last = max(min(last, int(np.ceil((latest + duration) / STEP))), first + 1)
    free = np.ones(max(last - first, 0), dtype=np.bool_)
    for part, path in parts:
        for a, b in straight_runs(path):
            mark_blocked_cells(part.scene, a, b, first, free)
    out = np.empty((len(free) // 2 + 1, 2))
    spans = out[: write_free_spans(free, first, STEP, out)]
    opens = np.maximum(spans[:, 0], earliest)
    ends = np.full(len(spans), np.inf)
    finite = np.isfinite(spans[:, 1])
    ends[finite] = spans[finite, 1] - duration
    ends = np.minimum(ends, latest)
    return np.asarray(np.column_stack([opens, ends])[ends >= opens])


@kernel
def mark_blocked_cells(
    scene: MoverScene,
    q0: Array,
    q1: Array,
    first: int,
    free: npt.NDArray[np.bool_],
) -> None:
    """Mark the time cells in which an obstacle meets the swept volume of a motion.

    Args:
        scene: the obstacles.
        q0, q1: ends of the motion, shape (n,); equal for a stay.
        first: number of the first time cell.
        free: shape (cells,); set to False where the motion is blocked.
    """
    cells, step = len(free), scene.step
    begin, finish = first * step, (first + cells) * step
    clear = is_clear_of_still_objects(scene, q0, begin, q1, finish, finish - begin)
    k = cells * int(clear)
    while k < cells:
        # All cells are alike until a static obstacle appears or is removed.
        same = _unchanged(scene, first + k, first + cells, step) - first
        lo, hi = (first + k) * step, (first + same) * step
        if not is_clear_of_still_objects(scene, q0, lo, q1, hi, hi - lo):
            free[k:same] = False
        k = same
    sweep_stretch(scene, q0, begin, q1, finish, begin, finish)
    around, widest, tracks = scene.own.sweeps.box, scene.widest, scene.tracks
    start, end = tracks.pieces.start, tracks.pieces.end
    box, firsts = tracks.sweeps.box, tracks.first
    for r in range(len(firsts) - 1):
        p, q = pieces_at(start, end, firsts[r], firsts[r + 1], begin, finish)
        for i in range(p, q):
            if are_boxes_apart(around, ZERO, box, i, widest):
                continue
            low = int(np.floor(max(start[i], begin) / step + 1e-6)) - first
            high = int(np.ceil(min(end[i], finish) / step - 1e-6)) - first
            struck = True
            for k in range(max(low, 0), min(high, cells)):
                struck = struck and not free[k]
            if struck or is_clear_of_pieces(scene, i, i + 1, start[i], end[i]):
                continue
            for k in range(max(low, 0), min(high, cells)):
                free[k] = False


@inner_kernel
def _unchanged(scene: MoverScene, cell: int, last: int, step: float) -> int:
    """Return the cell up to which the static obstacles stay the same, at most the last one."""
    lo, until = cell * step, last * step
    start, end = scene.boxes.start, scene.boxes.end
    for b in range(len(start)):
        for t in (start[b], end[b]):
            if lo < t < until:
                # The cell in which an obstacle appears or is removed is checked on its own.
                k = int(np.floor(t / step))
                k -= int(k * step > t)
                until = max(k, cell + 1) * step
    return int(np.round(until / step))


@kernel
def write_free_spans(
    free: npt.NDArray[np.bool_], first: int, step: float, out: Array
) -> int:
    """Write the time spans made up of free cells; return their number.

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
