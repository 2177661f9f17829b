"""Bodies of two blocks of swept sequences whose capsules come too close, compiled."""

from __future__ import annotations

from planning.geometry.distance import boxes_apart, segment_distance
from planning.kernels import inner_kernel
from planning.transforms import Indices
from scheduling.conflicts.swept_sequence import SweptSequence


@inner_kernel
def close_blocks(
    a: SweptSequence,
    i: int,
    b: SweptSequence,
    j: int,
    gap: float,
    every: bool,
    out: Indices,
) -> int:
    """Write the pairs of bodies of two blocks whose capsules come too close.

    Returns:
        Their number; with ``every`` unset, 1 as soon as there is one.
    """
    if boxes_apart(a.block_box, i, b.block_box, j, gap):
        return 0
    count = 0
    theirs, box = b.capsules[j], b.block_box[j]
    for x in range(len(a.column) - 1):
        begin = count
        for c in range(a.column[x], a.column[x + 1]):
            mine = a.capsules[i, c]
            r = float(mine[6]) + gap
            if mine[6] < 0.0:
                continue
            p0, p1, p2 = float(mine[0]), float(mine[1]), float(mine[2])
            q0, q1, q2 = float(mine[3]), float(mine[4]), float(mine[5])
            x0, x1, x2 = min(p0, q0) - r, min(p1, q1) - r, min(p2, q2) - r
            y0, y1, y2 = max(p0, q0) + r, max(p1, q1) + r, max(p2, q2) + r
            if x0 > box[3] or x1 > box[4] or x2 > box[5]:
                continue
            if y0 < box[0] or y1 < box[1] or y2 < box[2]:
                continue
            for y in range(len(b.column) - 1):
                seen = False
                for e in range(begin, count):
                    if out[e, 1] == y:
                        seen = True
                        break
                if seen:
                    continue
                for d in range(b.column[y], b.column[y + 1]):
                    s = float(theirs[d, 6])
                    if s < 0.0:
                        continue
                    u0, v0 = float(theirs[d, 0]), float(theirs[d, 3])
                    if min(u0, v0) - s > y0 or max(u0, v0) + s < x0:
                        continue
                    u1, v1 = float(theirs[d, 1]), float(theirs[d, 4])
                    if min(u1, v1) - s > y1 or max(u1, v1) + s < x1:
                        continue
                    u2, v2 = float(theirs[d, 2]), float(theirs[d, 5])
                    if min(u2, v2) - s > y2 or max(u2, v2) + s < x2:
                        continue
                    apart = segment_distance(
                        (q0 - p0, q1 - p1, q2 - p2),
                        (v0 - u0, v1 - u1, v2 - u2),
                        (p0 - u0, p1 - u1, p2 - u2),
                    )
                    if apart < (r + s) * (r + s):
                        out[count, 0], out[count, 1] = x, y
                        count += 1
                        if not every:
                            return count
                        break
    return count
