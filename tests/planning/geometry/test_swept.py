"""Swept capsules contain every point of the robot at every time of the motion."""

from collections.abc import Callable

import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import robot_bodies
from planning.kinematics.chain import pose_joints
from planning.transforms import Array
from tests.planning.geometry.swept_segments import sweep_segments


def _capsules_at(hulls: HullTable, q: Array) -> tuple[Array, Array]:
    poses = np.empty((len(q) + 1, 4, 4))
    pose_joints(hulls.robot, q, poses)
    carried = poses[np.repeat(hulls.joint, np.diff(hulls.capsule_first)) + 1]
    both = np.einsum("cij,cej->eci", carried[:, :3, :3], hulls.ends)
    start, end = both + carried[:, :3, 3]
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
    hulls = robot_bodies(arm).hulls
    q_a = rng.uniform(arm.model.lower, arm.model.upper)
    q_b = q_a + rng.uniform(-reach, reach, 4)
    start, end, strayed = sweep_segments(hulls, q_a[None], q_b[None])
    slack = np.inf
    for t in np.linspace(0, 1, 25):
        at_start, at_end = _capsules_at(hulls, q_a + t * (q_b - q_a))
        for c in range(len(hulls.radius)):
            for point in (at_start[c], at_end[c]):
                gap = _to_segment(point, start[0, c], end[0, c])
                slack = min(slack, strayed[0, c] - gap)
    assert slack >= -1e-12


def test_a_motion_of_nothing_grows_nothing(
    make_arm: Callable[..., PlacedRobot],
) -> None:
    hulls = robot_bodies(make_arm()).hulls
    q = np.full((1, 4), 0.2)
    assert not np.any(sweep_segments(hulls, q, q)[2])


def test_small_motions_are_bounded_tightly(
    make_arm: Callable[..., PlacedRobot],
) -> None:
    arm = make_arm()
    hulls = robot_bodies(arm).hulls
    q_a = np.array([0.0, 0.3, -0.4, 0.2])
    q_b = q_a + np.array([0.0, 0.02, 0.0, 0.0])
    start, end, strayed = sweep_segments(hulls, q_a[None], q_b[None])
    first = _capsules_at(hulls, q_a)
    grown = strayed[0]
    # One hinge turns: nothing may be grown by more than half the arc of its outermost point.
    moved = np.maximum(
        np.linalg.norm(first[0] - start[0], axis=1),
        np.linalg.norm(first[1] - end[0], axis=1),
    )
    assert np.all(grown <= moved + 0.01 * (hulls.radius + 1e-6) + 1e-5)
