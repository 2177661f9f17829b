"""Speed and acceleration limits of robots along their paths with their current payload.

A straight piece of a path has the lowest speed limit of its points, and an acceleration within the effort
limits of the joints along all of it. A skill, such as a pick, has a given timing along its path, so it is
slowed down by one common factor.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.cell.workcell import PlacedRobot
from planning.kinematics.chain import joint_table
from planning.timing.blended_path import BlendedPath
from planning.timing.path_bounds import PathBounds
from planning.timing.smooth_path import SmoothPath
from planning.timing.stretch import (
    RoundedStretch,
    Stretch,
    rounded_stretch,
    straight_stretch,
)
from planning.timing.tool_speed import greatest_tool_speed, tool_speed_along
from planning.timing.torque import (
    ArmDynamics,
    HandPayload,
    TorqueScaling,
    explain_unchecked_efforts,
    torque_limited_stretch,
)
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import (
    BY_EFFORT,
    BY_JOINTS,
    BY_TOOL_SPEED,
    TemporalPlanGraph,
)
from scheduling.hand_loads import HandLoad, HandLoads, hand_loads

_SAME = 1.0 + 1e-9
"""Times that differ by a smaller factor are the same."""

_ROUNDING_S = 1e-9
"""By how much rounding may part the time of a row from that of its waypoint [s]."""


@dataclass(frozen=True)
class Slowing:
    """Factors by which a motion is slower than its joint limits allow, with their causes.

    Attributes:
        factor: how many times as long it takes.
        cause: what asks for that, see ``Drive.slowed_by``.
    """

    factor: float = 1.0
    cause: int = BY_JOINTS


class Pace:
    """Timing of the nodes of one robot's chain.

    Args:
        robot: of the cell.
        limits: that it keeps to.
        loads: its payloads.
    """

    def __init__(
        self, robot: PlacedRobot, limits: MotionLimits, loads: HandLoads
    ) -> None:
        self.limits = limits
        self._robot, self._loads = robot, loads
        self._joints = joint_table(robot.model)
        self._weighed = explain_unchecked_efforts(robot) is None
        self._dynamics: dict[HandLoad, ArmDynamics] = {}

    def stretch(
        self, node: int, start: Array, displacement: Array
    ) -> tuple[Stretch, Slowing]:
        """Return the timing of a stretch.

        Args:
            node: its first.
            start: where it begins, shape (n,).
            displacement: from there to its end, shape (n,).
        """
        free = found = straight_stretch(self.limits, displacement)
        slowing = Slowing()
        if free.cruise <= 0.0:
            return free, slowing
        load = self._loads.after(node, 0)
        seconds = self._tool_seconds(load, start, displacement)
        if seconds > 0.0:
            found = straight_stretch(self.limits, displacement, seconds)
            # Over a short way full speed may never be reached, with the limit or without.
            slowing = _slower(found.seconds / free.seconds, BY_TOOL_SPEED)
        if self._weighed:
            borne = self._dynamics_with(load).along_stretch(start, displacement, found)
            found = torque_limited_stretch(found, borne)
            slowing = _borne(slowing, borne, found.seconds / free.seconds)
        return found, slowing

    def full_speed_seconds(self, node: int, start: Array, displacement: Array) -> float:
        """Return the time of a straight line at the full speed of a path with rounded corners [s].

        At that speed the tool is not too fast anywhere on it, and joints can still bear that the robot
        speeds up and slows down.

        Args:
            node: the first of the way.
            start: where the line begins, shape (n,).
            displacement: from there to its end, shape (n,).
        """
        load = self._loads.after(node, 0)
        least = self._tool_seconds(load, start, displacement)
        seconds = straight_stretch(self.limits, displacement, least).cruise
        if self._weighed and seconds > 0.0:
            ends = np.array([start, start + displacement])
            line = BlendedPath(np.array([0.0, seconds]), ends, np.empty(0))
            bounds = self._dynamics_with(load).along_legs(line)
            seconds *= bounds.full_speed_factor()
        return seconds

    def rounded(self, node: int, path: BlendedPath) -> RoundedStretch | None:
        """Return the timing of a polyline with rounded corners, None where it is infeasible.

        Args:
            node: the first of the way.
            path: the polyline; its legs take as long as ``full_speed_seconds`` says, or longer.
        """
        return rounded_stretch(self.limits, path, self._bounds(node, path))

    def rounded_slowing(
        self, node: int, path: BlendedPath, found: RoundedStretch
    ) -> Slowing:
        """Return the slowdown of a polyline with rounded corners against joint limits alone.

        Args:
            node: the first of the way.
            path: the polyline.
            found: how it is passed.
        """
        bounds = self._bounds(node, path)
        if bounds is None:
            return Slowing()
        displacements, taken = np.diff(path.points, axis=0), np.diff(path.at)
        least = [
            straight_stretch(self.limits, displacement).cruise
            for displacement in displacements
        ]
        share = float(np.max(np.array(least) / taken))
        quick = BlendedPath(path.at * share, path.points, path.window * share)
        free = rounded_stretch(self.limits, quick)
        unweighed = rounded_stretch(self.limits, path, replace(bounds, efforts=None))
        assert free is not None
        assert unweighed is not None
        factor = found.seconds / free.seconds
        if found.seconds <= unweighed.seconds * _SAME or bounds.efforts is None:
            return _slower(factor, BY_TOOL_SPEED)
        joint = bounds.efforts.nearest(found.ramp, found.bent_ramp, found.cap)
        return _slower(factor, BY_EFFORT + joint)

    def _bounds(self, node: int, path: BlendedPath) -> PathBounds | None:
        """Return the bounds of a path with rounded corners besides joint limits, None for none."""
        load = self._loads.after(node, 0)
        cap = self._tool_speed(load)
        if not np.isfinite(cap) and not self._weighed:
            return None
        bent = path.bent_pieces()
        most = np.ones(len(bent.low))
        if np.isfinite(cap):
            tip = self._tip(load)
            for k, piece in enumerate(zip(bent.low, bent.high, strict=True)):
                ends = np.array(piece)
                speed = greatest_tool_speed(self._joints, tip, ends, *path.states(ends))
                most[k] = min(1.0, cap / max(speed, cap))
        if not self._weighed:
            return PathBounds(most)
        return PathBounds(most, self._dynamics_with(load).along_rounded(path, bent))

    def skill(self, node: int, motion: SmoothPath) -> Slowing:
        """Return the slowdown of a skill.

        Args:
            node: of the skill.
            motion: its quickest motion within the limits of joints.
        """
        slowing = Slowing()
        for begin, end, load in self._loads.runs(node, len(motion.passed)):
            # Where a load changes the robot is at rest, and there is a row.
            times = motion.passed[[begin, end]] - _ROUNDING_S
            low, high = np.searchsorted(motion.t, times).tolist()
            if high <= low:
                continue
            rows = slice(low, high + 1)
            cap = self._tool_speed(load)
            if np.isfinite(cap):
                own = (x[rows] for x in (motion.t, motion.q, motion.v, motion.a))
                speed = greatest_tool_speed(self._joints, self._tip(load), *own)
                if speed > cap * slowing.factor:
                    slowing = _slower(speed / cap, BY_TOOL_SPEED)
            if self._weighed:
                borne = self._dynamics_with(load).along_skill(motion, rows)
                slowing = _borne(slowing, borne, max(slowing.factor, borne.factor))
        return slowing

    def _dynamics_with(self, load: HandLoad) -> ArmDynamics:
        """Return the dynamics of the robot with its payload."""
        if load not in self._dynamics:
            model = self._robot.model if load.tool is None else load.tool.model
            held = [
                HandPayload(part.mass, part.shape, pose)
                for part, pose in load.parts
                if part.mass > 0.0
            ]
            self._dynamics[load] = ArmDynamics(self._robot, model, held)
        return self._dynamics[load]

    def _tool_speed(self, load: HandLoad) -> float:
        if not load.parts:
            return self.limits.tool_speed
        return min(self.limits.tool_speed, self.limits.loaded_tool_speed)

    def _tool_seconds(self, load: HandLoad, start: Array, displacement: Array) -> float:
        """Return the least time of a straight line by the tool speed limit, 0 for no limit [s]."""
        cap = self._tool_speed(load)
        if not np.isfinite(cap):
            return 0.0
        return (
            tool_speed_along(self._joints, self._tip(load), start, displacement) / cap
        )

    def _tip(self, load: HandLoad) -> Array:
        """Return the tool point in the last joint's frame; without a tool, that of the flange."""
        model = self._robot.model if load.tool is None else load.tool.model
        frame = model.frames.get("tool")
        pose = model.flange if frame is None else model.flange @ frame
        return np.asarray(pose[:3, 3])


