"""How fast robots may pass their nodes with what they have in their hands.

A stretch is passed as slowly as its fastest point asks for, and with accelerations that joints bear all
along it; a skill, whose path is followed by one clock, is slowed down as a whole.

What makes robots slower than their joints could be: limits of the tool's speed, and of effort.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from planning.cell.robot_model import MotionLimits
from planning.cell.workcell import CellObject, PlacedRobot, RackTool
from planning.kinematics.chain import joint_table
from planning.timing.path_bounds import (
    PathBounds,
    greatest_tool_speed,
    tool_speed_along,
)
from planning.timing.rounded_path import BlendedPath
from planning.timing.smooth_path import SmoothPath
from planning.timing.stretch import (
    RoundedStretch,
    Stretch,
    rounded_stretch,
    straight_stretch,
)
from planning.timing.torque import (
    ArmDynamics,
    Bearing,
    Payload,
    borne_stretch,
    why_unchecked,
)
from planning.transforms import Array, Indices, Transform
from scheduling.conflicts.object_spans import Moment, ObjectSpan, trace_objects
from scheduling.graph.temporal_plan_graph import (
    BY_EFFORT,
    BY_JOINTS,
    BY_TOOL_SPEED,
    Drive,
    NodeChain,
    TemporalPlanGraph,
)
from scheduling.graph.total_order import planned_ranks

_SAME = 1.0 + 1e-9
"""Times that differ by a smaller factor are the same."""

_ROUNDING_S = 1e-9
"""By how much rounding may part the time of a row from that of its waypoint [s]."""


@dataclass(frozen=True, eq=False)
class HandLoad:
    """Tool and parts that a robot has in its hand.

    Attributes:
        tool: the tool on its flange, of a robot that changes its tools; None for none, and for a
            robot that keeps its own.
        parts: what it holds besides, each with its pose in the flange frame.
    """

    tool: RackTool | None = None
    parts: tuple[tuple[CellObject, Transform], ...] = ()


class HandLoads:
    """Tool and parts in the hand of one robot, from moment to moment.

    Args:
        tpg: the graph.
        robot: of the cell.
        spans: in which it carries something.
    """

    def __init__(
        self, tpg: TemporalPlanGraph, robot: PlacedRobot, spans: Sequence[ObjectSpan]
    ) -> None:
        tools = {tool.name: tool for tool in robot.tools}
        objects = {item.name: item for item in tpg.cell.objects}
        begins = sorted(spans, key=lambda span: span.start, reverse=True)
        self._moments: list[Moment] = sorted(
            {moment for span in spans for moment in (span.start, span.end)}
        )
        self._loads: list[HandLoad] = []
        held: list[ObjectSpan] = []
        for moment in self._moments:
            while begins and begins[-1].start <= moment:
                held.append(begins.pop())
            held = [span for span in held if span.end > moment]
            worn = [tools[span.object] for span in held if span.object in tools]
            parts = [
                (objects[span.object], span.pose)
                for span in held
                if span.object not in tools
            ]
            self._loads.append(HandLoad(worn[0] if worn else None, tuple(parts)))

    def after(self, node: int, waypoint: int) -> HandLoad:
        """Return what the robot has in its hand from a waypoint of a node on, to the next one.

        Args:
            node: of its chain.
            waypoint: 0 = when the node starts, k = at the node's k-th waypoint.
        """
        k = bisect_right(self._moments, (node, waypoint)) - 1
        return self._loads[k] if k >= 0 else HandLoad()

    def runs(self, node: int, waypoints: int) -> list[tuple[int, int, HandLoad]]:
        """Return the parts of a node in which the load stays the same.

        Args:
            node: of the chain.
            waypoints: how many the path of the node has, with the one that it starts from.

        Returns:
            First and last waypoint of each, and the load.
        """
        low = bisect_right(self._moments, (node, 0))
        high = bisect_left(self._moments, (node, waypoints - 1))
        borders = [waypoint for _, waypoint in self._moments[low:high]]
        edges = [0, *borders, max(waypoints - 1, 0)]
        return [(begin, end, self.after(node, begin)) for begin, end in pairwise(edges)]


def hand_loads(tpg: TemporalPlanGraph) -> tuple[HandLoads, ...]:
    """Return what the robots have in their hands, one entry a chain; machines hold nothing."""
    spans: list[list[ObjectSpan]] = [[] for _ in tpg.chains]
    for span in trace_objects(tpg, planned_ranks(tpg.chains)).spans:
        if span.carried:
            spans[span.robot].append(span)
    return tuple(
        HandLoads(tpg, tpg.cell.robot(chain.robot), own)
        for chain, own in zip(tpg.chains, spans, strict=True)
    )


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
        loads: what it has in its hand.
    """

    def __init__(
        self, robot: PlacedRobot, limits: MotionLimits, loads: HandLoads
    ) -> None:
        self.limits = limits
        self._robot, self._loads = robot, loads
        self._joints = joint_table(robot.model)
        self._weighed = why_unchecked(robot) is None
        self._dynamics: dict[HandLoad, ArmDynamics] = {}

    def stretch(self, node: int, start: Array, way: Array) -> tuple[Stretch, Slowing]:
        """Return how a stretch is passed.

        Args:
            node: its first.
            start: where it begins, shape (n,).
            way: from there to its end, shape (n,).
        """
        free = found = straight_stretch(self.limits, way)
        slowing = Slowing()
        if free.cruise <= 0.0:
            return free, slowing
        load = self._loads.after(node, 0)
        seconds = self._tool_seconds(load, start, way)
        if seconds > 0.0:
            found = straight_stretch(self.limits, way, seconds)
            # Over a short way full speed may never be reached, with the limit or without.
            slowing = _slower(found.seconds / free.seconds, BY_TOOL_SPEED)
        if self._weighed:
            borne = self._dynamics_with(load).along_stretch(start, way, found)
            found = borne_stretch(found, borne)
            slowing = _borne(slowing, borne, found.seconds / free.seconds)
        return found, slowing

    def full_speed_seconds(self, node: int, start: Array, way: Array) -> float:
        """Return how long a straight line takes at the full speed of a way with rounded corners [s].

        At that speed the tool is not too fast anywhere on it, and joints can still bear that the robot
        speeds up and slows down.

        Args:
            node: the first of the way.
            start: where the line begins, shape (n,).
            way: from there to its end, shape (n,).
        """
        load = self._loads.after(node, 0)
        least = self._tool_seconds(load, start, way)
        seconds = straight_stretch(self.limits, way, least).cruise
        if self._weighed and seconds > 0.0:
            ends = np.array([start, start + way])
            line = BlendedPath(np.array([0.0, seconds]), ends, np.empty(0))
            bounds = self._dynamics_with(load).along_legs(line)
            seconds *= bounds.full_speed_factor()
        return seconds

    def rounded(self, node: int, path: BlendedPath) -> RoundedStretch | None:
        """Return how a polyline with rounded corners is passed, None where that cannot be.

        Args:
            node: the first of the way.
            path: the polyline; its legs take as long as ``full_speed_seconds`` says, or longer.
        """
        return rounded_stretch(self.limits, path, self._bounds(node, path))

    def rounded_slowing(
        self, node: int, path: BlendedPath, found: RoundedStretch
    ) -> Slowing:
        """Return by how much a polyline with rounded corners takes longer than joints allow.

        Args:
            node: the first of the way.
            path: the polyline.
            found: how it is passed.
        """
        bounds = self._bounds(node, path)
        if bounds is None:
            return Slowing()
        ways, taken = np.diff(path.points, axis=0), np.diff(path.at)
        least = [straight_stretch(self.limits, way).cruise for way in ways]
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
        """Return what bounds a way with rounded corners besides limits of joints, None for nothing."""
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
        """Return by how much a skill is slowed down.

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
        """Return the dynamics of the robot with what it has in its hand."""
        if load not in self._dynamics:
            model = self._robot.model if load.tool is None else load.tool.model
            held = [
                Payload(part.mass, part.shape, pose)
                for part, pose in load.parts
                if part.mass > 0.0
            ]
            self._dynamics[load] = ArmDynamics(self._robot, model, held)
        return self._dynamics[load]

    def _tool_speed(self, load: HandLoad) -> float:
        if not load.parts:
            return self.limits.tool_speed
        return min(self.limits.tool_speed, self.limits.loaded_tool_speed)

    def _tool_seconds(self, load: HandLoad, start: Array, way: Array) -> float:
        """Return how long a straight line takes for the tool not to be too fast, 0 for no limit [s]."""
        cap = self._tool_speed(load)
        if not np.isfinite(cap):
            return 0.0
        return tool_speed_along(self._joints, self._tip(load), start, way) / cap

    def _tip(self, load: HandLoad) -> Array:
        """Return the point of the tool in the last joint's frame; without a tool, of the flange."""
        model = self._robot.model if load.tool is None else load.tool.model
        frame = model.frames.get("tool")
        pose = model.flange if frame is None else model.flange @ frame
        return np.asarray(pose[:3, 3])


