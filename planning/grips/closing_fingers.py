"""Volume that fingers sweep while they close on a part, and the obstacles on their way.

The shapes of a tool show open fingers, and all motions are checked with open fingers. An obstacle between an open
finger and the part, such as a neighbour in a rack of thin parts, is hit only when the finger closes.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.caches import BoundedCache
from planning.cell.body import ConvexBody
from planning.cell.cover import capsule_cover, hull_vertices
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell, WorldState
from planning.geometry.scene_checker import SceneChecker
from planning.grips.pads import finger_sides, pads_at
from planning.motion.sequential import MARGIN
from planning.steps.skill import Obstruction, Pairs
from planning.transforms import Array, Transform

_LEAST_WAY = 1e-4
"""Fingers that close by less sweep nothing [m]."""

_ROUNDING = 5e-5
"""Distances of hulls with many corners are as exact as this [m]."""

_SWEPT: BoundedCache[tuple[RobotModel | None]] = BoundedCache(2_000)


def swept_fingers(
    model: RobotModel,
    tip: Transform,
    shape: Shape,
    grip: Transform,
    short: float = 0.0,
) -> RobotModel | None:
    """Return a robot whose fingers are replaced by the volume that they sweep while closing on a part.

    Args:
        model, tip, shape, grip: see ``pads_at``.
        short: they stop so far from the part [m].

    Returns:
        The same robot with each finger as the hull of itself open and closed; None where it has
        no fingers, or they do not move.
    """
    key = (model, tip.tobytes(), shape, grip.tobytes(), short)
    return _SWEPT.get(key, lambda: (_swept(model, tip, shape, grip, short),))[0]


def _swept(
    model: RobotModel, tip: Transform, shape: Shape, grip: Transform, short: float
) -> RobotModel | None:
    sides, pads = finger_sides(model, tip), pads_at(model, tip, shape, grip)
    if sides is None or pads is None:
        return None
    moved: dict[ConvexBody, ConvexBody] = {}
    for bodies, pad, sign in zip(sides, pads.sides, (-1.0, 1.0), strict=True):
        if pad.travel is not None and pad.travel - short > _LEAST_WAY:
            displacement = sign * (pad.travel - short) * tip[:3, 1]
            moved |= {body: _along(body, displacement) for body in bodies}
    if not moved:
        return None
    parts = (
        replace(part, body=moved.get(part.body, part.body)) for part in model.parts
    )
    return replace(model, parts=tuple(parts))


def _along(body: ConvexBody, displacement: Array) -> ConvexBody:
    """Return the hull of a body and of the same body after a displacement, shape (3,) [m]."""
    both = np.vstack([body.vertices, body.vertices + displacement])
    corners = hull_vertices(both)
    return ConvexBody(body.name, corners, capsule_cover(corners))


def finger_obstacles(
    robot: PlacedRobot,
    frame: str,
    held: tuple[CellObject, Transform],
    q: Array,
    scene: tuple[Workcell, WorldState, Pairs],
) -> Obstruction | None:
    """Return the obstacles of a robot's fingers while they close on a part or open from it.

    Bodies flush with the part at its contacts are no obstacles, protruding ones are.

    Args:
        robot: whose fingers they are.
        frame: between them.
        held: the part, and the pose of that frame in the part's.
        q: where the robot stands meanwhile, shape (n,).
        scene: the cell, the poses of all else in it, and the allowed contacts.
    """
    item, grip = held
    tip = robot.model.frame_in_last_joint(frame)
    cell, state, allowed = scene
    short = cell.clearances.robot_object + MARGIN + _ROUNDING
    model = swept_fingers(robot.model, tip, item.shape, grip, short)
    if model is None:
        return None
    robots = (
        replace(other, model=model) if other.name == robot.name else other
        for other in cell.robots
    )
    cell = replace(cell, robots=tuple(robots))
    checker = SceneChecker(cell, robot.name, state, allowed, margin=MARGIN)
    contact = checker.contact(q)
    if contact is None:
        return None
    return Obstruction(
        f"{contact} as the fingers close on {item.name}, or open from it",
        contact.obstacle,
        moving=contact.moving,
    )
