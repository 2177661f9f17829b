"""Exact decision whether two moving convex hulls come closer than a clearance.

The library coal measures the distance of the hulls at the midpoints of both motions. The displacement of all points
from there is bounded. One measurement is therefore sufficient if the hulls are clearly apart or clearly too close.
Other motions are bisected down to a tolerance; hulls that are still undecided then count as too close.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, cached_property
from heapq import heappop, heappush
from typing import Any

import coal
import numpy as np

from planning.caches import BoundedCache
from planning.cell.body import ConvexBody
from planning.kernels import kernel
from planning.kinematics.chain import JointTable, joint_axis, pose_joints
from planning.transforms import Array, Transform

TOLERANCE = 2e-4
"""Hulls that may come within clearance + TOLERANCE of each other are called too close [m]."""

_REQUEST = coal.DistanceRequest()

_DEEPEST = -1e100
"""Signed distance below which coal has failed [m]."""

_RESTING: BoundedCache[Solid] = BoundedCache(50_000)


@cache
def hull_shape(body: ConvexBody) -> Any:
    """Return coal's convex shape of a body, cached per body."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(0, len(body.vertices))
    model.addVertices(np.asarray(body.vertices, dtype=np.float64))
    model.endModel()
    model.buildConvexHull(True, "Qt")
    return model.convex


@dataclass(frozen=True)
class Solid:
    """A convex body, at rest in the world or carried by a robot's joint.

    Attributes:
        name: the entity it belongs to, as allowed contacts name it.
        body: its hull and capsules, in a frame of its own.
        local: pose of the body in the frame of the joint, or in the world.
        carrier: joints of the robot, None for a body at rest in the world.
        joint: the carrying joint, -1 for the base.
        deviates: largest distance of any point from its place by forward kinematics [m].
    """

    name: str
    body: ConvexBody
    local: Transform
    carrier: JointTable | None = None
    joint: int = -1
    deviates: float = 0.0

    @cached_property
    def shape(self) -> Any:
        """The hull as coal's convex shape."""
        return hull_shape(self.body)

    @cached_property
    def vertices(self) -> Array:
        """Hull corners in the frame of the joint, or in the world, shape (v, 3) [m]."""
        return np.ascontiguousarray(self._placed(self.body.vertices))

    @cached_property
    def ends(self) -> Array:
        """Starts and ends of its capsules in the same frame, shape (c, 2, 3) [m]."""
        capsules = self.body.capsules
        return np.stack([self._placed(capsules.start), self._placed(capsules.end)], 1)

    def deviation_bound_with_base(self, pose: Any) -> float:
        """Return the largest displacement of any of its points by base error and deviation [m].

        Args:
            pose: coal's, of the body in the world.
        """
        if self._has_exact_base or self.carrier is None:
            return self.deviates
        rotation, origin = np.asarray(pose.getRotation()), pose.getTranslation()
        points = self.body.vertices @ rotation.T + (origin - self.carrier.base[:3, 3])
        displacement, angle = self.carrier.error.tolist()
        most = np.linalg.norm(points, axis=1).max()
        return float(self.deviates + displacement + angle * most)

    @cached_property
    def _has_exact_base(self) -> bool:
        return self.carrier is None or not np.any(self.carrier.error)

    @cached_property
    def at_rest(self) -> Any:
        """Coal's pose of a body at rest."""
        return coal.Transform3s(self.local[:3, :3], self.local[:3, 3])

    @cached_property
    def where_planned(self) -> Solid:
        """The same body without errors: base at its planned pose, no deviation from the path."""
        if self.carrier is None or (self._has_exact_base and not self.deviates):
            return self
        carrier = self.carrier._replace(error=np.zeros(2))
        return replace(self, carrier=carrier, deviates=0.0)

    def _placed(self, points: Array) -> Array:
        return np.asarray(points @ self.local[:3, :3].T + self.local[:3, 3])


def resting_solid(name: str, body: ConvexBody, pose: Transform) -> Solid:
    """Return a body at rest at ``pose`` in the world, cached because many scenes share it."""
    return _RESTING.get((name, body, pose.tobytes()), lambda: Solid(name, body, pose))


@kernel
def _carry(
    joints: JointTable,
    joint: int,
    vertices: Array,
    local: Array,
    q_a: Array,
    q_b: Array,
    root: int,
    out: Array,
) -> float:
    """Write a carried body's pose at the middle of a motion; bound its motion relative to root."""
    n = q_a.shape[0]
    poses, middle = np.empty((n + 1, 4, 4)), np.empty(n)
    for j in range(n):
        middle[j] = 0.5 * (q_a[j] + q_b[j])
    pose_joints(joints, middle, poses)
    pose = poses[joint + 1]
    for r in range(3):
        for c in range(4):
            total = pose[r, 3] if c == 3 else 0.0
            for k in range(3):
                total += pose[r, k] * local[k, c]
            out[r, c] = total
    moved = 0.0
    for j in range(joint, root, -1):
        half_travel = 0.5 * abs(q_b[j] - q_a[j])
        if half_travel == 0.0:
            continue
        if joints.prismatic[j]:
            moved += half_travel
            continue
        frame = poses[j + 1]
        ax, ay, az = joint_axis(joints, poses, j)
        reach = 0.0
        for v in range(vertices.shape[0]):
            x, y, z = -frame[0, 3], -frame[1, 3], -frame[2, 3]
            x += pose[0, 3]
            y += pose[1, 3]
            z += pose[2, 3]
            for k in range(3):
                x += pose[0, k] * vertices[v, k]
                y += pose[1, k] * vertices[v, k]
                z += pose[2, k] * vertices[v, k]
            cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
            reach = max(reach, cx * cx + cy * cy + cz * cz)
        moved += half_travel * (np.sqrt(reach) + moved)
    return moved


