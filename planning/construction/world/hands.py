"""Time spans in which robots hold objects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planning.construction.world.timeline import ObjectTimeline
from planning.transforms import Transform

Hand = tuple[tuple[str, bytes], ...]
"""Objects held by a robot: names, and poses in the flange frame as bytes."""

HandChange = tuple[float, Hand]
"""From when on a robot holds what [s]."""


def hand_changes(objects: Mapping[str, ObjectTimeline], robot: str) -> list[HandChange]:
    """Return the objects that a robot holds from each time on, the first from minus infinity."""
    spans: list[tuple[float, float, str, bytes]] = []
    for name, line in objects.items():
        for k, change in enumerate(line.changes):
            if change.holder == robot:
                last = k + 1 == len(line.changes)
                end = np.inf if last else line.changes[k + 1].time
                spans.append((change.time, end, name, change.pose.tobytes()))
    times = sorted({t for a, b, _, _ in spans for t in (a, b) if np.isfinite(t)})
    out: list[HandChange] = []
    for t in [-np.inf, *times]:
        hand = tuple((name, pose) for a, b, name, pose in spans if a <= t < b)
        if not out or out[-1][1] != hand:
            out.append((t, hand))
    return out


def pose_of(hand: bytes) -> Transform:
    """Return a pose from its bytes."""
    return np.frombuffer(hand, dtype=np.float64).reshape(4, 4)
