"""The room that fingers sweep as they close on a part, or open from it.

A tool is described with its fingers open, and all its ways are checked so. What stands between an
open finger and the part is met only as the finger closes: a neighbour in a rack of thin parts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.cell.cover import ConvexBody, capsule_cover, hull_vertices
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell, WorldState
from planning.files import KeptAnswers
from planning.geometry.scene_checker import SceneChecker
from planning.grips.pads import finger_sides, pads_at
from planning.kinematics.kinematics import frame_in_last_joint
from planning.motion.sequential import MARGIN
from planning.steps.skill import Obstruction, Pairs
from planning.transforms import Array, Transform

_LEAST_WAY = 1e-4
"""Fingers that close by less sweep nothing [m]."""

_ROUNDING = 5e-5
"""Distances of hulls with many corners are as exact as this [m]."""

_SWEPT: KeptAnswers[tuple[RobotModel | None]] = KeptAnswers(2_000)


def swept_fingers(
    model: RobotModel,
    tip: Transform,
    shape: Shape,
    grip: Transform,
    short: float = 0.0,
) -> RobotModel | None:
    """Return a robot whose fingers fill the room that they sweep as they close on a part.

    Args:
        model: of the robot, with its tool.
        tip: pose of the tool frame in the last joint's frame.
        shape: of the part.
        grip: pose of the tool frame in the part's.
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
        if pad.way is not None and pad.way - short > _LEAST_WAY:
            way = sign * (pad.way - short) * tip[:3, 1]
            moved |= {body: _along(body, way) for body in bodies}
    if not moved:
        return None
    parts = (
        replace(part, body=moved.get(part.body, part.body)) for part in model.parts
    )
    return replace(model, parts=tuple(parts))


def _along(body: ConvexBody, way: Array) -> ConvexBody:
    """Return the hull of a body and of the same body a way further, shape (3,) [m]."""
    both = np.vstack([body.vertices, body.vertices + way])
    corners = hull_vertices(both)
    return ConvexBody(body.name, corners, capsule_cover(corners))


def in_the_way_of_fingers(
    robot: PlacedRobot,
    frame: str,
    held: tuple[CellObject, Transform],
    q: Array,
    scene: tuple[Workcell, WorldState, Pairs],
) -> Obstruction | None:
    """Return what a robot's fingers would meet as they close on a part or open from it.

    What is flush with the part where they touch it is not in their way, what stands out is.

    Args:
        robot: whose fingers they are.
        frame: between them.
        held: the part, and the pose of that frame in the part's.
        q: where the robot stands meanwhile, shape (n,).
        scene: the cell, where all else in it is then, and who may touch whom.
    """
    item, grip = held
    tip = frame_in_last_joint(robot.model, frame)
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
        contact.second.split(":")[0],
    )
