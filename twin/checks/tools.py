"""Checks of tools: finger openings, tool frames, flange axes, suction tools, and collision shapes."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.spatial import ConvexHull

from planning.cell.body import ConvexBody
from planning.cell.cover import box_body
from planning.cell.robot_model import RobotModel
from planning.geometry.exact import Solid, hull_distance_at
from planning.grips.pads import finger_sides
from planning.grips.tool_grips import tool_bodies, tool_heights
from planning.robots.descriptions.xml_files import read_xml
from planning.transforms import Array, read_only_copy, translation
from twin.checks.finding import CheckContext, Finding, Findings, format_millimetres
from twin.checks.overview import flange_warning, robot_overview

_FAR = 0.02
"""A tool frame is at the tool if it is no farther from it than this [m]."""

_IN_FRONT, _SHARE = 0.01, 1.0 / 3.0
"""Largest extent of a tool in front of its frame [m], and as a share of that behind it."""

_PLAY = 0.001
"""Openings that differ by less are the same [m]."""

_DRAWN = 0.05
"""Tolerance of finger positions as a share of the opening, each by no more than ``_PLAY``."""

_ALONG = 0.7
"""A tool whose z axis is so much along the axis of the last joint points out of its flange."""

_NOWHERE = np.zeros(0)

_MOST_NAMED = 4
"""Most joints that a message names."""


def check_tool_frames(subject: CheckContext) -> Findings:
    """Yield tool frames that are off the tool, or do not point out of it."""
    seen: set[tuple[str, bytes]] = set()
    for name, frame, holds in subject.checks.tool_frames():
        robot = subject.cell.robot(name)
        model = robot.model
        # Another tool that the robot takes may have it.
        for own in (model, *(tool.model for tool in robot.tools)):
            if frame in own.frames:
                model = own
                break
        if frame != "flange" and frame not in model.frames:
            choices = ", ".join(("flange", *model.frames))
            yield Finding(
                subject.robot_at(name, "frames", "model"),
                f"{name} ({model.name}) has no frame {frame!r} (valid: {choices})",
                error=True,
            )
            continue
        pose = np.eye(4) if frame == "flange" else model.frames[frame]
        key = (model.name, pose.tobytes())
        if key in seen:
            continue
        seen.add(key)
        at = subject.robot_at(name, "frames", "model")
        if not holds and tool_bodies(model):
            heights = tool_heights(model, model.flange @ pose)
            if float(heights.max()) < -_FAR:
                continue  # target of a camera or a nozzle
        for words in frame_warnings(model, read_only_copy(pose)):
            yield Finding(at, f"frame {frame!r} of {name} ({model.name}) {words}")


def check_flanges(subject: CheckContext) -> Findings:
    """Yield flanges whose outward axis is not z, unless the tool's mount corrects it."""
    for robot in subject.distinct_robots:
        model = robot.model
        doubt = flange_warning(model)
        pose = model.flange @ model.frames.get("tool", np.eye(4))
        along = abs(float(pose[:3, 2] @ model.chain.axis[-1]))
        if doubt is not None and along < _ALONG:
            at = subject.robot_at(robot.name, "flange", "model")
            yield Finding(at, f"flange of {robot.name} ({model.name}): {doubt}")


def check_suction(subject: CheckContext) -> Findings:
    """Yield suction tools whose descriptions have moving fingers."""
    everywhere = subject.checks.by_suction
    for robot in subject.distinct_robots:
        model = robot.model
        suction = everywhere if model.grip is None else model.grip.suction
        fingers = _moving_fingers(model) if suction else []
        if len(fingers) > 1:
            tool = "its tool" if model.grip is None else model.grip.tool
            said = "assembly.grips" if model.grip is None else f"cell.tools.{tool}"
            yield Finding(
                subject.robot_at(robot.name, "tool", "model"),
                f"{tool} of {robot.name} is said to hold by suction ({said}.suction), at one face, and its"
                f" description has {len(fingers)} joints that move ({', '.join(fingers[:_MOST_NAMED])}), as those of"
                " fingers are: give opening_m in place of suction, or the description of a cup",
            )


def _moving_fingers(model: RobotModel) -> list[str]:
    """Return the movable joints of a tool's description that are held here."""
    seen = robot_overview(model)
    links = {row.joint for row in seen.links if row.group == "tool"}
    kinds = {
        str(joint.get("name")): joint.get("held") or joint.get("type")
        for joint in read_xml(model.urdf).findall("joint")
    }
    return [name for name, kind in kinds.items() if name in links and kind != "fixed"]


