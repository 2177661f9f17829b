"""The bisection against dense sampling of both motions."""

from __future__ import annotations

from collections.abc import Callable

import coal
import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot
from planning.geometry.exact import TOLERANCE, Solid, come_close, distance, place
from planning.geometry.robot_bodies import robot_bodies
from planning.transforms import from_rpy


def _sampled(
    a: Solid, a_ends: np.ndarray, b: Solid, b_ends: np.ndarray, samples: int
) -> tuple[float, float]:
    """Return the least sampled distance and how far it can be from the true least one."""
    least, reach_a, reach_b = np.inf, 0.0, 0.0
    times = np.linspace(0, 1, samples + 1)
    poses_a, poses_b = [], []
    for t0, t1 in zip(times, times[1:], strict=False):
        for solid, ends, poses in ((a, a_ends, poses_a), (b, b_ends, poses_b)):
            q0 = ends[0] + t0 * (ends[1] - ends[0])
            q1 = ends[0] + t1 * (ends[1] - ends[0])
            poses.append(place(solid, q0, q1))
    reach_a = max(moved for _, moved in poses_a)
    reach_b = max(moved for _, moved in poses_b)
    for pose_a, _ in poses_a:
        for pose_b, _ in poses_b:
            least = min(least, distance(a, pose_a, b, pose_b))
    return least, reach_a + reach_b


@pytest.mark.parametrize("seed", range(25))
def test_bisection_agrees_with_sampling(
    make_arm: Callable[..., PlacedRobot], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    one = make_arm("one")
    two = make_arm("two", from_rpy((0.7, 0.1, 0.0), (0.0, 0.0, 3.0)))
    a = robot_bodies(one).solids[int(rng.integers(1, 4))]
    b = robot_bodies(two).solids[int(rng.integers(1, 4))]
    ends_a = rng.uniform(-0.6, 0.6, 4) + rng.uniform(-0.2, 0.2, (2, 4))
    ends_b = rng.uniform(-0.6, 0.6, 4) + rng.uniform(-0.2, 0.2, (2, 4))
    least, reach = _sampled(a, ends_a, b, ends_b, 24)
    for clearance in (0.0, 0.001, 0.02, 0.1):
        found = come_close(a, *ends_a, b, *ends_b, clearance)
        if least < clearance:
            assert found
        if least - reach > clearance + TOLERANCE:
            assert not found


def test_touching_within_the_tolerance_counts_as_close() -> None:
    from planning.cell.cover import box_body
    from planning.geometry.exact import resting_solid
    from planning.transforms import translation

    cube = box_body("cube", np.array([0.1, 0.1, 0.1]))
    a = resting_solid("a", cube, np.eye(4))
    q = np.zeros(1)
    for gap, clearance, expected in (
        (0.0011, 0.001, False),
        (0.0009, 0.001, True),
        (-0.001, 0.0, True),
    ):
        b = resting_solid("b", cube, translation(0.1 + gap, 0.0, 0.0))
        assert come_close(a, q, q, b, q, q, clearance) is expected


def test_hulls_measure_as_coal_boxes_do() -> None:
    from planning.cell.cover import box_body
    from planning.geometry.exact import hull_shape

    size = np.array([0.016, 0.032, 0.0096])
    shape = hull_shape(box_body("brick", size))
    box = coal.Box(*size)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        pose = from_rpy(rng.uniform(-0.05, 0.05, 3), rng.uniform(-3, 3, 3))
        at = coal.Transform3s(pose[:3, :3], pose[:3, 3])
        request = coal.DistanceRequest()
        one, two = coal.DistanceResult(), coal.DistanceResult()
        home = coal.Transform3s()
        hull_gap = coal.distance(shape, home, shape, at, request, one)
        box_gap = coal.distance(box, home, box, at, request, two)
        assert hull_gap == pytest.approx(box_gap, abs=1e-6)
