"""Tools that robots change: each on its own robot or in its rack, one on a robot at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from planning.cell.robot_model import ToolGrip
from planning.cell.workcell import PlacedRobot
from planning.transforms import Transform
from twin.audit.motion.replay import Replay, Stay
from twin.audit.places import PLACED, distance_of
from twin.audit.violation import Violation
from twin.audit.wanted import ChangedTool, Wanted
from twin.audit.worlds.world import AuditWorld, WatchedShape, flange_poses

WITHOUT = ToolGrip((0.0, 0.0), "no tool")
"""How a robot holds that has left its tool in the rack."""


@dataclass(frozen=True)
class Hand:
    """Tool that a robot holds with at a moment.

    Attributes:
        shapes: of its tool, in their places.
        grip: how that holds; None where nobody says.
        frames: tool frames, each a pose in the flange frame.
    """

    shapes: list[WatchedShape]
    grip: ToolGrip | None
    frames: Mapping[str, Transform]

    def opening(self, otherwise: float) -> float:
        """Return how far the fingers stand open [m].

        Args:
            otherwise: what the scenario says of tools that come with their robots [m].
        """
        if self.grip is None:
            return otherwise
        return 0.0 if self.grip.opening is None else self.grip.opening[1]


def tool_on(wanted: Wanted, replay: Replay, robot: str, t: float) -> ChangedTool | None:
    """Return which of the tools that a robot changes it has on it at a time, None for none."""
    for tool in wanted.tools:
        if tool.robot == robot:
            stay = replay.place(tool.name, t)
            if stay is not None and stay.holder == robot:
                return tool
    return None


def hand_at(
    world: AuditWorld, replay: Replay, wanted: Wanted, robot: int, t: float
) -> Hand:
    """Return what a robot holds with where it is at a time, and put it there.

    Args:
        world: to measure in.
        replay: what was executed.
        wanted: says which tools are changed.
        robot: index of the robot.
        t: when [s].
    """
    placed = world.cell.robots[robot]
    q = replay.robots[placed.name].at(np.array([t]))
    world.configure(robot, q[0])
    tool = tool_on(wanted, replay, placed.name, t)
    if tool is None:
        changes = any(item.robot == placed.name for item in wanted.tools)
        grip = WITHOUT if changes else placed.model.grip
        return Hand(tool_shapes(world, robot), grip, placed.model.frames)
    stay = replay.place(tool.name, t)
    assert stay is not None
    pose = flange_poses(world, robot, q)[0] @ stay.pose
    shapes = [shape for shape in world.objects if shape.entity == tool.name]
    for shape in shapes:
        world.place(shape, shape.at(pose))
    return Hand(shapes, tool.grip, tool_frames(placed, tool))


def tool_frames(robot: PlacedRobot, tool: ChangedTool) -> Mapping[str, Transform]:
    """Return the frames of a tool on a robot, each a pose in the flange frame."""
    first = f"{tool.name}/"
    frames = robot.model.frames.items()
    return {k.removeprefix(first): pose for k, pose in frames if k.startswith(first)}


def tool_shapes(world: AuditWorld, robot: int) -> list[WatchedShape]:
    """Return the shapes of a robot's tool; of its outermost link, where it has none."""
    own = [shape for shape in world.robot_shapes if shape.robot == robot]
    tool = [shape for shape in own if shape.entity.endswith("/tool")]
    last = max(shape.joint for shape in own)
    return tool or [shape for shape in own if shape.joint == last]


def tool_violations(
    world: AuditWorld, replay: Replay, wanted: Wanted
) -> Iterator[Violation]:
    """Yield tools that are neither in their rack nor, as they are mounted, on their robot.

    A robot has one of them on it at a time.

    Args:
        world: says where flanges are.
        replay: what was executed.
        wanted: the tools.
    """
    for tool in wanted.tools:
        for stay in replay.stays[tool.name]:
            words, away = _wrong(world, replay, tool, stay)
            if words and stay.until > stay.t:
                times, other = (stay.t, min(stay.until, replay.end)), stay.holder
                yield Violation(*times, tool.name, other or "rack", away, words, "tool")
    owners = {tool.name: tool.robot for tool in wanted.tools}
    on_it: dict[str, list[str]] = {robot: [] for robot in owners.values()}
    for stay in replay.in_order:
        robot = owners.get(stay.object)
        if robot is None:
            continue
        if stay.object in on_it[robot]:
            on_it[robot].remove(stay.object)
        if stay.holder == robot:
            on_it[robot].append(stay.object)
        if len(on_it[robot]) > 1:
            words = f"is on {robot} along with {on_it[robot][0]}"
            yield Violation(stay.t, stay.t, stay.object, robot, 0.0, words, "tool")


def _wrong(
    world: AuditWorld, replay: Replay, tool: ChangedTool, stay: Stay
) -> tuple[str, float]:
    """Return what is wrong with where a tool is, empty if nothing is, and by how much [m]."""
    item = world.cell.object(tool.name)
    if stay.holder is not None:
        if stay.holder != tool.robot:
            return f"is a tool of {tool.robot}", 0.0
        away = distance_of(item, stay.pose, tool.mount)
        return _far("as it is mounted", away), away
    away = distance_of(item, stay.pose, tool.rack)
    if away > PLACED and stay.t == 0.0 and tool.first:
        names = [robot.name for robot in world.cell.robots]
        q = replay.robots[tool.robot].q[:1]
        hand = flange_poses(world, names.index(tool.robot), q)[0]
        away = min(away, distance_of(item, stay.pose, hand @ tool.mount))
    return _far("its rack", away), away


def _far(place: str, away: float) -> str:
    return f"is {away * 1e3:.2f} mm off {place}" if away > PLACED else ""