def check_openings(subject: CheckContext) -> Findings:
    """Yield fingers held farther apart than they open, or closer than the width of parts."""
    for robot in subject.distinct_robots:
        model = robot.model
        if model.grip is None or model.grip.opening in (None, (0.0, 0.0)):
            continue
        least, most = model.grip.opening
        gap = finger_gap(model, model.frames.get("tool", np.eye(4)))
        tool, at = model.grip.tool, subject.robot_at(robot.name, "tool", "model")
        if gap is None:
            if has_fingers(model):
                continue  # the tcp is off them: checked with parts
            yield Finding(
                at,
                f"there is nothing of {tool} on both sides of its tcp along the axis in which its fingers"
                " close: its description has no fingers, or 'tcp' or 'closing' is wrong (twin robots"
                " shows where everything is)",
            )
        elif gap > most + _play(most) or gap < least - _play(most):
            yield Finding(
                at,
                f"the fingers of {tool} are held {format_millimetres(gap)} apart, and opening_m is"
                f" {format_millimetres(least)} to {format_millimetres(most)}: one of the two is wrong, or 'closing' is"
                " across the fingers",
            )


def has_fingers(model: RobotModel) -> bool:
    """Return whether a tool has fingers on both sides of its tcp."""
    tip = model.flange @ model.frames.get("tool", np.eye(4))
    return finger_sides(model, tip) is not None


def _play(opening: float) -> float:
    """Return the tolerance of finger positions at an opening [m]."""
    return max(_PLAY, min(2.0 * _PLAY, _DRAWN * opening))


def finger_gap(model: RobotModel, frame: Array) -> float | None:
    """Return the gap of a tool's fingers in its description [m].

    Measured along y through the middle of a tool frame, a pose in the flange frame; None where
    there are no bodies on both sides.
    """
    tip = model.flange @ frame
    before, behind = -np.inf, np.inf
    for body in tool_bodies(model):
        span = _span_along(body, tip[:3, 3], tip[:3, 1])
        if span is None:
            continue
        low, high = span
        if low > 0.0:
            behind = min(behind, low)
        elif high < 0.0:
            before = max(before, high)
        else:
            return 0.0  # the frame is in a finger
    gap = behind - before
    return float(gap) if np.isfinite(gap) else None


def _span_along(
    body: ConvexBody, at: Array, direction: Array
) -> tuple[float, float] | None:
    """Return the interval of a line inside a body, measured from ``at``; None if it misses."""
    planes = ConvexHull(body.vertices).equations
    slope, height = planes[:, :3] @ direction, planes[:, :3] @ at + planes[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        where = -height / slope
    if np.any(height[np.abs(slope) < 1e-12] > 0.0):
        return None
    low = float(np.max(where[slope < -1e-12], initial=-np.inf))
    high = float(np.min(where[slope > 1e-12], initial=np.inf))
    return (low, high) if low <= high else None


def frame_warnings(model: RobotModel, frame: Array) -> Iterator[str]:
    """Yield warnings about a frame, a pose in the flange frame."""
    bodies = tool_bodies(model)
    if not bodies:
        return
    tip = model.flange @ frame
    # Hulls need a volume.
    grain = box_body("tip", (1e-5, 1e-5, 1e-5))
    point = Solid("tip", grain, read_only_copy(translation(*tip[:3, 3])))
    gaps = [
        hull_distance_at(point, _NOWHERE, Solid(body.name, body, np.eye(4)), _NOWHERE)
        for body in bodies
    ]
    nearest = int(np.argmin(gaps))
    between = 0.5 * (finger_gap(model, frame) or 0.0)
    opening = None if model.grip is None else model.grip.opening
    apart = 0.0 if opening is None else 0.5 * opening[1]
    if gaps[nearest] > max(_FAR + apart, between + _PLAY):
        yield (
            f"is {format_millimetres(gaps[nearest])} away from the tool (nearest: {bodies[nearest].name}):"
            " parts would hang beside it; give the robot 'frames' with the point between its fingers,"
            " or a description with the tool on its flange"
        )
        return
    heights = tool_heights(model, tip)
    front, behind = float(heights.max()), float(-heights.min())
    if front <= _IN_FRONT or front <= _SHARE * behind:
        return
    if behind <= _SHARE * front:
        yield (
            f"lies behind the tool, {format_millimetres(front)} of which are in front of it along z: parts"
            " would be held in the middle of it; give the robot 'frames' with the point between its"
            " fingers"
        )
    else:
        yield (
            f"does not point out of the tool: {format_millimetres(front)} of it are in front of the frame"
            f" along z and {format_millimetres(behind)} behind, so parts would be held at its side; z must"
            " point out of the hand (fingers close along y): give the robot 'frames' with another"
            " rpy_deg"
        )


def check_descriptions(subject: CheckContext) -> Findings:
    """Yield collision shapes without volume, and likely wrong units in descriptions."""
    for robot in subject.distinct_robots:
        found = robot_overview(robot.model)
        for words in (*found.left_out, *found.doubts):
            at = subject.robot_at(robot.name, "model")
            yield Finding(at, f"{robot.name}: {words}")
