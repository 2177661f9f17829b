"""Our GP4 replays published APEX-MR plans: nothing touches that did not touch there."""

from __future__ import annotations

import os
from itertools import combinations
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest

from planning.geometry.chain import joint_poses
from planning.kinematics import frame_pose
from planning.robots.model import RobotModel
from planning.robots.registry import robot_model
from planning.transforms import Array, Transform, from_quat_wxyz, translation
from planning.workcell import PlacedRobot

DATA = Path(
    os.environ.get(
        "ASSEMBLY_TWIN_APEX_DATA",
        str(Path(__file__).parents[2] / ".." / "shared" / "data" / "apex-mr"),
    )
)
PLATE_HEIGHT = 1.1145
CLOSEST = 0.004

needs_data = pytest.mark.skipif(
    not (DATA / "steps" / "cliff_steps.csv").is_file(),
    reason="needs the published APEX-MR files (ASSEMBLY_TWIN_APEX_DATA)",
)


class Replayed:
    """Hulls of one robot at one configuration."""

    def __init__(self, model: RobotModel) -> None:
        self.model = model
        self.hulls: list[Any] = []
        for part in model.parts:
            points = coal.StdVec_Vec3s()
            for vertex in part.body.vertices:
                points.append(np.array(vertex))
            self.hulls.append(coal.Convex.convexHull(points, False, ""))
        self.poses: list[Any] = []
        self.low = self.high = np.empty((0, 3))

    def move_to(self, base: Transform, q: Array) -> None:
        out = np.empty((self.model.dof + 1, 4, 4))
        chain = self.model.chain
        joint_poses(
            chain.placement,
            chain.axis,
            chain.prismatic,
            np.ascontiguousarray(base),
            np.ascontiguousarray(q),
            out,
        )
        placed = [out[part.joint + 1] for part in self.model.parts]
        corners = [
            part.body.vertices @ pose[:3, :3].T + pose[:3, 3]
            for part, pose in zip(self.model.parts, placed, strict=True)
        ]
        self.low = np.array([c.min(axis=0) for c in corners])
        self.high = np.array([c.max(axis=0) for c in corners])
        self.poses = [
            coal.Transform3s(np.array(p[:3, :3]), np.array(p[:3, 3])) for p in placed
        ]


def distance(one: Replayed, a: int, other: Replayed, b: int) -> float:
    return float(
        coal.distance(
            one.hulls[a],
            one.poses[a],
            other.hulls[b],
            other.poses[b],
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
    )


def robot_bases() -> list[Transform]:
    """World poses of the two robots' base links; the files give shoulders, 0.33 m above."""
    folder = DATA / "robot_properties"
    world = np.loadtxt(folder / "world_base.txt")
    return [
        np.asarray(world @ np.loadtxt(folder / name) @ translation(0.0, 0.0, -0.33))
        for name in ("r1_base.txt", "r2_base.txt")
    ]


def rows_of(task: str) -> Array:
    return np.loadtxt(DATA / "steps" / f"{task}_steps.csv", delimiter=",")


@needs_data
@pytest.mark.parametrize("task", ["cliff", "faucet", "bridge"])
def test_waypoints_reach_the_published_flange_poses(task: str) -> None:
    model = robot_model("gp4")
    robots = [PlacedRobot("arm", model, base, model.home) for base in robot_bases()]
    for row in rows_of(task):
        for robot, first in zip(robots, (1, 15), strict=True):
            pose = frame_pose(robot, np.radians(row[first + 7 : first + 13]))
            x, y, z, qx, qy, qz, qw = row[first : first + 7]
            expected = from_quat_wxyz((x, y, z), (qw, qx, qy, qz))
            # The published table rounds pi to eight digits, its bases likewise.
            assert np.allclose(pose, expected, atol=2e-7)


@needs_data
@pytest.mark.parametrize("task", ["cliff", "faucet", "bridge"])
def test_published_waypoints_are_free_with_our_geometry(task: str) -> None:
    """Arms 4 mm apart at every row, above the plate, and never touching themselves."""
    model = robot_model("gp4")
    bases = robot_bases()
    arms = [Replayed(model), Replayed(model)]
    count = len(model.parts)
    own = [p for p in combinations(range(count), 2) if p not in model.never_collide]
    closest = np.inf
    for row in rows_of(task):
        for arm, base, first in zip(arms, bases, (8, 22), strict=True):
            arm.move_to(base, np.radians(row[first : first + 6]))
            moved = [part.joint >= 1 for part in model.parts]
            assert arm.low[moved, 2].min() > PLATE_HEIGHT
            for a, b in own:
                apart = np.maximum(arm.low[a] - arm.high[b], arm.low[b] - arm.high[a])
                if apart.max() <= 0.0:
                    assert distance(arm, a, arm, b) > 0.0
        left, right = arms
        gaps = np.maximum(
            left.low[:, None] - right.high[None], right.low[None] - left.high[:, None]
        ).max(axis=2)
        for a, b in np.argwhere(gaps < 2.0 * CLOSEST):
            closest = min(closest, distance(left, int(a), right, int(b)))
    assert closest >= CLOSEST