def _slower(factor: float, cause: int) -> Slowing:
    return Slowing(factor, cause) if factor > _SAME else Slowing()


def _borne(slowing: Slowing, borne: TorqueScaling, factor: float) -> Slowing:
    """Return a slowed motion within effort limits.

    Args:
        slowing: by how much, and for what.
        borne: by how much it has to be slowed down for joints to bear it.
        factor: by how much it is slowed down then.
    """
    if borne.overloaded >= 0:
        return Slowing(factor, -1 - borne.overloaded)
    if slowing.cause < 0 or factor <= slowing.factor * _SAME:
        return slowing
    return Slowing(factor, BY_EFFORT + borne.joint)


def paces(tpg: TemporalPlanGraph) -> Iterator[Pace | None]:
    """Yield the pace of each chain's robot; None for robots without limits, and for machines."""
    robots = [tpg.cell.robot(chain.robot) for chain in tpg.chains]
    # Where nothing but limits of joints bounds motions it does not matter what is in hands.
    bounded = any(_is_bounded(robot) for robot in tpg.cell.robots)
    known = hand_loads(tpg) if bounded else [HandLoads(tpg, r, ()) for r in robots]
    for robot, loads in zip(robots, known, strict=True):
        yield None if robot.limits is None else Pace(robot, robot.limits, loads)


def _is_bounded(robot: PlacedRobot) -> bool:
    """Tell whether the motions of a robot have bounds besides joint limits."""
    limits = robot.limits
    if limits is None:
        return False
    caps = limits.tool_speed, limits.loaded_tool_speed
    return bool(np.isfinite(caps).any()) or explain_unchecked_efforts(robot) is None