def _slower(factor: float, cause: int) -> Slowing:
    return Slowing(factor, cause) if factor > _SAME else Slowing()


def _borne(slowing: Slowing, borne: Bearing, factor: float) -> Slowing:
    """Return what limits of effort make of a motion that is slowed down already.

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
    """Yield the pace of each chain's robot; None where it keeps to no limits, and for machines."""
    robots = [tpg.cell.robot(chain.robot) for chain in tpg.chains]
    # Where nothing but limits of joints bounds motions it does not matter what is in hands.
    bounded = any(_is_bounded(robot) for robot in tpg.cell.robots)
    known = hand_loads(tpg) if bounded else [HandLoads(tpg, r, ()) for r in robots]
    for robot, loads in zip(robots, known, strict=True):
        yield None if robot.limits is None else Pace(robot, robot.limits, loads)


def _is_bounded(robot: PlacedRobot) -> bool:
    """Tell whether anything but limits of joints bounds the motions of a robot."""
    limits = robot.limits
    if limits is None:
        return False
    caps = limits.tool_speed, limits.loaded_tool_speed
    return bool(np.isfinite(caps).any()) or why_unchecked(robot) is None


def slowed_motions(tpg: TemporalPlanGraph) -> dict[str, dict[str, Any]]:
    """Return by robot how many of its stretches and skills are slowed, and by what.

    Robots of which nothing is slowed are left out.
    """
    found = {}
    for chain in tpg.chains:
        if chain.drive is None or not np.any(chain.drive.slowed_by > BY_JOINTS):
            continue
        moves = motions(chain)
        names = tpg.cell.robot(chain.robot).model.joint_names
        causes = {"tool speed": BY_TOOL_SPEED}
        causes |= {f"effort of {name}": BY_EFFORT + j for j, name in enumerate(names)}
        found[chain.robot] = _counts(chain, moves) | {
            "by": {
                cause: _slowed_by(tpg, chain, chain.drive, moves, number)
                for cause, number in causes.items()
                if np.any(chain.drive.slowed_by == number)
            }
        }
    return found


