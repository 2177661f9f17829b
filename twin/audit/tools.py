"""Tools that robots change: each on its own robot or in its rack, one on a robot at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from planning.cell.robot_model import ToolGrip
from planning.cell.workcell import PlacedRobot
from planning.transforms import Array, Transform
from twin.audit.motion.executed import ObjectRow, Recording
from twin.audit.places import PLACED, distance_of
from twin.audit.violation import Violation
from twin.audit.wanted import ChangedTool, Wanted
from twin.audit.worlds.world import AuditWorld, WatchedShape

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


def tool_on(
    wanted: Wanted, rows: Mapping[str, ObjectRow], robot: str
) -> ChangedTool | None:
    """Return which of the tools that a robot changes it has on it, None for none."""
    for tool in wanted.tools:
        row = rows.get(tool.name)
        if tool.robot == robot and row is not None and row.holder == robot:
            return tool
    return None


def hand_of(
    world: AuditWorld,
    robot: int,
    q: Array,
    rows: Mapping[str, ObjectRow],
    wanted: Wanted,
) -> Hand:
    """Return what a robot holds with where it stands at ``q``, and put it there.

    Args:
        world: to measure in.
        robot: index of the robot.
        q: its configuration, shape (n,).
        rows: where every object is then.
        wanted: says which tools are changed.
    """
    world.configure(robot, q)
    placed = world.cell.robots[robot]
    tool = tool_on(wanted, rows, placed.name)
    if tool is None:
        changes = any(item.robot == placed.name for item in wanted.tools)
        grip = WITHOUT if changes else placed.model.grip
        return Hand(tool_shapes(world, robot), grip, placed.model.frames)
    pose = flange_poses(world, robot, q[None])[0] @ rows[tool.name].pose
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


def flange_poses(world: AuditWorld, robot: int, q: Array) -> Array:
    """Return where a robot's flange is at configurations, shape (m, 4, 4)."""
    rotation, position = world.link_frames(robot, q)
    out = np.tile(np.eye(4), (len(q), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = rotation[:, -1], position[:, -1]
    return np.asarray(out @ world.cell.robots[robot].model.flange)


def tool_violations(
    world: AuditWorld, recording: Recording, wanted: Wanted
) -> Iterator[Violation]:
    """Yield tools that are neither in their rack nor, as they are mounted, on their robot.

    Args:
        world: says where flanges are.
        recording: what was executed.
        wanted: the tools.
    """
    for tool in wanted.tools:
        rows = [row for row in recording.objects if row.object == tool.name]
        for k, row in enumerate(rows):
            until = rows[k + 1].t if k + 1 < len(rows) else recording.end
            words, away = _wrong(world, recording, tool, row)
            if words and (until > row.t or k + 1 == len(rows)):
                other = row.holder or "rack"
                yield Violation(row.t, until, tool.name, other, away, words, "tool")
    for robot in dict.fromkeys(tool.robot for tool in wanted.tools):
        yield from _one_at_a_time(recording, wanted, robot)


def _wrong(
    world: AuditWorld, recording: Recording, tool: ChangedTool, row: ObjectRow
) -> tuple[str, float]:
    """Return what is wrong with where a tool is, empty if nothing is, and by how much [m]."""
    item = world.cell.object(tool.name)
    if row.holder is not None:
        if row.holder != tool.robot:
            return f"is a tool of {tool.robot}", 0.0
        away = distance_of(item, row.pose, tool.mount)
        return _far("as it is mounted", away), away
    away = distance_of(item, row.pose, tool.rack)
    if away > PLACED and row.t == 0.0 and tool.first:
        names = [robot.name for robot in world.cell.robots]
        q = recording.robots[tool.robot].q[:1]
        hand = flange_poses(world, names.index(tool.robot), q)[0]
        away = min(away, distance_of(item, row.pose, hand @ tool.mount))
    return _far("its rack", away), away


def _far(place: str, away: float) -> str:
    return f"is {away * 1e3:.2f} mm off {place}" if away > PLACED else ""


def _one_at_a_time(
    recording: Recording, wanted: Wanted, robot: str
) -> Iterator[Violation]:
    names = {tool.name for tool in wanted.tools if tool.robot == robot}
    on_it: list[str] = []
    for row in recording.objects:
        if row.object not in names:
            continue
        if row.object in on_it:
            on_it.remove(row.object)
        if row.holder == robot:
            on_it.append(row.object)
        if len(on_it) > 1:
            words = f"is on {robot} along with {on_it[0]}"
            yield Violation(row.t, row.t, row.object, robot, 0.0, words, "tool")
