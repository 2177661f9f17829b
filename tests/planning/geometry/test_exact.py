"""Distances of what moves and what stands: the bisection and segments against dense sampling, gaps of hulls that are known."""

from collections.abc import Callable
from typing import Any

import coal
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import PlacedRobot
from planning.geometry.distance import is_segment_near_box, segment_box, segment_segment
from planning.geometry.exact import (
    TOLERANCE,
    Solid,
    hull_distance,
    may_come_close,
    place_at_middle,
)
from planning.geometry.gjk import BETWEEN, FAR, TOO_CLOSE, classify_gap
from planning.geometry.robot_bodies import robot_bodies
from planning.transforms import Array, from_rpy
from tests.kernels import outer


def _sampled(
    a: Solid, a_ends: np.ndarray, b: Solid, b_ends: np.ndarray, samples: int
) -> tuple[float, float]:
    """Return the least sampled distance and how far it can be from the true least one."""
    least, reach_a, reach_b = np.inf, 0.0, 0.0
    times = np.linspace(0, 1, samples + 1)
    poses_a: list[tuple[Any, float]] = []
    poses_b: list[tuple[Any, float]] = []
    for t0, t1 in zip(times, times[1:], strict=False):
        for solid, ends, poses in ((a, a_ends, poses_a), (b, b_ends, poses_b)):
            q0 = ends[0] + t0 * (ends[1] - ends[0])
            q1 = ends[0] + t1 * (ends[1] - ends[0])
            poses.append(place_at_middle(solid, q0, q1))
    reach_a = max(moved for _, moved in poses_a)
    reach_b = max(moved for _, moved in poses_b)
    for pose_a, _ in poses_a:
        for pose_b, _ in poses_b:
            least = min(least, hull_distance(a, pose_a, b, pose_b))
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
        found = may_come_close(
            a, ends_a[0], ends_a[1], b, ends_b[0], ends_b[1], clearance
        )
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
        assert may_come_close(a, q, q, b, q, q, clearance) is expected


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


_gap_class = outer(classify_gap)

_SIGNS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
FLOOR = _SIGNS * (15.0, 15.0, 0.1) - (0.0, 0.0, 0.1)


def _tilted(rng: np.random.Generator, gap: float) -> Array:
    """Return the corners of a box whose lowest corner is so high above the floor."""
    size = rng.uniform(0.1, 0.8, 3)
    turn = rng.uniform(-0.3, 0.3, 3) * rng.integers(0, 2, 3)
    pose = from_rpy((*rng.uniform(-5.0, 5.0, 2), 0.0), tuple(turn))
    corners = 0.5 * _SIGNS * size @ pose[:3, :3].T + pose[:3, 3]
    corners[:, 2] += gap - corners[:, 2].min()
    return np.ascontiguousarray(corners)


@pytest.mark.parametrize("warm", [False, True])
def test_gaps_above_a_wide_floor_are_told_whatever_the_first_guess(warm: bool) -> None:
    rng = np.random.default_rng(3)
    floor = np.ascontiguousarray(FLOOR)
    for _ in range(3000):
        gap = float(rng.uniform(0.002, 0.02))
        box = _tilted(rng, gap)
        for enough, wanted in ((0.8 * gap, FAR), (1.5 * gap, BETWEEN)):
            guess = rng.normal(size=3) if warm else np.zeros(3)
            guess /= max(float(np.linalg.norm(guess)), 1e-9)
            found = _gap_class(box, 8, floor, 8, 0.0005, enough, guess)
            assert found == wanted, (box.tolist(), gap, enough)


def test_what_reaches_into_the_floor_is_never_apart() -> None:
    rng = np.random.default_rng(4)
    floor = np.ascontiguousarray(FLOOR)
    found = set()
    for _ in range(1000):
        box = _tilted(rng, -float(rng.uniform(0.001, 0.05)))
        guess = rng.normal(size=3)
        guess /= np.linalg.norm(guess)
        found.add(_gap_class(box, 8, floor, 8, 0.0005, 0.01, guess))
    assert not found & {FAR, BETWEEN}
    assert TOO_CLOSE in found


_segment_box = outer(segment_box)
_segment_near_box = outer(is_segment_near_box)
_segment_segment = outer(segment_segment)

numbers = st.integers(0, 2**32 - 1)
_T = np.linspace(0.0, 1.0, 2001)


@given(numbers)
@settings(max_examples=150, deadline=None)
def test_segment_segment_is_the_least_over_all_pairs_of_points(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a0, a1, b0, b1 = rng.uniform(-1, 1, (4, 3))
    if seed % 5 == 0:
        a1 = a0 + (b1 - b0)  # parallel
    if seed % 7 == 0:
        b1 = b0.copy()  # a point
    found = np.sqrt(_segment_segment(a0, a1, b0, b1))
    grid_a = a0 + _T[::10, None] * (a1 - a0)
    grid_b = b0 + _T[::10, None] * (b1 - b0)
    sampled = np.min(np.linalg.norm(grid_a[:, None] - grid_b[None], axis=2))
    spacing = (np.linalg.norm(a1 - a0) + np.linalg.norm(b1 - b0)) / 400
    assert found <= sampled + 1e-12
    assert found >= sampled - spacing - 1e-12


@given(numbers)
@settings(max_examples=150, deadline=None)
def test_segment_box_is_the_least_over_the_segment(seed: int) -> None:
    rng = np.random.default_rng(seed)
    p0, p1 = rng.uniform(-1, 1, (2, 3))
    half = rng.uniform(0.01, 0.5, 3)
    pose = from_rpy(rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3))
    if seed % 5 == 0:
        p1 = p0 + pose[:3, 0] * 0.7  # along a face
    found = np.sqrt(_segment_box(p0, p1, pose, half))
    local = (p0 + _T[:, None] * (p1 - p0) - pose[:3, 3]) @ pose[:3, :3]
    outside = np.maximum(np.abs(local) - half, 0.0)
    sampled = np.min(np.linalg.norm(outside, axis=1))
    assert found <= sampled + 1e-12
    assert found >= sampled - np.linalg.norm(p1 - p0) / 4000 - 1e-12
    for near in (0.0, found - 1e-9, found + 1e-9, *rng.uniform(0, 2, 5)):
        if near >= 0.0:
            assert _segment_near_box(p0, p1, pose, half, near) == (near >= found)
