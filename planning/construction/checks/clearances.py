"""Least distances of a robot's bodies to everything: clearances, and allowed contacts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.construction.checks.scene import Limits
from planning.construction.world.fleet import Carrier
from planning.geometry.swept import SKIP
from planning.kinematics.kinematics import joint_poses_of
from planning.motion.sequential import MARGIN
from planning.steps.skill import Pairs
from planning.transforms import Array


class _OwnBody(NamedTuple):
    """A body of a mover.

    Attributes:
        entity: as allowed contacts name it.
        mover: whose it is.
        joint: that carries it.
        part: True for the robot's own, False for what it holds.
        level: how low and how high it is where no joint can change that, else None [m].
    """

    entity: str
    mover: int
    joint: int
    part: bool
    level: tuple[float, float] | None


def body_limits(
    cell: Workcell,
    movers: Sequence[Carrier],
    boxes: Sequence[str],
    bounds: Array,
    numbers: Mapping[str, int],
    allowed: Pairs,
) -> Limits:
    """Return the least distances that the movers' bodies keep: the clearances and a margin.

    Args:
        cell: for its clearances.
        movers: who moves.
        boxes: entity of each piece at rest, those of the cell's fixtures first.
        bounds: least and greatest corner of each, shape (b, 6) [m].
        numbers: of all entities, those of robots first.
        allowed: unordered pairs of entities that may touch.
    """
    between = cell.clearances.robot_robot + MARGIN
    to_objects = cell.clearances.robot_object + MARGIN
    own = [body for m, mover in enumerate(movers) for body in _bodies(m, mover)]
    still = sum(len(fixture.shape.pieces) for fixture in cell.fixtures)
    touchable = [_touchable(body.entity, allowed) for body in own]
    to_boxes = np.full((len(own), len(boxes)), to_objects)
    to_entities = np.full((len(own), len(numbers)), between)
    for i, body in enumerate(own):
        if body.part and body.joint < 0:
            to_boxes[i, :still] = SKIP
        to_entities[i, [numbers[e] for e in touchable[i] if e in numbers]] = SKIP
        to_boxes[i, [name in touchable[i] for name in boxes]] = SKIP
        if body.level is not None:
            # It keeps its level: what is all below or above is never met.
            low, high = body.level
            gap = np.maximum(bounds[:, 2] - high, low - bounds[:, 5])
            to_boxes[i, gap >= to_objects] = SKIP
    return Limits(to_boxes, to_entities, _own_limits(movers, own, touchable, between))


def _own_limits(
    movers: Sequence[Carrier],
    own: Sequence[_OwnBody],
    touchable: Sequence[set[str]],
    between: float,
) -> Array:
    limits = np.full((len(own), len(own)), SKIP)
    first = 0
    for mover in movers:
        last = first + len(mover.names)
        limits[first:last, first:last] = mover.self_limits
        first = last
    for (i, a), (j, b) in combinations(enumerate(own), 2):
        if b.entity in touchable[i]:
            limits[i, j] = SKIP
        elif a.mover != b.mover and (a.joint >= 0 or b.joint >= 0):
            limits[i, j] = between
    return limits


def _bodies(m: int, carrier: Carrier) -> list[_OwnBody]:
    robot, hulls = carrier.robot, carrier.hulls
    corners = np.split(hulls.corners, hulls.corner_first[1:-1])
    return [
        _OwnBody(
            name,
            m,
            joint,
            k < len(robot.model.parts),
            _level(robot, joint, corners[k]),
        )
        for k, (name, joint) in enumerate(
            zip(carrier.names, hulls.joint.tolist(), strict=True)
        )
    ]


def _touchable(name: str, allowed: Pairs) -> set[str]:
    """Return the entities that an entity may touch."""
    return {other for pair in allowed if name in pair for other in pair - {name}}


def _level(
    robot: PlacedRobot, joint: int, corners: Array
) -> tuple[float, float] | None:
    """Return how low and how high a body is where no joint can change that, else None."""
    chain = robot.model.chain
    poses = joint_poses_of(robot, np.zeros(robot.model.dof))
    for j in range(joint + 1):
        up = abs(float((poses[j + 1, :3, :3] @ chain.axis[j])[2]))
        if up > 1e-12 if chain.prismatic[j] else up < 1.0 - 1e-12:
            return None
    z = corners @ poses[joint + 1, 2, :3] + poses[joint + 1, 2, 3]
    return float(z.min()), float(z.max())