def place_at_middle(
    solid: Solid, q_a: Array, q_b: Array, root: int = -1
) -> tuple[Any, float]:
    """Return coal's pose of a body at the middle of a motion and its largest deviation from there.

    Args:
        solid: the body.
        q_a, q_b: ends of its carrier's motion, shape (n,); ignored for a body at rest.
        root: joint in whose frame the displacement is measured, -1 for the world.

    Returns:
        The pose, and a bound on the distance of every point, at any time of the motion, from its
        place at the middle [m].
    """
    if solid.carrier is None:
        return solid.at_rest, 0.0
    carrier, joint, vertices = solid.carrier, solid.joint, solid.vertices
    pose = np.empty((3, 4))
    # Writable copies: numba recompiles for read-only arrays.
    q_a, q_b = np.array(q_a), np.array(q_b)
    moved = _carry(carrier, joint, vertices, solid.local, q_a, q_b, root, pose)
    return coal.Transform3s(pose[:, :3], pose[:, 3]), moved


def hull_distance(a: Solid, pose_a: Any, b: Solid, pose_b: Any) -> float:
    """Return the signed distance of two hulls at coal poses; negative is penetration [m]."""
    # Threads may measure concurrently, so each needs a result of its own.
    result = coal.DistanceResult()
    return shape_distance(a.shape, pose_a, b.shape, pose_b, result)


def shape_distance(a: Any, pose_a: Any, b: Any, pose_b: Any, result: Any) -> float:
    """Return the signed distance of two of coal's convex shapes at coal poses [m].

    Args:
        a, pose_a, b, pose_b: the shapes and their poses.
        result: receives the normal from a to b.
    """
    found = float(coal.distance(a, pose_a, b, pose_b, _REQUEST, result))
    if found < _DEEPEST:
        # Where faces of two hulls are in one plane, coal may fail. It succeeds with the hulls exchanged.
        result.clear()
        found = float(coal.distance(b, pose_b, a, pose_a, _REQUEST, result))
        result.normal = -result.normal
    return found


def hull_distance_at(a: Solid, q_a: Array, b: Solid, q_b: Array) -> float:
    """Return the signed distance of two bodies, each carrier at one configuration [m]."""
    return hull_distance(
        a, place_at_middle(a, q_a, q_a)[0], b, place_at_middle(b, q_b, q_b)[0]
    )


def may_come_close(
    a: Solid,
    a_from: Array,
    a_to: Array,
    b: Solid,
    b_from: Array,
    b_to: Array,
    clearance: float,
    *,
    tolerance: float = TOLERANCE,
    together: bool = False,
) -> bool:
    """Tell whether two bodies can come closer than a clearance, each anywhere on its motion.

    The two motions are independent: either body may be anywhere on its way while the other is
    anywhere on its own, as in two unordered TPG nodes. With ``together`` one robot carries both.

    Args:
        a, b: the bodies.
        a_from, a_to: ends of the straight joint-space motion that carries ``a``, shape (n,).
        b_from, b_to: likewise for ``b``.
        clearance: least distance, for any base error and deviation; negative for an allowed overlap
            [m].
        tolerance: displacement below which motions are not divided further; bounds the error of the
            decision [m].
        together: whether both are carried by one robot on one and the same motion.
    """
    # Seen from the joint that carries the lower of the two, only the joints above it move.
    root = min(a.joint, b.joint) if together else -1
    if a.carrier is None and b.carrier is not None:
        a, a_from, a_to, b, b_from, b_to = b, b_from, b_to, a, a_from, a_to
    # Closest parts first, so that a too small distance is found soon.
    parts = [(0.0, 0, a_from, a_to, b_from, b_to)]
    made = 0
    while parts:
        _, _, a0, a1, b0, b1 = heappop(parts)
        pose_a, moved_a = place_at_middle(a, a0, a1, root)
        pose_b, moved_b = place_at_middle(b, b0, b1, root)
        gap = hull_distance(a, pose_a, b, pose_b)
        least, outward = clearance, 0.0
        if not together:  # else both have the same error
            for item, pose, moved in ((a, pose_a, moved_a), (b, pose_b, moved_b)):
                if (off := item.deviation_bound_with_base(pose)) > 0.0 and item.carrier:
                    least += off
                    outward += float(item.carrier.error[1]) * moved
        if gap < least:
            return True
        if gap - moved_a - moved_b - outward >= least:
            continue
        if moved_a + moved_b < tolerance:
            return True
        a_mid, b_mid = 0.5 * (a0 + a1), 0.5 * (b0 + b1)
        if together:
            halves = ((a0, a_mid, b0, b_mid), (a_mid, a1, b_mid, b1))
        elif moved_a >= moved_b:
            halves = ((a0, a_mid, b0, b1), (a_mid, a1, b0, b1))
        else:
            halves = ((a0, a1, b0, b_mid), (a0, a1, b_mid, b1))
        for half in halves:
            made += 1
            heappush(parts, (gap, -made, *half))
    return False
