"""Swept bodies of movers against what lies still, compiled.

The movers have been swept by ``sweep_own``.
"""

from __future__ import annotations

from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.close_pairs import pairs_apart
from planning.construction.checks.obstacles import (
    AROUND,
    BOX_BOUNDS,
    BOX_FROM,
    BOX_HALF,
    BOX_LIMIT,
    BOX_NUMBER,
    BOX_POSE,
    BOX_UNTIL,
    CAPSULE_FIRST,
    NEAR,
    OWN_A,
    OWN_B,
    OWN_BOX,
    OWN_MOVED,
    OWN_RADIUS,
    PAIRS,
    SETTINGS,
    WIDEST,
    apart,
    still_hulls,
)
from planning.geometry.distance import segment_box

CLEAR, SPLIT, BLOCKED = 0, 1, 2
"""Answers: a shorter stretch must be looked at where it is SPLIT."""

RESOLUTION = 0.06
"""Stretches that move no capsule further than this go to the hulls [m]."""


@njit(cache=True, nogil=True)
def meet_boxes(scene: Arena, boxes: int, lo: float, hi: float) -> int:
    """Check the movers against the first boxes of NEAR that are there in a span.

    Returns:
        CLEAR, BLOCKED, or SPLIT where a shorter stretch must be looked at.
    """
    near, capsules = row(scene, NEAR), row(scene, CAPSULE_FIRST)
    around, own_box = column(scene, AROUND), table(scene, OWN_BOX)
    bounds, limits = table(scene, BOX_BOUNDS), table(scene, BOX_LIMIT)
    start, end = column(scene, BOX_FROM), column(scene, BOX_UNTIL)
    pose, half = table(scene, BOX_POSE), table(scene, BOX_HALF)
    a, b = table(scene, OWN_A), table(scene, OWN_B)
    radius, moved = column(scene, OWN_RADIUS), table(scene, OWN_MOVED)
    widest = column(scene, SETTINGS)[WIDEST]
    pairs, count = row(scene, PAIRS), boxes * 0
    for k in range(boxes):
        x = near[k]
        if (start[x] >= hi and hi > lo) or start[x] > hi or end[x] <= lo:
            continue
        if apart(around, bounds[x], widest):
            continue
        for o in range(len(own_box)):
            limit = limits[o, x]
            if limit < 0.0 or apart(own_box[o], bounds[x], limit):
                continue
            for c in range(capsules[o], capsules[o + 1]):
                reach = radius[c] + limit
                gap = segment_box(a[c], b[c], pose[4 * x : 4 * x + 4], half[x])
                if gap <= reach * reach:
                    if moved[c, 0] > RESOLUTION:
                        return SPLIT
                    pairs[count] = o * len(bounds) + x
                    count += 1
                    break
    if count == 0:
        return CLEAR
    columns = row(scene, BOX_NUMBER)
    if pairs_apart(scene, count, limits, still_hulls(scene), columns):
        return CLEAR
    return BLOCKED
