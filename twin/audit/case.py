"""What rules of the audit look at: an execution, its plan, what was wanted, a world to measure in."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.cell.robot_model import ToolGrip
from planning.cell.workcell import PlacedRobot
from planning.transforms import Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audit.motion.executed import Recording, ReplayedRun
from twin.audit.order import NodeSpans, moved_spans
from twin.audit.wanted import ChangedTool, Wanted
from twin.audit.worlds.world import AuditWorld, WatchedShape, shapes_by_entity

_WITHOUT = ToolGrip((0.0, 0.0), "no tool")
"""How a robot holds that has left its tool in the rack."""


@dataclass(frozen=True)
class Hand:
    """Tool that a robot holds with at a moment.

    Attributes:
        shapes: of its tool, in their places.
        grip: how that holds; None where nobody says.
        frames: tool frames, each a pose in the flange frame.
        opening: how far the fingers stand open [m].
    """

    shapes: list[WatchedShape]
    grip: ToolGrip | None
    frames: Mapping[str, Transform]
    opening: float

    def closes_by(self, shape: WatchedShape) -> float:
        """Return how far each finger closes on the thinnest edge of a shape at most [m]."""
        return max(0.0, 0.5 * (self.opening - 2.0 * float(np.min(shape.half))))


class AuditCase(ReplayedRun):
    """An execution with all that it is judged by.

    Args:
        world: to measure in.
        tpg: what was to be executed.
        recording: what was executed.
        wanted: what the scenario says of places and of what holds them.
        logged: when nodes were started and completed, by robot or machine; empty where no log says
            so.

    Attributes:
        world, tpg, wanted, logged: see there.
        moved: when robots moved in their nodes, by robot.
        shapes: of each fixture and object, by name.
        numbers: indices of the robots, by name.
    """

    def __init__(
        self,
        world: AuditWorld,
        tpg: TemporalPlanGraph,
        recording: Recording,
        wanted: Wanted | None = None,
        logged: Mapping[str, NodeSpans] | None = None,
    ) -> None:
        super().__init__(tpg.cell, recording)
        self.world, self.tpg = world, tpg
        self.wanted, self.logged = wanted or Wanted(), logged or {}
        self.moved = moved_spans(tpg, self.robots)
        self.shapes = shapes_by_entity((*world.fixtures, *world.objects))
        self.numbers = {robot.name: k for k, robot in enumerate(self.cell.robots)}

    @cached_property
    def reaches(self) -> Mapping[str, float]:
        """How far each fixture and object reaches from its frame at most, by name [m]."""
        return {
            name: max(
                float(np.linalg.norm(shape.at(np.eye(4))[:3, 3]))
                + float(np.linalg.norm(shape.centre))
                + shape.radius
                for shape in shapes
            )
            for name, shapes in self.shapes.items()
        }

    def flange(self, robot: str, t: float) -> Transform:
        """Return where the flange of a robot is at a time [s]."""
        q = self.robots[robot].at(np.array([t]))
        (pose,) = self.world.flange_poses(self.numbers[robot], q)
        return np.asarray(pose)

    def put(self, name: str, pose: Transform) -> list[WatchedShape]:
        """Put a fixture or an object somewhere in the world; return its shapes."""
        for shape in self.shapes[name]:
            self.world.place(shape, shape.at(pose))
        return self.shapes[name]

    def tool_on(self, robot: str, t: float) -> ChangedTool | None:
        """Return which of the tools that a robot changes it has on it at a time, None for none."""
        for tool in self.wanted.tools:
            stay = self.place(tool.name, t)
            if tool.robot == robot and stay is not None and stay.holder == robot:
                return tool
        return None

    def hand(self, robot: str, t: float) -> Hand:
        """Return what a robot holds with where it is at a time [s], and put it there."""
        placed, number = self.cell.robot(robot), self.numbers[robot]
        self.world.configure(number, self.robots[robot].at(np.array([t]))[0])
        tool = self.tool_on(robot, t)
        stay = None if tool is None else self.place(tool.name, t)
        if tool is not None and stay is not None:
            shapes = self.put(tool.name, self.flange(robot, t) @ stay.pose)
            grip, frames = tool.grip, tool_frames(placed, tool)
        else:
            changes = any(tool.robot == robot for tool in self.wanted.tools)
            grip = _WITHOUT if changes else placed.model.grip
            shapes, frames = self.world.tool_shapes(number), placed.model.frames
        opening = self.wanted.opening_m
        if grip is not None:
            opening = 0.0 if grip.opening is None else grip.opening[1]
        return Hand(shapes, grip, frames, opening)


def tool_frames(robot: PlacedRobot, tool: ChangedTool) -> Mapping[str, Transform]:
    """Return the frames of a tool on a robot, each a pose in the flange frame."""
    first = f"{tool.name}/"
    frames = robot.model.frames.items()
    return {k.removeprefix(first): pose for k, pose in frames if k.startswith(first)}
