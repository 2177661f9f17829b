"""Which pairs of a robot's own parts need no self-collision check."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from planning.geometry.chain import joint_poses
from planning.robots.model import KinematicChain, LinkPart
from planning.transforms import Array, identity

_SAMPLES = 600
_FAR = 0.05


def never_colliding_pairs(
    chain: KinematicChain,
    parts: tuple[LinkPart, ...],
    lower: Array,
    upper: Array,
    home: Array,
) -> frozenset[tuple[int, int]]:
    """Return pairs of part indices (low, high) that self-collision checks leave out.

    Left out are

    - parts of one joint and of neighbouring joints: they touch by design;
    - pairs that overlap at HOME: HOME is collision-free, so hulls that overlap there stand for
      shapes that do not;
    - pairs that were more than 5 cm apart in every one of 600 random configurations. This is a
      sample and no proof; the margin is what covers the configurations in between.

    Args:
        chain: the kinematics.
        parts: all parts of the robot.
        lower, upper: joint limits, shape (n,).
        home: HOME configuration, shape (n,).
    """
    out = set()
    open_pairs = []
    for pair in combinations(range(len(parts)), 2):
        if abs(parts[pair[0]].joint - parts[pair[1]].joint) <= 1:
            out.add(pair)
        else:
            open_pairs.append(pair)
    distances = _PairDistances(chain, parts)
    at_home = distances(home, open_pairs)
    out |= {pair for pair, d in zip(open_pairs, at_home, strict=True) if d <= 0.0}
    left = [pair for pair in open_pairs if pair not in out]
    rng = np.random.default_rng(20)
    for _ in range(_SAMPLES):
        if not left:
            break
        q = rng.uniform(lower, upper)
        found = distances(q, left)
        left = [pair for pair, d in zip(left, found, strict=True) if d > _FAR]
    return frozenset(out | set(left))


class _PairDistances:
    """Distances of pairs of hulls at a configuration, by coal."""

    def __init__(self, chain: KinematicChain, parts: tuple[LinkPart, ...]) -> None:
        import coal

        self._coal: Any = coal
        self._chain = chain
        self._joints = [part.joint for part in parts]
        self._hulls: list[Any] = []
        for part in parts:
            points = coal.StdVec_Vec3s()
            for vertex in part.body.vertices:
                points.append(np.array(vertex))
            self._hulls.append(coal.Convex.convexHull(points, False, ""))
        self._poses = np.empty((len(chain.axis) + 1, 4, 4))

    def __call__(self, q: Array, pairs: list[tuple[int, int]]) -> list[float]:
        chain = self._chain
        joint_poses(
            chain.placement,
            chain.axis,
            chain.prismatic,
            identity(),
            np.ascontiguousarray(q, dtype=np.float64),
            self._poses,
        )
        coal = self._coal
        placed = [
            coal.Transform3s(np.array(pose[:3, :3]), np.array(pose[:3, 3]))
            for pose in self._poses
        ]
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        out = []
        for a, b in pairs:
            result.clear()
            pose_a = placed[self._joints[a] + 1]
            pose_b = placed[self._joints[b] + 1]
            hulls = self._hulls
            out.append(
                coal.distance(hulls[a], pose_a, hulls[b], pose_b, request, result)
            )
        return out
