"""Convex parts of robots, objects and fixtures, and their distances computed by coal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from planning.cell.shape import Shape
from planning.transforms import Array, Transform
from scheduling.witness.shapes import coal_forms

TOLERANCE = 2e-5
"""Tolerance of distance comparisons with the clearance: the accuracy of coal [m]."""

_DEEPEST = 1e100
"""An overlap that is deeper than this is none: coal has failed [m]."""

_REQUEST = coal.DistanceRequest()
_RESULT = coal.DistanceResult()


@dataclass(frozen=True)
class ConvexPart:
    """A convex body on a joint of a robot (or at rest in the world).

    Attributes:
        entity: what allowed contacts call it.
        joint: index of the joint that carries it, -1 for the base or the world.
        local: its pose in the joint's frame, shape (4, 4).
        shape: coal's shape.
        centre: of a sphere around it, in the joint's frame, shape (3,) [m].
        radius: of the sphere [m].
        weight: how far a unit of each joint can move any point of it, shape (n,) [m/rad].
    """

    entity: str
    joint: int
    local: Transform
    shape: Any
    centre: Array
    radius: float
    weight: Array


def resting_parts(entity: str, shape: Shape, pose: Transform) -> list[ConvexPart]:
    """Return the parts of things at rest."""
    out = []
    for item, local in coal_forms(shape):
        item.computeLocalAABB()
        at = pose @ local
        middle = at[:3, :3] @ np.array(item.aabb_center) + at[:3, 3]
        radius = float(item.aabb_radius)
        out.append(ConvexPart(entity, -1, at, item, middle, radius, np.zeros(0)))
    return out


def measure(
    a: ConvexPart, frame_a: Transform, b: ConvexPart, frame_b: Transform
) -> float:
    """Return the signed distance of two parts whose joints are at the given frames [m]."""
    return separation(a, frame_a, b, frame_b)[0]


def separation(
    a: ConvexPart, frame_a: Transform, b: ConvexPart, frame_b: Transform
) -> tuple[float, Array]:
    """Return the signed distance of two parts [m] and the direction from a to b, shape (3,)."""
    poses = coal_pose(frame_a @ a.local), coal_pose(frame_b @ b.local)
    distance = shape_distance(a.shape, poses[0], b.shape, poses[1])
    return distance, np.array(_RESULT.normal)


def coal_pose(pose: Transform) -> Any:
    """Return a pose, shape (4, 4), in coal's form."""
    return coal.Transform3s(pose[:3, :3], pose[:3, 3])


def shape_distance(a: Any, pose_a: Any, b: Any, pose_b: Any) -> float:
    """Return the signed distance of two of coal's shapes at two of its poses [m]."""
    _RESULT.clear()
    distance = float(coal.distance(a, pose_a, b, pose_b, _REQUEST, _RESULT))
    if distance < -_DEEPEST:
        # Where faces of two hulls lie in one plane, coal may fail. It then finds them the other way round.
        _RESULT.clear()
        distance = float(coal.distance(b, pose_b, a, pose_a, _REQUEST, _RESULT))
        _RESULT.normal = -_RESULT.normal
    return distance
