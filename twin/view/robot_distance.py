"""Least distance of two robots of a team, measured between the bodies of the audit."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import combinations

import coal
import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.transforms import Array
from scheduling.witness.parts import coal_pose
from scheduling.witness.robot import WitnessRobot


class RobotDistance:
    """Measures robots with their tools, without what they hold.

    Args:
        robots: at least two.
    """

    def __init__(self, robots: Iterable[PlacedRobot]) -> None:
        self._robots = {}
        for own in robots:
            robot = WitnessRobot(own)
            bodies = [coal.CollisionObject(part.shape) for part in robot.parts]
            group = coal.DynamicAABBTreeCollisionManager()
            for body in bodies:
                group.registerObject(body)
            self._robots[own.name] = robot, bodies, group

    def closest(self, configurations: Mapping[str, Array]) -> tuple[float, Array]:
        """Return the least distance, not positive in an overlap [m], and its ends, shape (2, 3) [m]."""
        for name, (robot, bodies, group) in self._robots.items():
            frames = robot.joint_frames(configurations[name])
            for part, body in zip(robot.parts, bodies, strict=True):
                body.setTransform(coal_pose(frames[part.joint + 1] @ part.local))
                body.computeAABB()
            group.update()
        found, groups = [], [group for *_, group in self._robots.values()]
        for one, other in combinations(groups, 2):
            measured = coal.DistanceCallBackDefault()
            one.distance(other, measured)
            found.append(measured.data.result)
        least = min(found, key=lambda own: float(own.min_distance))
        ends = [least.getNearestPoint1(), least.getNearestPoint2()]
        return least.min_distance, np.array(ends)
