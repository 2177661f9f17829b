"""Our GP4 replays published APEX-MR plans: nothing touches that did not touch there."""

import os
from collections.abc import Iterable, Sequence
from itertools import combinations, product
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pytest

from planning.cell.body import ConvexBody
from planning.cell.cover import box_body
from planning.cell.robot_model import RobotModel
from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.robots.registry import robot_model
from planning.transforms import Array, Transform, from_quat_wxyz, translation

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


class Placed:
    """Hulls of bodies at their poses."""

    def __init__(self, bodies: Sequence[ConvexBody]) -> None:
        self.bodies = bodies
        self.hulls: list[Any] = []
        for body in bodies:
            points = coal.StdVec_Vec3s()
            for vertex in body.vertices:
                points.append(np.array(vertex))
            self.hulls.append(coal.Convex.convexHull(points, False, ""))
        self.poses: list[Any] = []
        self.low = self.high = np.empty((0, 3))

    def put(self, poses: Sequence[Transform]) -> None:
        corners = [
            body.vertices @ pose[:3, :3].T + pose[:3, 3]
            for body, pose in zip(self.bodies, poses, strict=True)
        ]
        self.low = np.array([c.min(axis=0) for c in corners])
        self.high = np.array([c.max(axis=0) for c in corners])
        self.poses = [
            coal.Transform3s(np.array(p[:3, :3]), np.array(p[:3, 3])) for p in poses
        ]


def part_poses(model: RobotModel, base: Transform, q: Array) -> list[Transform]:
    out = joint_poses_of(PlacedRobot("", model, base, q), q)
    return [out[part.joint + 1] for part in model.parts]


def distance(one: Placed, a: int, other: Placed, b: int) -> float:
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


def least_distance(
    one: Placed, other: Placed, pairs: Iterable[tuple[int, int]], within: float
) -> float:
    """Least distance of the pairs that are closer than ``within``, else infinity."""
    best = np.inf
    for a, b in pairs:
        gap = np.maximum(one.low[a] - other.high[b], other.low[b] - one.high[a]).max()
        if gap < within:
            best = min(best, distance(one, a, other, b))
    return best


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
@pytest.mark.parametrize(
    ("task", "expected"),
    [
        ("cliff", 0.0062),
        ("faucet", 0.0062),
        pytest.param("bridge", 0.0170, marks=pytest.mark.nightly),
    ],
)
def test_published_waypoints_are_free_with_our_geometry(
    task: str, expected: float
) -> None:
    """Arms 4 mm apart at every row, clear of the table, and never touching themselves.

    The closest approach is that of tip and cone during the handover.
    """
    model = robot_model("gp4")
    bases = robot_bases()
    bodies = [part.body for part in model.parts]
    left, right = Placed(bodies), Placed(bodies)
    count = len(bodies)
    own = [p for p in combinations(range(count), 2) if p not in model.never_collide]
    every = list(product(range(count), range(count)))
    moved = [(k, 0) for k, part in enumerate(model.parts) if part.joint >= 0]
    table = box_body("table", (0.6985, 1.219, 0.02))
    middle = (bases[0][:2, 3] + bases[1][:2, 3]) / 2.0
    top = Placed([table])
    top.put([translation(middle[0], 0.0, PLATE_HEIGHT - 0.01)])
    closest = np.inf
    for row in rows_of(task):
        for arm, base, first in zip((left, right), bases, (8, 22), strict=True):
            q = np.radians(row[first : first + 6])
            arm.put(part_poses(model, base, q))
            assert least_distance(arm, arm, own, 0.0) > 0.0
            assert least_distance(arm, top, moved, 0.01) > 0.003
        closest = min(closest, least_distance(left, right, every, 0.02))
    assert closest >= CLOSEST
    assert closest == pytest.approx(expected, abs=2e-4)
