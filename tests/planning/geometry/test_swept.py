"""Swept capsules contain every point of the robot at every time of the motion."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from planning.cell.compiled_robot import RobotKernel, robot_kernel
from planning.cell.workcell import PlacedRobot
from planning.geometry.swept import sweep_segments
from planning.kinematics.chain import joint_poses
from planning.transforms import Array


def _capsules_at(kernel: RobotKernel, q: Array) -> tuple[Array, Array]:
    poses = np.empty((len(q) + 1, 4, 4))
    joint_poses(kernel.placement, kernel.axis, kernel.prismatic, kernel.base, q, poses)
    carried = poses[kernel.joint + 1]
    start = (
        np.einsum("cij,cj->ci", carried[:, :3, :3], kernel.start) + carried[:, :3, 3]
    )
    end = np.einsum("cij,cj->ci", carried[:, :3, :3], kernel.end) + carried[:, :3, 3]
    return start, end


def _to_segment(point: Array, a: Array, b: Array) -> float:
    u = b - a
    t = 0.0 if u @ u == 0 else np.clip((point - a) @ u / (u @ u), 0, 1)
    return float(np.linalg.norm(point - a - t * u))


@pytest.mark.parametrize("reach", [0.01, 0.1, 1.0])
@pytest.mark.parametrize("seed", range(6))
def test_no_point_ever_leaves_its_swept_capsule(
    make_arm: Callable[..., PlacedRobot], reach: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    arm = make_arm()
    kernel = robot_kernel(arm)
    q_a = rng.uniform(arm.model.lower, arm.model.upper)
    q_b = q_a + rng.uniform(-reach, reach, 4)
    start, end, radius = sweep_segments(kernel, q_a[None], q_b[None])
    slack = np.inf
    for t in np.linspace(0, 1, 25):
        at_start, at_end = _capsules_at(kernel, q_a + t * (q_b - q_a))
        for c in range(len(kernel.radius)):
            for point in (at_start[c], at_end[c]):
                gap = _to_segment(point, start[0, c], end[0, c])
                slack = min(slack, radius[0, c] - kernel.radius[c] - gap)
    assert slack >= -1e-12


def test_a_motion_of_nothing_grows_nothing(
    make_arm: Callable[..., PlacedRobot],
) -> None:
    kernel = robot_kernel(make_arm())
    q = np.full((1, 4), 0.2)
    _, _, radius = sweep_segments(kernel, q, q)
    assert np.array_equal(radius[0], kernel.radius)


def test_small_motions_are_bounded_tightly(
    make_arm: Callable[..., PlacedRobot],
) -> None:
    arm = make_arm()
    kernel = robot_kernel(arm)
    q_a = np.array([0.0, 0.3, -0.4, 0.2])
    q_b = q_a + np.array([0.0, 0.02, 0.0, 0.0])
    start, end, radius = sweep_segments(kernel, q_a[None], q_b[None])
    first = _capsules_at(kernel, q_a)
    grown = radius[0] - kernel.radius
    # One hinge turns: nothing may be grown by more than half the arc of its outermost point.
    moved = np.maximum(
        np.linalg.norm(first[0] - start[0], axis=1),
        np.linalg.norm(first[1] - end[0], axis=1),
    )
    assert np.all(grown <= moved + 0.01 * (kernel.radius + 1e-6) + 1e-5)
