"""Grips of the tools in a cell: kind of grip, payload, and fit of the tool on a part."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from planning.caches import BoundedCache
from planning.cell.body import ConvexBody
from planning.cell.robot_model import RobotModel, ToolGrip
from planning.cell.shape import Shape
from planning.cell.workcell import CellObject, PlacedRobot
from planning.geometry.exact import Solid, hull_distance, place_at_middle, resting_solid
from planning.grips.cups import describe_too_wide_cups, with_cup
from planning.grips.grip import Grip, GripRules
from planning.grips.pads import explain_not_held, own_bodies
from planning.grips.shape_grips import part_grips
from planning.steps.skill import Obstruction
from planning.transforms import Array, Transform, inverse, translation

_LEAST_DEPTH_MM = 3
"""Least depth of a part between fingers at which they can hold it [mm]."""

MOST_OVERLAP = 0.002
"""Allowed overlap of a tool with the gripped part, such as of fingers modelled too far closed [m]."""

_SAMPLES = 6
"""Number of samples on the straight approach at which a tool is measured."""

_NO_JOINTS: Array = np.zeros(0)
"""Joint values of a body that no joint moves."""

_DEPTHS: BoundedCache[float] = BoundedCache(20_000)
"""Cached penetration depths, see ``_depth``."""


def tool_rules(rules: GripRules, tool: ToolGrip | None) -> GripRules:
    """Return the rules for the grips of a tool.

    Fingers open as far as those of the tool do. A cup is put on a face, whatever its size, and
    stays upright on it.

    Args:
        rules: of the assembly, where the tool has none of its own.
        tool: kind of grip; None where unknown.
    """
    if tool is None:
        return rules
    if tool.opening is None:
        return replace(rules, suction=True, opening=math.inf, tilts=(0.0,))
    least, most = tool.opening
    return replace(rules, suction=False, least_opening=least, opening=most)


def robot_rules(rules: GripRules, robot: PlacedRobot) -> GripRules:
    """Return the rules for the grips of a robot's tool, with the cup size from its shapes."""
    return with_cup(tool_rules(rules, robot.model.grip), robot)


def tool_grips(
    robots: Sequence[PlacedRobot],
    shape: Shape,
    start: Transform,
    goal: Transform,
    rules: GripRules,
) -> list[Grip]:
    """Return the grips by which some robot's tool can pick and place a part.

    Args:
        robots: of the cell.
        shape: of the part.
        start, goal: poses of its frame in the world.
        rules: of the assembly.
    """
    by_tool = {robot.model.grip: robot for robot in robots}
    return [
        grip
        for robot in by_tool.values()
        for grip in robot_grips(robot, shape, start, goal, rules)
    ]


def robot_grips(
    robot: PlacedRobot,
    shape: Shape,
    start: Transform,
    goal: Transform,
    rules: GripRules,
) -> list[Grip]:
    """Return the grips by which one robot's tool can pick and place a part."""
    tool = robot.model.grip
    found = part_grips(shape, start, goal, robot_rules(rules, robot))
    return found if tool is None else [replace(grip, tool=tool) for grip in found]


def own_grips(robot: PlacedRobot, grips: Sequence[Grip]) -> Iterator[tuple[int, Grip]]:
    """Yield the grips of a robot's tool, each with its number."""
    for number, grip in enumerate(grips):
        if grip.tool == robot.model.grip:
            yield number, grip


def tool_bodies(model: RobotModel) -> list[ConvexBody]:
    """Return the bodies of the tool, in the last joint's frame; without a tool, of the last link."""
    last = (part.body for part in model.parts if part.joint == model.dof - 1)
    return own_bodies(model) or list(last)


def tool_heights(model: RobotModel, tip: Transform) -> Array:
    """Return the heights of the corners of a tool along the z axis of one of its frames [m].

    Args:
        model: of the robot.
        tip: pose of the frame in the last joint's.

    Returns:
        Shape (corners,); what is behind the frame is negative.
    """
    corners = np.vstack([body.vertices for body in tool_bodies(model)])
    return np.asarray((corners - tip[:3, 3]) @ tip[:3, 2])


def describe_tool_overhang(
    robot: PlacedRobot, shape: Shape, grip: Grip, frame: str
) -> str:
    """Return in words by how much a tool extends beyond the part that it grips.

    What is beyond the part meets whatever the part lies on.

    Args:
        robot: with its tool.
        shape: of the part.
        grip: of the robot's tool frame on it.
        frame: name of that frame.

    Returns:
        Empty where the tool does not reach farther along its z axis.
    """
    tip = robot.model.frame_in_last_joint(frame)
    ahead = float(tool_heights(robot.model, tip).max())
    corners = np.vstack([piece.vertices for piece in shape.pieces])
    along = (corners - grip.pose[:3, 3]) @ grip.pose[:3, 2]
    below, thick = float(along.max()), float(np.ptp(along))
    if ahead <= below:
        return ""
    depth = math.floor(1e3 * (thick - ahead)) - 1
    remedy = "move the tcp nearer to the tips"
    if depth >= _LEAST_DEPTH_MM:
        remedy = f"grips: {{depth_m: {1e-3 * depth:g}}} takes it higher"
    return (
        f"; the tool reaches {1e3 * ahead:.1f} mm beyond its tcp, the part {1e3 * below:.1f} mm:"
        f" {remedy}"
    )


