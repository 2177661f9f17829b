"""Whether a robot may take a part: its weight, and room for the tool's own body on the way to a grip."""

from __future__ import annotations

import numpy as np

from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, PlacedRobot
from planning.geometry.exact import Solid, distance, place, resting_solid
from planning.geometry.robot_bodies import GROUPS
from planning.kept_answers import KeptAnswers
from planning.kinematics.kinematics import frame_in_last_joint
from planning.parts.assembly import Grip
from planning.skills.joint_paths import Obstruction
from planning.transforms import Array, Transform, inverse, translation

DEEPEST = 0.002
"""Most that a tool may be in what it grips, such as fingers that are drawn too far closed [m]."""

_STEPS = 6
"""Places on the straight way in at which a tool is measured."""

_NOWHERE: Array = np.zeros(0)

_FITS: KeptAnswers[float] = KeptAnswers(20_000)


def overload(robot: PlacedRobot, part: CellObject) -> str | None:
    """Return why a part is too heavy for a robot, None where it is not."""
    drives = robot.model.drives
    if drives is None or part.mass <= drives.spare:
        return None
    return (
        f"it may carry {drives.spare:.3g} kg beside its tool, and {part.name} weighs"
        f" {part.mass:g} kg"
    )


def tool_misfit(
    robot: PlacedRobot, frame: str, part: CellObject, grip: Grip, approach: float
) -> Obstruction | None:
    """Return why a robot's tool cannot hold a part by a grip, None where it can.

    Its own body would be in the part on the straight way to the grip, open as it is described. Boxes
    between the fingers of robots that come with their tools are not looked at: those follow them.

    Args:
        robot: the robot.
        frame: name of the tool frame.
        part: the part.
        grip: the grip.
        approach: length of the straight way to it [m].
    """
    if part.shape.is_box and robot.model.grip is None:
        return None
    depth = _depth(robot, frame, part.shape, grip.pose, approach)
    if depth <= DEEPEST:
        return None
    return Obstruction(
        f"the tool of {robot.name} would be {depth * 1e3:.1f} mm in {part.name}, open as it is held"
    )


def _depth(
    robot: PlacedRobot, frame: str, shape: Shape, grip: Transform, approach: float
) -> float:
    """Return how deep a tool gets into a part on the straight way to a grip [m]."""
    model = robot.model
    tip = frame_in_last_joint(model, frame)
    key = (model, tip.tobytes(), shape, grip.tobytes(), approach)
    return _FITS.get(key, lambda: _measured(robot, tip, shape, grip, approach))


def _measured(
    robot: PlacedRobot, tip: Transform, shape: Shape, grip: Transform, approach: float
) -> float:
    last = robot.model.dof - 1
    tool = [
        part.body
        for part in robot.model.parts
        if part.group == GROUPS[1] and part.joint == last
    ]
    hull = [resting_solid("part", piece, np.eye(4)) for piece in shape.pieces]
    still = [(solid, place(solid, _NOWHERE, _NOWHERE)[0]) for solid in hull]
    deepest = 0.0
    for share in np.linspace(0.0, 1.0, _STEPS).tolist():
        at = grip @ translation(0.0, 0.0, -share * approach) @ inverse(tip)
        for body in tool:
            moved = Solid("tool", body, at)
            pose = place(moved, _NOWHERE, _NOWHERE)[0]
            low, high = moved.vertices.min(axis=0), moved.vertices.max(axis=0)
            if np.any(low > shape.high) or np.any(high < shape.low):
                continue
            gaps = [distance(moved, pose, other, where) for other, where in still]
            deepest = max(deepest, -min(gaps))
    return deepest
