"""Pairs of a robot's links that need no self-collision check."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from planning.caches import Arrays, load_or_compute
from planning.cell.robot_model import KinematicChain, LinkPart
from planning.geometry import exact
from planning.geometry.exact import Solid, hull_distance_at
from planning.kernels import kernel
from planning.kinematics import chain as kinematic_chain
from planning.kinematics.chain import JointTable, chain_table, pose_joints
from planning.transforms import Array, Indices

_SAMPLES = 60
"""Number of random configurations that are tested before a proof is tried."""

_BUDGET = 500
"""Largest number of boxes of joint values in the proof for one pair of links."""

_ROUNDING = 1e-5
"""Margin of decisions by balls: greater than the tolerance of measured distances of hulls [m]."""

_UNDECIDED, _APART, _TOUCHING = range(3)

_SOURCES = (__file__, exact.__file__, kinematic_chain.__file__)


def never_colliding_pairs(
    chain: KinematicChain,
    parts: tuple[LinkPart, ...],
    lower: Array,
    upper: Array,
    home: Array,
) -> frozenset[tuple[int, int]]:
    """Return pairs of part indices (low, high) that self-collision checks skip.

    Left out are

    - parts of one joint and of neighbouring joints: they touch by design;
    - pairs that overlap at HOME: HOME is collision-free, so hulls that overlap there stand for
      shapes that do not;
    - pairs that are proved never to touch: the joints between them are bisected until, in each
      box of joint values, the distance at its centre exceeds what the joints can close within
      the box. A pair that needs more than 500 boxes is left in; that costs time, not safety.

    They are remembered from run to run.

    Args:
        chain: the kinematics.
        parts: all parts of the robot.
        lower, upper: joint limits, shape (n,).
        home: HOME configuration, shape (n,).
    """
    arrays: list[npt.NDArray[Any]] = [
        *(p.body.vertices for p in parts),
        *(lower, upper, home),
    ]
    arrays += [chain.placement, chain.axis, chain.prismatic]
    numbers = repr(([p.joint for p in parts], [a.shape for a in arrays])).encode()
    question = [numbers, *(np.ascontiguousarray(a).tobytes() for a in arrays)]

    def find() -> Arrays:
        pairs = _Pairs(chain, parts, lower, upper, home).apart()
        return {"pairs": np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)}

    names = frozenset({"pairs"})
    known = load_or_compute("apart", b"".join(question), names, find, _SOURCES)
    return frozenset((int(a), int(b)) for a, b in known["pairs"])


class _Pairs:
    """Pairs of parts of a robot; arguments as of ``never_colliding_pairs``."""

    def __init__(
        self,
        chain: KinematicChain,
        parts: tuple[LinkPart, ...],
        lower: Array,
        upper: Array,
        home: Array,
    ) -> None:
        self._chain, self._parts = chain, parts
        self._lower, self._upper = lower, upper
        self._home = np.array(home, dtype=np.float64)
        self._joints = chain_table(chain, lower, upper)
        self._hulls = [
            Solid("", p.body, np.eye(4), self._joints, p.joint) for p in parts
        ]
        self._carried_by = np.array([p.joint for p in parts], dtype=np.int64)
        balls = [_balls(p.body.vertices) for p in parts]
        self._balls = np.array(balls, dtype=np.float64).reshape(-1, 5)
        self._speeds = [self._speed_bounds(p) for p in parts]

    def apart(self) -> set[tuple[int, int]]:
        """Return the pairs to skip."""
        pairs = np.column_stack(np.triu_indices(len(self._parts), 1))
        skipped = np.abs(np.diff(self._carried_by[pairs])[:, 0]) <= 1
        skipped[~skipped] = self._touching(pairs[~skipped], self._home)
        left = pairs[~skipped]
        rng = np.random.default_rng(20)
        for _ in range(_SAMPLES):  # most pairs that can touch are dropped here, cheaply
            q = rng.uniform(self._lower, self._upper)
            left = left[~self._touching(left, q)]
        out = {(int(a), int(b)) for a, b in pairs[skipped]}
        return out.union((a, b) for a, b in left.tolist() if self._proved_apart((a, b)))

    def _touching(self, pairs: Indices, q: Array) -> npt.NDArray[np.bool_]:
        """Tell which pairs, shape (p, 2), touch at joint values."""
        poses = np.empty((len(q) + 1, 4, 4))
        pose_joints(self._joints, q, poses)
        poses = poses[self._carried_by + 1]
        centres = np.einsum("pij,pj->pi", poses[:, :3, :3], self._balls[:, :3])
        centres += poses[:, :3, 3]
        between = np.linalg.norm(centres[pairs[:, 0]] - centres[pairs[:, 1]], axis=1)
        around, inside = self._balls[pairs, 3:].sum(axis=1).T
        touching = np.asarray(between < inside - _ROUNDING)
        for k in np.flatnonzero(~touching & (between < around + _ROUNDING)):
            a, b = pairs[k]
            touching[k] = self._distance((a, b), q) <= 0.0
        return touching

    def _distance(self, pair: tuple[int, int], q: Array) -> float:
        return hull_distance_at(self._hulls[pair[0]], q, self._hulls[pair[1]], q)

    def _proved_apart(self, pair: tuple[int, int]) -> bool:
        """Bisect the joints between two parts; True when they touch at no joint values."""
        near, far = sorted(pair, key=lambda k: self._parts[k].joint)
        between = slice(self._parts[near].joint + 1, self._parts[far].joint + 1)
        chain, lower, upper = self._chain, self._lower[between], self._upper[between]
        moved = chain.placement[between], chain.axis[between], chain.prismatic[between]
        joints = chain_table(KinematicChain(*moved), lower, upper)
        speed = self._speeds[far][between]
        boxes = np.empty((_BUDGET + 2, 2, len(speed)))
        turn = np.where(joints.prismatic, np.inf, 2.0 * np.pi)
        boxes[0] = lower, np.minimum(upper, lower + turn)
        counts, q, measured = np.array([1, 0]), self._home.copy(), math.nan
        while (
            verdict := _bisect(
                joints,
                speed,
                self._balls[near],
                self._balls[far],
                boxes,
                counts,
                measured,
            )
        ) == _UNDECIDED:
            q[between] = boxes[counts[0] - 1].sum(axis=0) / 2.0
            measured = self._distance(pair, q)
        return verdict == _APART

    def _speed_bounds(self, part: LinkPart) -> Array:
        """Return a bound on the displacement of a part by each joint, per rad (or per m).

        The distance of a point from a joint's axis is at most the summed lengths of the links in
        between, sliding joints at their farthest.
        """
        slides = self._chain.prismatic
        speeds = np.zeros(len(slides))
        reach = float(np.linalg.norm(part.body.vertices, axis=1).max())
        for k in range(part.joint, -1, -1):
            slide = max(abs(self._lower[k]), abs(self._upper[k])) if slides[k] else 0.0
            speeds[k] = 1.0 if slides[k] else reach
            reach += float(np.linalg.norm(self._chain.placement[k, :3, 3])) + slide
        return speeds


def _balls(vertices: Array) -> Array:
    """Return centre and radius of a ball around a hull, and the radius of one inside, shape (5,)."""
    centre = vertices.mean(axis=0)
    inside = 0.0
    with suppress(QhullError):
        planes = ConvexHull(vertices).equations
        inside = max(0.0, -float((planes[:, :3] @ centre + planes[:, 3]).max()))
    around = np.linalg.norm(vertices - centre, axis=1).max()
    return np.array([*centre, around, inside])


@kernel
def _bisect(
    joints: JointTable,
    speed: Array,
    near: Array,
    far: Array,
    boxes: Array,
    counts: Indices,
    measured: float,
) -> int:
    """Bisect boxes of joint values until two parts are proved apart, or found not to be.

    Each box whose centre is too near to a contact has to be divided, so the result does not depend on the
    order. Balls in and around the hulls decide most boxes; the distance of the hulls decides the others.

    Args:
        joints: those between the parts.
        speed: bound on the displacement of the far part by each, shape (n,) [m/rad or 1].
        near, far: balls of the parts, shape (5,).
        boxes: stack of lower and upper joint values, shape (b, 2, n).
        counts: of boxes on the stack, and of those made so far, shape (2,).
        measured: distance of the parts at the centre of the topmost box, NaN if not measured [m].

    Returns:
        _APART, _TOUCHING, or _UNDECIDED where the distance at the centre of the topmost box is
        needed.
    """
    n = speed.shape[0]
    poses, q = np.empty((n + 1, 4, 4)), np.empty(n)
    while counts[0] > 0:
        top = counts[0] - 1
        closes, widest, split = 0.0, -1.0, 0
        for j in range(n):
            q[j] = (boxes[top, 0, j] + boxes[top, 1, j]) / 2.0
            width = speed[j] * (boxes[top, 1, j] - boxes[top, 0, j])
            closes += width / 2.0
            if width > widest:
                widest, split = width, j
        least = most = measured
        if np.isnan(measured):
            pose_joints(joints, q, poses)
            squared = 0.0
            for r in range(3):
                off = poses[n, r, 3] - near[r]
                for k in range(3):
                    off += poses[n, r, k] * far[k]
                squared += off * off
            between = np.sqrt(squared)
            least = between - near[3] - far[3] - _ROUNDING
            most = between - near[4] - far[4] + _ROUNDING
        measured = np.nan
        if least > closes:
            counts[0] = top
            continue
        if most > closes or least <= 0.0 < most:
            return _UNDECIDED
        if (most <= 0.0 and counts[1] > 0) or counts[1] + 2 > _BUDGET:
            return _TOUCHING
        middle = q[split]
        for j in range(n):
            boxes[top + 1, 0, j] = boxes[top, 0, j]
            boxes[top + 1, 1, j] = boxes[top, 1, j]
        boxes[top, 1, split] = boxes[top + 1, 0, split] = middle
        counts[0], counts[1] = top + 2, counts[1] + 2
    return _APART
