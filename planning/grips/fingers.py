"""Finger grips: friction between the pads and the part.

The closing force of the tool presses each pad evenly on its contact area. Friction there resists forces along the
pad, and torques about the axis between both pads. Each of these loads is divided by its friction limit. Slip begins
when the sum of the squares of these ratios is one (limit surface of a contact patch, approximated by an ellipsoid).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planning.caches import BoundedCache
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, PlacedRobot
from planning.grips.grip import Grip
from planning.grips.pads import finger_sides, pads_at
from planning.statics.contact_patch import contact_patch
from planning.statics.equilibrium import STANDARD_GRAVITY
from planning.transforms import Array, Transform, inverse, translation

_TOUCHES = 2e-4
"""Bodies of a pad and pieces of a part that are nearer to each other than this touch [m]."""

_SQUARE = 0.7
"""Pads press where faces are turned to the closing direction by no more than the angle of this cosine."""

_CELLS = 12
"""Resolution of contact patches in cells along either edge of their bounding box."""

_LOADS: BoundedCache[PadLoad | Literal[""]] = BoundedCache(20_000)


@dataclass(frozen=True)
class PadLoad:
    """Load on two pads, and the load that friction can carry.

    Attributes:
        moment_arm: distance of the centre of mass from the axis of the pads, where gravity turns
            the part about it [m].
        force, torque: of the weight on them: along the pads [N], about their axis [N m].
        most_force, most_torque: that friction bears, each alone.
    """

    moment_arm: float
    force: float
    torque: float
    most_force: float
    most_torque: float

    @property
    def share(self) -> float:
        """Fraction of the friction capacity used by the weight; above 1 the part slips or turns."""
        pull = self.force / self.most_force
        if self.torque <= 1e-9:
            return pull
        return math.hypot(pull, self.torque / max(self.most_torque, 1e-12))


def _pad_load(
    model: RobotModel,
    tip: Transform,
    shape: Shape,
    grip: Transform,
    weight: float,
    up: Array,
    friction: float,
) -> PadLoad | None:
    """Return the load on two pads for a given friction [N], None where they do not touch the part.

    Given are its weight [N], and the direction against gravity in its frame; for the rest see ``pads_at``.
    """
    sides, pads = finger_sides(model, tip), pads_at(model, tip, shape, grip)
    if sides is None or pads is None:
        return None
    at, axis = grip @ inverse(tip), grip[:3, 1]
    middles, radii = [], []
    for bodies, pad, sign in zip(sides, pads.sides, (-1.0, 1.0), strict=True):
        if pad.travel is None:
            return None
        closed = translation(*(pad.travel * sign * axis).tolist()) @ at
        points = [np.empty((0, 3))]
        for body in bodies:
            for piece in shape.pieces:
                patch = contact_patch(body, closed, piece, np.eye(4))
                square = abs(float(patch.normal @ axis)) >= _SQUARE
                if square and abs(patch.gap) <= _TOUCHES:
                    points.append(patch.points)
        touched = np.vstack(points)
        if not len(touched):
            return None
        # As seen along the axis of the pads: across and depth of the tool frame.
        middle, radius = _middle_and_radius(touched @ grip[:3, [0, 2]])
        middles.append(middle)
        radii.append(radius)
    pull = weight * (up @ grip[:3, [0, 2]])
    arm = shape.centre_of_mass @ grip[:3, [0, 2]] - 0.5 * (middles[0] + middles[1])
    torque = abs(float(arm[0] * pull[1] - arm[1] * pull[0]))
    force = float(np.linalg.norm(pull))
    return PadLoad(
        torque / force if force > 1e-9 else 0.0,
        force,
        torque,
        2.0 * friction,
        friction * (radii[0] + radii[1]),
    )


def _middle_and_radius(points: Array) -> tuple[Array, float]:
    """Return the centre of the convex hull of planar points, and the mean distance from it.

    Args:
        points: shape (p, 2) [m].
    """
    low, high = points.min(axis=0), points.max(axis=0)
    steps = (np.arange(_CELLS) + 0.5) / _CELLS
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    cells = low + grid * (high - low)
    try:
        planes = ConvexHull(points).equations
        inside = (planes[:, :2] @ cells.T + planes[:, 2:] <= 1e-12).all(axis=0)
        cells = cells[inside] if inside.any() else points
    except QhullError:  # a line, or a point
        farthest = np.linalg.norm(points - points[0], axis=1).argmax()
        along = points @ (points[farthest] - points[0])
        begin, end = points[along.argmin()], points[along.argmax()]
        cells = begin + steps[:, None] * (end - begin)
    middle = cells.mean(axis=0)
    return middle, float(np.linalg.norm(cells - middle, axis=1).mean())


def load_on_pads(
    robot: PlacedRobot,
    part: CellObject,
    grip: Grip,
    frame: str,
    pose: Transform,
    friction: float,
) -> PadLoad | None:
    """Return the load on the pads that hold a part at a grip.

    Args:
        robot: the robot.
        part: the part.
        grip: the grip.
        frame: name of the tool frame.
        pose: of the part in the world.
        friction: coefficient of that of pads and part.

    Returns:
        None where its weight or the closing force of the tool is not stated, or where its
        pads do not touch it.
    """
    model, shape = robot.model, part.shape
    force = None if model.grip is None else model.grip.force
    if force is None or part.mass <= 0.0:
        return None
    tip = model.frame_in_last_joint(frame)
    up = pose[2, :3]

    def find() -> PadLoad | Literal[""]:
        weight = part.mass * STANDARD_GRAVITY
        about = model, tip, shape, grip.pose, weight, up
        return _pad_load(*about, friction * force) or ""

    at = tip.tobytes(), grip.pose.tobytes(), up.tobytes()
    return _LOADS.get((model, shape, part.mass, friction, *at), find) or None


def firm_grips(
    robot: PlacedRobot,
    part: CellObject,
    grips: Mapping[int, Grip],
    frame: str,
    poses: Sequence[Transform],
    friction: float,
) -> dict[int, Grip]:
    """Return the grips at which friction holds a part; all of them if there are none.

    Args:
        robot: the robot.
        part: the part.
        grips: of its tool, by number.
        frame: name of the tool frame.
        poses: of the part in the world.
        friction: coefficient of that of pads and part.
    """

    def firm(grip: Grip) -> bool:
        loads = (
            load_on_pads(robot, part, grip, frame, pose, friction) for pose in poses
        )
        return all(load is None or load.share <= 1.0 for load in loads)

    return {k: grip for k, grip in grips.items() if firm(grip)} or dict(grips)
