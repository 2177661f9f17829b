"""Distances of robots from each other, by Bullet, from the shapes of their descriptions."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import numpy as np

from benchmarks.tracking.bullet import load_body, new_world
from benchmarks.tracking.described_robot import DescribedRobot
from planning.transforms import Array
from twin.audit.worlds.bullet_world import MARGIN
from twin.audit.worlds.exact_urdf import one_shape_a_link

FAR_M = 0.5
"""What is farther away counts as so far [m]."""


class RobotDistances:
    """The robots of a cell in a world without dynamics; close it after use.

    Args:
        robots: at least two.
    """

    def __init__(self, robots: Sequence[DescribedRobot]) -> None:
        self._bullet = new_world()
        self._bodies: list[int] = []
        self._joints: list[list[int]] = []
        self._margins: list[dict[int, float]] = []
        for robot in robots:
            self._load(robot)
        self._set = self._bullet.resetJointStatesMultiDof
        self._closest = self._bullet.getClosestPoints

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._bullet.disconnect()

    def _load(self, robot: DescribedRobot) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "robot.urdf")
            path.write_text(robot.urdf, encoding="utf-8")
            # Names of meshes are absolute.
            text, shapes = one_shape_a_link(path, (Path("/"),), MARGIN)
        body = load_body(self._bullet, robot, text)
        infos = [
            self._bullet.getJointInfo(body, j)
            for j in range(self._bullet.getNumJoints(body))
        ]
        joints = {info[1].decode(): info[0] for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        self._bodies.append(body)
        self._joints.append([joints[name] for name in robot.joints])
        self._margins.append({links[shape.link]: shape.margin for shape in shapes})

    def least(self, configurations: Sequence[Array]) -> float:
        """Return the least distance of any two robots at a configuration of each [m]."""
        for body, joints, q in zip(
            self._bodies, self._joints, configurations, strict=True
        ):
            self._set(body, joints, [[value] for value in q.tolist()])
        least = FAR_M
        for a, b in combinations(range(len(self._bodies)), 2):
            points = self._closest(self._bodies[a], self._bodies[b], least)
            for point in points:
                margin = self._margins[a][point[3]] + self._margins[b][point[4]]
                least = min(least, point[8] + margin)
        return least

    def along(self, motions: Sequence[Array]) -> Array:
        """Return the least distances along motions, each of shape (t, n): shape (t,) [m]."""
        return np.array([self.least(row) for row in zip(*motions, strict=True)])
