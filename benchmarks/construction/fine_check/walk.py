"""Walks along a span of time and measures the bodies that come near each other.

Spheres around bodies, and boxes at rest, tell at every sample who may be near. Of a pair that
may be, the distance is measured; it need not be measured again before both have moved as far
as they were apart.

The motion of a robot as the fine check sees it: sampled poses, and how far anything gets.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from planning.construction.world.timeline import RobotTimeline
from planning.transforms import Array, Transform
from scheduling.witness.parts import TOLERANCE, ConvexPart, measure
from scheduling.witness.robot import WitnessRobot

SAMPLE = 0.005
"""No point of a robot, or of what it carries, moves further between two samples [m]."""


class Motion:
    """A robot on its timeline.

    Args:
        robot: its geometry.
        line: its timeline.

    Attributes:
        robot: its geometry.
        end: from then on it stands [s].
    """

    def __init__(self, robot: WitnessRobot, line: RobotTimeline) -> None:
        self.robot = robot
        self._time, self._path = np.array(line.time), np.array(line.path)
        self.end = float(self._time[-1])

    def at(self, times: Array) -> Array:
        """Return the configurations at some times, shape (s, n)."""
        columns = [np.interp(times, self._time, column) for column in self._path.T]
        return np.stack(columns, axis=1)

    def frames(self, times: Array) -> Array:
        """Return the world poses of base and joints, shape (s, n + 1, 4, 4)."""
        return self.robot.joint_frames_along(self.at(times))

    def flange(self, t: float) -> Transform:
        """Return the world pose of the flange at a time."""
        return self.robot.flange_pose(self.at(np.array([t]))[0])

    def samples(self, parts: Sequence[ConvexPart], start: float, end: float) -> Array:
        """Return times from ``start`` to ``end`` between which no part gets far, shape (s,).

        Args:
            parts: of the robot, and what it carries.
            start, end: the span, both are samples [s].
        """
        inside = (self._time > start) & (self._time < end)
        times = np.concatenate([[start], self._time[inside], [end]])
        far = np.max(np.diff(self.travelled(parts, times), axis=1), axis=0, initial=0.0)
        count = np.maximum(np.ceil(far / SAMPLE - 1e-9), 1).astype(np.int64)
        pieces = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(times[:-1], times[1:], count.tolist(), strict=True)
        ]
        return np.unique(np.concatenate([*pieces, [end]]))

    def travelled(
        self, parts: Sequence[ConvexPart], times: Array, above: int = -1
    ) -> Array:
        """Return bounds of the way of any point of parts up to some times, shape (p, s) [m].

        Args:
            parts: of the robot, and what it carries.
            times: rising, shape (s,) [s].
            above: motion is seen from what this joint moves; -1 for the world.
        """
        weights = np.array([part.weight for part in parts])
        weights[:, : above + 1] = 0.0
        steps = np.abs(np.diff(self._path, axis=0))
        ways = np.zeros((len(parts), len(self._time)))
        np.cumsum(weights @ steps.T, axis=1, out=ways[:, 1:])
        return np.array([np.interp(times, self._time, way) for way in ways])


def moved_corners(before: Transform, after: Transform, size: Array) -> float:
    """Return how far the corner of a box that moves most is away [m]."""
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]))
    corners = signs.reshape(3, -1).T * np.asarray(size)
    gap = corners @ (before - after)[:3, :3].T + (before - after)[:3, 3]
    return float(np.max(np.linalg.norm(gap, axis=1)))


_NEAR = 0.05
"""Pairs whose bounds are nearer than this are measured [m]."""

_BLOCK = 64
"""Samples that are looked at together."""

Limit = Callable[[ConvexPart, ConvexPart], float]
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
    parts: tuple[ConvexPart, ...]
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
        self,
        t: float,
        pair: tuple[ConvexPart, ConvexPart],
        gap: float,
        least: float,
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