def motions(chain: NodeChain) -> Indices:
    """Return the first node of each stretch, and each skill that moves; none without limits."""
    drive = chain.drive
    if drive is None:
        return np.empty(0, dtype=np.int64)
    first = np.append(True, drive.rests[:-1])[: len(chain)]
    return np.flatnonzero(first & (drive.cruise > 0.0))


def _counts(chain: NodeChain, nodes: Indices) -> dict[str, int]:
    skills = int(np.count_nonzero(chain.skill[nodes]))
    return {"stretches": len(nodes) - skills, "skills": skills}


def _slowed_by(
    tpg: TemporalPlanGraph, chain: NodeChain, drive: Drive, moves: Indices, cause: int
) -> dict[str, Any]:
    own = moves[drive.slowed_by[moves] == cause]
    worst = own[int(np.argmax(drive.slowed[own]))]
    task = tpg.tasks[int(chain.task[worst])]
    return _counts(chain, own) | {
        "longest": float(drive.slowed[worst]),
        "task": task.index,
        "label": task.label,
    }


def overloads(tpg: TemporalPlanGraph) -> tuple[str, ...]:
    """Return in words which joints do not bear what they have to hold, however slow they are."""
    found = []
    for chain in tpg.chains:
        drive, drives = chain.drive, tpg.cell.robot(chain.robot).model.drives
        if drive is None or drives is None:
            continue
        names = tpg.cell.robot(chain.robot).model.joint_names
        for cause in np.unique(drive.slowed_by[drive.slowed_by < BY_JOINTS]).tolist():
            node, joint = int(np.argmax(drive.slowed_by == cause)), -1 - cause
            task = tpg.tasks[int(chain.task[node])]
            found.append(
                f"{chain.robot}: gravity alone takes the effort of {names[joint]}"
                f" ({drives.effort[joint]:g} N m or N), first in task {task.index} ({task.label}):"
                " no motion is slow enough for that; give a lighter part, another robot, or limits.effort"
            )
    return tuple(found)
