"""Walks along a span of time and measures the bodies that come near each other.

Spheres around bodies, and boxes at rest, tell at every sample who may be near. Of a pair that
may be, the distance is measured; it need not be measured again before both have moved as far
as they were apart.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.construction.fine_check.motion import Motion
from planning.transforms import Array
from scheduling.verification.reference import TOLERANCE, Part, measure

_NEAR = 0.05
"""Pairs whose bounds are nearer than this are measured [m]."""

_BLOCK = 64
"""Samples that are looked at together."""

Limit = Callable[[Part, Part], float]
"""Least distance of two bodies [m]; minus infinity for a pair that is not looked at."""


@dataclass(frozen=True)
class Group:
    """Bodies that are looked at together.

    Attributes:
        motion: of the robot that moves them, None where they rest.
        parts: the bodies: those of a robot and its load, or boxes at rest.
        halves: half edge lengths of boxes at rest, shape (p, 3) [m].
    """

    motion: Motion | None
    parts: tuple[Part, ...]
    halves: Array | None = None

    def frames(self, times: Array) -> Array:
        """Return the world frame of each body at each time, shape (s, p, 4, 4)."""
        if self.motion is None:
            return np.broadcast_to(np.eye(4), (len(times), len(self.parts), 4, 4))
        carriers = [part.joint + 1 for part in self.parts]
        return self.motion.frames(times)[:, carriers]

    def travelled(self, times: Array, above: int) -> Array:
        """Return bounds of the way of each body, shape (p, s) [m]."""
        if self.motion is None:
            return np.zeros((len(self.parts), len(times)))
        return self.motion.travelled(self.parts, times, above)


class Measurer:
    """Measures groups of bodies, and keeps what it finds.

    Attributes:
        found: what is too close, and when; each pair once a walk.
        measured: how many distances were measured.
        least: least distance measured, by whether it is one of two robots [m].
    """

    def __init__(self) -> None:
        self.found: list[tuple[float, str]] = []
        self.measured = 0
        self.least = {True: math.inf, False: math.inf}

    def walk(self, a: Group, b: Group, times: Sequence[float], limit: Limit) -> None:
        """Measure what is near, at every sample at which it may have come too close.

        Args:
            a, b: what is looked at; the same group for a robot by itself.
            times: samples, rising [s].
            limit: least distances.
        """
        least = np.array([[limit(p, q) for q in b.parts] for p in a.parts])
        if a is b:
            least[np.tril_indices(len(least))] = -math.inf
        above = min(part.joint for part in a.parts) if a is b else -1
        at = np.asarray(times)
        way_a, way_b = a.travelled(at, above), b.travelled(at, above)
        for block in _near_blocks(a, b, at, (way_a, way_b), _NEAR + least):
            frames = a.frames(at[block]), b.frames(at[block])
            near = _bounds(a, frames[0], b, frames[1]) < _NEAR + least
            for i, j in np.argwhere(np.any(near, axis=0)).tolist():
                samples = np.flatnonzero(near[:, i, j])
                way = (way_a[i, block] + way_b[j, block])[samples]
                k = 0
                while k < len(samples):
                    s = int(samples[k])
                    pair = a.parts[i], b.parts[j]
                    gap = measure(pair[0], frames[0][s, i], pair[1], frames[1][s, j])
                    if self._too_close(times[block.start + s], pair, gap, least[i, j]):
                        least[i, j] = -math.inf  # once said is enough
                        break
                    room = max(gap - least[i, j], 0.0)
                    k = max(k + 1, int(np.searchsorted(way, way[k] + room)))

    def _too_close(
        self, t: float, pair: tuple[Part, Part], gap: float, least: float
    ) -> bool:
        self.measured += 1
        first, second = (part.entity for part in pair)
        if least >= 0.0:  # contacts that are allowed do not count
            robots = {x.partition("/")[0] for x in (first, second) if "/" in x}
            between = len(robots) == 2
            self.least[between] = min(self.least[between], gap)
        if gap >= least - TOLERANCE:
            return False
        much = f"{gap * 1e3:.1f} mm" if gap > 0 else f"overlap by {-gap * 1e3:.1f} mm"
        self.found.append((t, f"{first} and {second}: {much}"))
        return True


def _near_blocks(
    a: Group, b: Group, at: Array, ways: tuple[Array, Array], near: Array
) -> list[slice]:
    """Return the blocks of samples in which some pair may be near: its middle and the ways tell."""
    first = np.arange(0, len(at), _BLOCK)
    last = np.minimum(first + _BLOCK, len(at)) - 1
    middle = (first + last) // 2
    gap = _bounds(a, a.frames(at[middle]), b, b.frames(at[middle]))
    strays = [
        np.maximum(way[:, last] - way[:, middle], way[:, middle] - way[:, first]).T
        for way in ways
    ]
    gap -= strays[0][:, :, None] + strays[1][:, None, :]
    found = np.flatnonzero(np.any(gap < near, axis=(1, 2)))
    return [slice(int(first[k]), int(last[k]) + 1) for k in found]


def _bounds(a: Group, frames_a: Array, b: Group, frames_b: Array) -> Array:
    """Return lower bounds of the distances of all pairs, shape (s, parts of a, parts of b) [m]."""
    centre = _centres(a, frames_a)
    radius = np.array([part.radius for part in a.parts])[:, None]
    if b.halves is None:
        offset = centre[:, :, None] - _centres(b, frames_b)[:, None]
        others = np.array([part.radius for part in b.parts])
        return np.asarray(np.linalg.norm(offset, axis=3) - radius - others)
    pose = np.array([part.local for part in b.parts])
    turn = pose[:, :3, :3]
    origin = (pose[:, None, :3, 3] @ turn)[:, 0]
    # In the frame of each box; one product of matrices is the quickest way to say it.
    local = centre @ turn.transpose(1, 0, 2).reshape(3, -1)
    outside = np.abs(local.reshape(*centre.shape[:2], -1, 3) - origin)
    outside = np.maximum(outside - b.halves, 0.0)
    return np.asarray(np.linalg.norm(outside, axis=3) - radius)


def _centres(group: Group, frames: Array) -> Array:
    """Return the centres of spheres around bodies in the world, shape (s, p, 3) [m]."""
    local = np.array([part.centre for part in group.parts])
    turned = frames[..., :3, :3] @ local[:, :, None]
    return np.asarray(turned[..., 0] + frames[..., :3, 3])