def least_thickness(shape: Shape) -> float:
    """Return the least thickness of a shape's pieces along the axes of its frame [m]."""
    return min(float(np.min(2.0 * piece.half)) for piece in shape.pieces)


def explain_missing_grip(
    robot: PlacedRobot,
    shape: Shape,
    rules: GripRules,
    poses: Sequence[Transform] = (),
) -> str:
    """Return in words why a robot has no grip on a part, with its tool by name."""
    grip = robot.model.grip
    own = robot_rules(rules, robot)
    name = "the tool" if grip is None else f"its tool {grip.tool}"
    shortest, longest = 1e3 * least_thickness(shape), 1e3 * float(max(shape.size))
    most, least = 1e3 * own.opening, 1e3 * own.least_opening
    if own.opening == 0.0:
        return f"{name} holds nothing (opening_m is 0)"
    wide = (
        describe_too_wide_cups(shape, poses[0], poses[-1], own)
        if own.suction and poses
        else None
    )
    if wide is not None:
        return f"{name}: {wide}"
    if shortest > most:
        return (
            f"{name} opens to {most:.1f} mm, and the shortest edge is {shortest:.1f} mm"
        )
    if longest < least:
        return (
            f"{name} closes to {least:.1f} mm, and the longest edge is {longest:.1f} mm"
        )
    return "no face can be gripped both at its start and at its goal"


def explain_overload(robot: PlacedRobot, part: CellObject) -> str | None:
    """Return why a part is too heavy for a robot, None where it is not."""
    drives = robot.model.drives
    if drives is None or part.mass <= drives.spare:
        return None
    return (
        f"it may carry {drives.spare:.3g} kg beside its tool, and {part.name} weighs"
        f" {part.mass:g} kg"
    )


def explain_tool_misfit(
    robot: PlacedRobot, frame: str, part: CellObject, grip: Grip, approach: float
) -> Obstruction | None:
    """Return why a robot's tool cannot hold a part by a grip, None where it can.

    The body of the tool, with its fingers open as described, would overlap the part on the straight path to the
    grip. Boxes are not checked for robot models with a built-in tool, whose fingers adapt to the box.

    Args:
        robot: the robot.
        frame: name of the tool frame.
        part: the part.
        grip: the grip.
        approach: length of the straight path to it [m].
    """
    if part.shape.is_box and robot.model.grip is None:
        return None
    tip, model = robot.model.frame_in_last_joint(frame), robot.model
    about = tip, part.shape, grip.pose, approach
    key = (model, tip.tobytes(), part.shape, grip.pose.tobytes(), approach)
    depth = _DEPTHS.get(key, lambda: _depth(model, *about))
    if depth <= MOST_OVERLAP:
        return None
    return Obstruction(
        f"the tool of {robot.name} would be {depth * 1e3:.1f} mm in {part.name}, open as it is held, and"
        f" may be {MOST_OVERLAP * 1e3:g} mm: hold its fingers farther apart (joints of the tool), or let it"
        " grip where the part is thinner"
    )


def describe_missed_contact(
    robot: PlacedRobot, part: CellObject, grip: Grip, rules: GripRules
) -> str | None:
    """Return in words why a robot's tool would not have the contact with a part that a grip needs.

    Args:
        robot: the robot.
        part: the part.
        grip: the grip.
        rules: of the assembly, where the tool has none of its own.

    Returns:
        None where it would, or where its shapes do not show this.
    """
    own, tip = (
        tool_rules(rules, robot.model.grip),
        robot.model.frame_in_last_joint(rules.frame),
    )
    about = robot.model, tip, part.name, part.shape, grip.pose
    return explain_not_held(*about, suction=own.suction)


def _depth(
    model: RobotModel, tip: Transform, shape: Shape, grip: Transform, approach: float
) -> float:
    """Return the penetration depth of a tool in a part on the straight path to a grip [m]."""
    hull = [resting_solid("part", piece, np.eye(4)) for piece in shape.pieces]
    still = [
        (solid, place_at_middle(solid, _NO_JOINTS, _NO_JOINTS)[0]) for solid in hull
    ]
    deepest = 0.0
    for share in np.linspace(0.0, 1.0, _SAMPLES).tolist():
        at = grip @ translation(0.0, 0.0, -share * approach) @ inverse(tip)
        for body in own_bodies(model):
            moved = Solid("tool", body, at)
            pose = place_at_middle(moved, _NO_JOINTS, _NO_JOINTS)[0]
            low, high = moved.vertices.min(axis=0), moved.vertices.max(axis=0)
            if np.any(low > shape.high) or np.any(high < shape.low):
                continue
            gaps = [hull_distance(moved, pose, other, where) for other, where in still]
            deepest = max(deepest, -min(gaps))
    return deepest
