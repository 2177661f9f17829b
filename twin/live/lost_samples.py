"""Reconstruction of robot positions for which measured samples are lost, for instance because a driver was killed.

The robot is assumed to have followed the path that the dispatcher had cleared. The waypoints of this path are inserted
between the samples before and after the gap, since a straight line between these samples could pass through obstacles.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.motion.near_path import nearest_points_on_path
from planning.transforms import Array
from twin.drivers.driver import ClearedNode, Sample
from twin.durations.nanoseconds import NANOSECONDS

_GAP_NS = 100_000_000
"""Longer intervals between two samples are gaps with lost samples [ns]."""

_LATER_S = 1e-6
"""How much later than the one before each of them was measured, by the clock of the driver [s]."""


def samples_between(
    before: tuple[int, Sample],
    after: tuple[int, Sample],
    nodes: Sequence[ClearedNode],
    cleared_ns: Sequence[int],
    start: Array,
) -> list[tuple[int, Sample]]:
    """Return the corners of a robot's path between two samples, passed as fast as planned.

    Args:
        before, after: both samples with their times in the run [ns].
        nodes: all that it was cleared for, from its first one on.
        cleared_ns: when it was cleared for each [ns]; it passes no corner of a node before.
        start: where the first one begins, shape (n,).

    Returns:
        Times in the run [ns] and samples, in order; none where nothing need have been lost.
    """
    (begin_ns, first), (end_ns, last) = before, after
    near = end_ns - begin_ns <= _GAP_NS or last.done > len(nodes)
    if near or last.done < first.done or np.array_equal(first.q, last.q):
        return []
    found: list[tuple[int, Sample]] = []
    t_ns = begin_ns

    def pass_by(q: Array, begun: int, done: int) -> None:
        at_s = first.at_s + (len(found) + 1) * _LATER_S
        found.append((min(t_ns, end_ns), Sample(at_s, q, begun, done)))

    gone, until = _passed(nodes, first, start), _passed(nodes, last, start)
    q = first.q
    for k in range(first.done, min(last.begun, len(nodes))):
        own, whole = nodes[k], k < last.done
        t_ns = max(t_ns, cleared_ns[k])
        if k >= first.begun:
            pass_by(q, k + 1, k)
        for corner, second in zip(own.waypoints, own.seconds, strict=True):
            ends = whole and second == own.seconds[-1]
            if k == first.done and second <= gone and not ends:
                continue
            if not whole and second >= until:
                break
            t_ns += round(max(second - gone, 0.0) * NANOSECONDS)
            gone, q = float(second), corner
            pass_by(q, k + 1, k + bool(ends))
        gone = 0.0
    return found


def _passed(nodes: Sequence[ClearedNode], sample: Sample, start: Array) -> float:
    """Return the planned time into the current node at the robot's position [s]."""
    k = sample.done
    if sample.begun == k:
        return 0.0
    before = nodes[k - 1].waypoints[-1] if k else start
    near = nearest_points_on_path(
        np.vstack([before, nodes[k].waypoints]), sample.q[None]
    )
    return nodes[k].passed_s(int(near.leg[0]), float(near.share[0]))
