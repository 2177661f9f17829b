"""Suction cups: cup size from the shapes of a tool, and the largest flat area for a cup on a part."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot
from planning.grips.grip import USUAL_CUP, CupPoints, GripRules
from planning.grips.pads import TO_CUP, finger_sides, own_bodies
from planning.grips.shape_grips import part_grips
from planning.transforms import Array, Transform

_ROUND = float(np.cos(np.pi / 24))
"""Ratio of the size of a round cup to that of its polygon in a robot description."""

_SHARE = 0.99 * _ROUND
"""Share of a cup's radius that is checked, less than 1 for cups as wide as a face."""

_AROUND = np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False)

_TRUE = 5e-4
"""The widest cup is found to within this [m]."""


def with_cup(rules: GripRules, robot: PlacedRobot) -> GripRules:
    """Return rules with the cup size found from the shapes of a tool, unless they state one."""
    explicit = rules.cup is not None or rules.frame not in {
        "flange",
        *robot.model.frames,
    }
    if not rules.suction or robot.model.grip is None or explicit:
        return rules
    # Of fingers that are said to hold as a cup does, the position of the cup is unknown.
    tip = robot.model.frame_in_last_joint(rules.frame)
    fingers = finger_sides(robot.model, tip) is not None
    return rules if fingers else replace(rules, lips=_cup_points(robot.model, tip))


def _cup_points(model: RobotModel, tip: Transform) -> CupPoints:
    """Return the centre and the front edge of each body that reaches to a tool frame, in that frame [m]."""
    found: list[tuple[float, float]] = []
    for body in own_bodies(model):
        corners = (body.vertices - tip[:3, 3]) @ tip[:3, :3]
        front = float(corners[:, 2].max())
        if front >= -TO_CUP:
            face = corners[corners[:, 2] >= front - TO_CUP, :2]
            middle = 0.5 * (face.min(axis=0) + face.max(axis=0))
            directions = np.column_stack([np.cos(_AROUND), np.sin(_AROUND)]) @ face.T
            edge = face[np.unique(directions.argmax(axis=1))]
            points = np.vstack([middle, middle + _SHARE * (edge - middle)])
            found += [(x, y) for x, y in points.tolist()]
    edges = np.array(found).reshape(-1, 2)
    # Where the frame is beside all of them, it is ambiguous which are meant.
    there = found and np.maximum(edges.min(axis=0), -edges.max(axis=0)).max() <= TO_CUP
    return tuple(found) if there else ()


def cup_width(rules: GripRules) -> float:
    """Return the total width of the cups of a tool, where it is greatest [m]."""
    if not rules.lips:
        return 2.0 * (rules.cup or USUAL_CUP)
    points: Array = np.array(rules.lips)
    return (
        float(np.linalg.norm(points[:, None] - points, axis=2).max()) * _ROUND / _SHARE
    )


def describe_too_wide_cups(
    shape: Shape, start: Transform, goal: Transform, rules: GripRules
) -> str | None:
    """Return in words the largest cup for the faces of a part, None where there is none.

    Args:
        shape: of the part.
        start, goal: poses of its frame in the world.
        rules: for grips by suction.
    """
    low, high, face = 0.0, 0.5 * float(max(shape.size)), ""
    while high - low > _TRUE:
        radius = 0.5 * (low + high)
        own = replace(rules, cup=radius, lips=())
        if grips := part_grips(shape, start, goal, own):
            out = -grips[0].pose[:3, 2]
            axis = int(np.abs(out).argmax())
            low, face = radius, f"{'-' if out[axis] < 0 else '+'}{'xyz'[axis]}"
        else:
            high = radius
    by = "by the shapes of the tool" if rules.lips else "grips.cup_m"
    if not face or 2.0 * low >= cup_width(rules):
        return None
    return (
        f"the cup is {1e3 * cup_width(rules):.1f} mm wide ({by}), and the widest that its largest flat"
        f" face, {face}, takes is {2e3 * low:.1f} mm"
    )
