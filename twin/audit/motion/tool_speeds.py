"""How fast tools were in what was executed, of robots for which that is limited."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.workcell import PlacedRobot, Workcell
from planning.transforms import Array
from twin.audit.motion.described_arm import DescribedArm
from twin.audit.motion.executed import Recording
from twin.audit.motion.states import moving_samples, states_at


@dataclass(frozen=True, eq=False)
class ToolSpeeds:
    """Speeds of a robot's tool while it holds the same.

    Attributes:
        robot: its name.
        t: times, shape (m,) [s].
        speed: of the tool's frame then, of the flange where there is none, shape (m,) [m/s].
        limit: for what it holds [m/s].
        loaded: whether it holds a part.
    """

    robot: str
    t: Array
    speed: Array
    limit: float
    loaded: bool


def tool_speeds_of_run(cell: Workcell, recording: Recording) -> Iterator[ToolSpeeds]:
    """Yield the speeds of all tools whose speed is limited, from change to change of what is held.

    Args:
        cell: says which robots have limits, and where their tools are.
        recording: what was executed.
    """
    for robot in cell.robots:
        limits, rows = robot.limits, recording.robots[robot.name]
        if limits is None or rows.v is None or len(rows.t) < 2:
            continue
        if np.isinf(min(limits.tool_speed, limits.loaded_tool_speed)):
            continue
        arm, tools = DescribedArm(robot.model), {tool.name for tool in robot.tools}
        changes = [(row.t, row.object, row.holder) for row in recording.objects]
        held: set[str] = set()
        ends = {float(rows.t[0]), float(rows.t[-1]), *(t for t, _, _ in changes)}
        for begin, end in pairwise(sorted(ends)):
            while changes and changes[0][0] <= begin:
                _, name, holder = changes.pop(0)
                held.discard(name)
                if holder == robot.name:
                    held.add(name)
            loaded = bool(held - tools)
            limit = limits.tool_speed
            if loaded:
                limit = min(limit, limits.loaded_tool_speed)
            if np.isfinite(limit):
                t = moving_samples(rows, begin, end)
                q, v, _ = states_at(rows, t)
                speed = arm.point_speeds(q, v, _tip(robot, held))
                yield ToolSpeeds(robot.name, t, speed, limit, loaded)


def _tip(robot: PlacedRobot, held: set[str]) -> Array:
    """Return the origin of the tool's frame in the last joint's, shape (3,) [m]."""
    worn = [tool.model for tool in robot.tools if tool.name in held]
    model = worn[0] if worn else robot.model
    frame = model.frames.get("tool", np.eye(4))
    return np.asarray((model.flange @ frame)[:3, 3])
