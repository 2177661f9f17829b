"""Shortcutting of paths (APEX-MR IV-B)."""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol

import numpy as np

from planning.motion.speed import SpeedModel, path_duration, path_times
from planning.transforms import Array

_GAIN = 1e-6
"""Shortcuts that gain less are not worth a corner [s]."""


class MotionChecker(Protocol):
    """Collision checks of a configuration and of a straight motion."""

    def configuration_free(self, q: Array) -> bool:
        """Tell whether the robot may stand at ``q``."""
        ...

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the straight line from ``q_a`` to ``q_b`` is free."""
        ...

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether ``q_b`` and some configurations on the way there are free."""
        ...


def smooth_path(
    checker: MotionChecker,
    path: Array,
    speed: SpeedModel,
    rng: np.random.Generator,
    tries: int,
) -> Array:
    """Return a path of the same ends that is no slower.

    Args:
        checker: the scene.
        path: free polyline, shape (w, n).
        speed: what decides which path is faster.
        rng: source of the random shortcuts.
        tries: number of random shortcuts; two of three move one joint only, which under the
            L1 speed model gains where a whole shortcut is blocked.
    """
    path = _drop_corners(checker, path, speed)
    marks = path_times(path, speed)
    for attempt in range(tries):
        if len(path) < 3:
            break
        lo, hi = np.sort(rng.uniform(0.0, marks[-1], 2))
        i, j = int(np.searchsorted(marks, lo)), int(np.searchsorted(marks, hi))
        if i == j or hi - lo < 1e-3:
            continue
        entry, leave = _point(path, marks, lo), _point(path, marks, hi)
        if attempt % 3 == 0:
            bridge = np.array([entry, leave])
        else:
            joint = int(rng.integers(path.shape[1]))
            bridge = np.vstack([entry, path[i:j], leave])
            share = np.concatenate([[lo], marks[i:j], [hi]])
            share = (share - lo) / (hi - lo)
            bridge[:, joint] = entry[joint] + share * (leave[joint] - entry[joint])
        if path_duration(bridge, speed) < hi - lo - _GAIN and _is_free(checker, bridge):
            path = np.vstack([path[:i], bridge, path[j:]])
            moves = np.any(np.abs(np.diff(path, axis=0)) > 1e-9, axis=1)
            moves[-1] = True
            path = path[np.append(True, moves)]
            marks = path_times(path, speed)
    return _drop_corners(checker, path, speed)


def _is_free(checker: MotionChecker, path: Array) -> bool:
    """Tell whether a polyline is free; proofs are left until nothing seems to be in the way."""
    return all(checker.seems_free(a, b) for a, b in pairwise(path)) and all(
        checker.motion_free(a, b) for a, b in pairwise(path)
    )


def _point(path: Array, marks: Array, at: float) -> Array:
    k = min(int(np.searchsorted(marks, at, side="right")) - 1, len(path) - 2)
    span = marks[k + 1] - marks[k]
    share = 0.0 if span <= 0 else (at - marks[k]) / span
    return np.asarray(path[k] + share * (path[k + 1] - path[k]))


def _drop_corners(checker: MotionChecker, path: Array, speed: SpeedModel) -> Array:
    """Leave out corners, longest shortcuts first, where that is free and no slower."""
    kept = [path[0]]
    i = 0
    while i < len(path) - 1:
        j = len(path) - 1
        while j > i + 1:
            direct = speed.duration(path[i], path[j])
            along = path_duration(path[i : j + 1], speed)
            if direct <= along + _GAIN and checker.motion_free(path[i], path[j]):
                break
            j -= 1
        kept.append(path[j])
        i = j
    return np.array(kept)
