"""Whether a motion is clear of all that lies still, and of itself, compiled.

It is halved until capsules swept over the stretch are clear or hulls decide.
"""

from __future__ import annotations

from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.box_checks import BLOCKED, CLEAR, meet_boxes
from planning.construction.checks.movers import own_at, sweep_own
from planning.construction.checks.obstacles import (
    AROUND,
    BOX_BOUNDS,
    BOX_FROM,
    BOX_UNTIL,
    NEAR,
    OWN_QA,
    OWN_QB,
    SETTINGS,
    STACK,
    WIDEST,
    apart,
)
from planning.construction.checks.own_checks import meet_self
from planning.transforms import Array


@njit(cache=True, nogil=True)
def still_clear_until(
    scene: Arena, q0: Array, t0: float, q1: Array, t1: float, leeway: float
) -> tuple[bool, float]:
    """Tell whether a motion is clear of all that lies still and of itself, and until when it is.

    Args:
        scene: the scene.
        q0, t0: where it begins, and when, shape (n,).
        q1, t1: where it ends, and when.
        leeway: what lies there so long before or after a bit of it counts, too [s].
    """
    q_a, q_b = column(scene, OWN_QA), column(scene, OWN_QB)
    own_at(scene, q0, t0, q1, t1, t0, q_a)
    own_at(scene, q0, t0, q1, t1, t1, q_b)
    sweep_own(scene, t0, t1)
    around, bounds = column(scene, AROUND), table(scene, BOX_BOUNDS)
    start, end = column(scene, BOX_FROM), column(scene, BOX_UNTIL)
    widest, near = column(scene, SETTINGS)[WIDEST], row(scene, NEAR)
    # Counted from a variable: numba compiles a function anew for every constant it is given.
    boxes = len(bounds) * 0
    for b in range(len(bounds)):
        if (start[b] >= t1 and t1 > t0) or start[b] > t1 or end[b] <= t0:
            continue
        if not apart(around, bounds[b], widest):
            near[boxes] = b
            boxes += 1
    stack = table(scene, STACK)
    stack[0, 0], stack[0, 1] = t0, t1
    depth = 1
    while depth > 0:
        depth -= 1
        lo, hi = stack[depth, 0], stack[depth, 1]
        if lo > t0 or hi < t1:
            own_at(scene, q0, t0, q1, t1, lo, q_a)
            own_at(scene, q0, t0, q1, t1, hi, q_b)
            sweep_own(scene, lo, hi)
        found = meet_boxes(scene, boxes, max(lo - leeway, t0), min(hi + leeway, t1))
        if found == CLEAR:
            found = meet_self(scene)
        if found == CLEAR:
            continue
        if found == BLOCKED or depth + 2 > len(stack) or hi - lo < 1e-9:
            return False, lo
        middle = 0.5 * (lo + hi)
        stack[depth, 0], stack[depth, 1] = middle, hi
        stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
        depth += 2
    return True, t1


@njit(cache=True, nogil=True)
def lies_throughout(scene: Arena, t0: float, t1: float) -> bool:
    """Tell whether all near the stretch that was last swept lies there throughout a span.

    After ``still_clear_until`` has found a motion blocked that is where it is.

    Args:
        scene: the scene.
        t0, t1: the span [s].
    """
    around, bounds = column(scene, AROUND), table(scene, BOX_BOUNDS)
    start, end = column(scene, BOX_FROM), column(scene, BOX_UNTIL)
    widest = column(scene, SETTINGS)[WIDEST]
    for b in range(len(bounds)):
        changes = t0 < start[b] <= t1 or t0 < end[b] <= t1
        if changes and not apart(around, bounds[b], widest):
            return False
    return True
