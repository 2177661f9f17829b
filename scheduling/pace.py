"""How fast robots may pass their nodes with what they have in their hands.

A stretch is passed as slowly as the fastest point of it asks for; a skill, whose path is followed by
one clock, is slowed down as a whole.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import PlacedRobot
from planning.kinematics.chain import joint_table
from planning.timing.smooth_path import SmoothPath
from planning.timing.stretch import Stretch, straight_stretch
from planning.timing.tool_speed import greatest_tool_speed, tool_speed_along
from planning.transforms import Array
from scheduling.graph.drive import BY_JOINTS, BY_TOOL_SPEED
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.hand_loads import HandLoad, HandLoads, hand_loads

_SAME = 1.0 + 1e-9
"""Times that differ by a smaller factor are the same."""


@dataclass(frozen=True)
class Slowing:
    """By how much a motion is slower than the limits of its joints allow, and for what.

    Attributes:
        factor: how many times as long it takes.
        cause: what asks for that, see ``Drive.slowed_by``.
    """

    factor: float = 1.0
    cause: int = BY_JOINTS


class Pace:
    """How fast one robot may pass the nodes of its chain.

    Args:
        robot: of the cell.
        limits: that it keeps to.
        loads: what it has in its hand; None where nothing but limits of joints bounds its motions.
    """

    def __init__(
        self, robot: PlacedRobot, limits: MotionLimits, loads: HandLoads | None
    ) -> None:
        self.limits = limits
        self._robot, self._loads = robot, loads
        self._joints = joint_table(robot.model)

    def stretch(self, node: int, start: Array, way: Array) -> tuple[Stretch, Slowing]:
        """Return how a stretch is passed.

        Args:
            node: its first.
            start: where it begins, shape (n,).
            way: from there to its end, shape (n,).
        """
        free = straight_stretch(self.limits, way)
        if self._loads is None:
            return free, Slowing()
        load = self._loads.after(node, 0)
        cap = self._tool_speed(load)
        if np.isinf(cap) or free.cruise <= 0.0:
            return free, Slowing()
        tip = self._tip(load)
        seconds = tool_speed_along(self._joints, tip, start, way) / cap
        if seconds <= free.cruise:
            return free, Slowing()
        found = straight_stretch(self.limits, way, seconds)
        # Over a short way full speed may never be reached, with the limit or without.
        longer = found.seconds / free.seconds
        return found, Slowing(longer, BY_TOOL_SPEED) if longer > _SAME else Slowing()

    def skill(self, node: int, motion: SmoothPath) -> Slowing:
        """Return by how much a skill is slowed down.

        Args:
            node: of the skill.
            motion: its quickest motion within the limits of joints.
        """
        slowing = Slowing()
        if self._loads is None:
            return slowing
        for begin, end, load in self._loads.runs(node, len(motion.passed)):
            cap = self._tool_speed(load)
            times = motion.passed[[begin, end]]
            low, high = np.searchsorted(motion.t, times).tolist()
            if np.isinf(cap) or high <= low:
                continue
            rows = slice(low, high + 1)
            speed = greatest_tool_speed(
                self._joints,
                self._tip(load),
                motion.t[rows],
                motion.q[rows],
                motion.v[rows],
                motion.a[rows],
            )
            if speed > cap * slowing.factor:
                slowing = Slowing(speed / cap, BY_TOOL_SPEED)
        return slowing

    def _tool_speed(self, load: HandLoad) -> float:
        if not load.parts:
            return self.limits.tool_speed
        return min(self.limits.tool_speed, self.limits.loaded_tool_speed)

    def _tip(self, load: HandLoad) -> Array:
        """Return the point of the tool in the last joint's frame; without a tool, of the flange."""
        model = self._robot.model if load.tool is None else load.tool.model
        frame = model.frames.get("tool")
        pose = model.flange if frame is None else model.flange @ frame
        return np.asarray(pose[:3, 3])


def paces(tpg: TemporalPlanGraph) -> Iterator[Pace | None]:
    """Yield the pace of each chain's robot; None where it keeps to no limits, and for machines."""
    limited = {robot.name: robot for robot in tpg.cell.robots}
    bounded = any(_is_bounded(robot) for robot in tpg.cell.robots)
    loads = hand_loads(tpg) if bounded else [None] * len(tpg.chains)
    for chain, own in zip(tpg.chains, loads, strict=True):
        robot = limited.get(chain.robot)
        if robot is None or robot.limits is None:
            yield None
        else:
            yield Pace(robot, robot.limits, own)


def _is_bounded(robot: PlacedRobot) -> bool:
    """Tell whether anything but limits of joints bounds the motions of a robot."""
    limits = robot.limits
    return limits is not None and bool(
        np.isfinite([limits.tool_speed, limits.loaded_tool_speed]).any()
    )
