"""Rounded corners: curves and bounds against brute force, and times that no sampled limit contradicts.

Rounded polylines: smooth, close to the polyline, and not less rounded than that allows.
"""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.motion_limits import MotionLimits
from planning.timing.blended_path import (
    STRAY,
    BlendedPath,
    longest_window,
    ordered_windows,
)
from planning.timing.rounded_path import RoundedPath, rounded_path
from planning.timing.stretch import (
    greatest_speed,
    rounded_stretch,
    straight_stretch,
)

SEEDS = st.integers(0, 10**6)


def drawn(seed: int) -> tuple[MotionLimits, BlendedPath]:
    """Return limits and a polyline at full speed with rounded corners, some of them overlapping."""
    rng = np.random.default_rng(seed)
    n, corners = int(rng.integers(1, 7)), int(rng.integers(1, 7))
    limits = MotionLimits(
        rng.uniform(0.5, 3.0, n), rng.uniform(1.0, 10.0, n), rng.uniform(20.0, 500.0, n)
    )
    ways = rng.normal(size=(corners + 1, n)) * 10.0 ** rng.uniform(
        -2, 0.3, (corners + 1, 1)
    )
    cruise = [straight_stretch(limits, way).cruise for way in ways]
    at = np.concatenate([[0.0], np.cumsum(cruise)])
    points = np.vstack([np.zeros(n), np.cumsum(ways, axis=0)])
    most = 10.0 ** rng.uniform(-2, 1, corners)
    window = ordered_windows(at[1:-1], most, 0.0, float(at[-1]))
    return limits, BlendedPath(at, points, window)


def polyline(path: BlendedPath, way: np.ndarray) -> np.ndarray:
    return np.stack(
        [np.interp(way, path.at, column) for column in path.points.T], axis=1
    )


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_a_rounded_corner_is_the_average_of_the_speeds_around_it(seed: int) -> None:
    """The oracle averages the polyline of one corner over two windows, by sums."""
    _, path = drawn(seed)
    lone = BlendedPath(path.at[:3], path.points[:3], path.window[:1])
    window, middle = float(lone.window[0]), float(lone.at[1])
    first, second = 0.8 * window, 0.2 * window
    way = middle + window * np.linspace(-0.6, 0.6, 7)
    way = way[(way > 0) & (way < lone.at[-1])]
    legs = np.diff(lone.points, axis=0) / np.diff(lone.at)[:, None]
    u = (np.arange(600) + 0.5) / 600 - 0.5
    v = (np.arange(200) + 0.5) / 200 - 0.5
    for at in way:
        s = (at + first * u[:, None] + second * v).ravel() - middle
        averaged = (
            np.minimum(s, 0.0)[:, None] * legs[0]
            + np.maximum(s, 0.0)[:, None] * legs[1]
        )
        found = lone.states(np.array([at]))[0][0]
        assert np.allclose(
            found, lone.points[1] + averaged.mean(axis=0), atol=1e-4 * window
        )


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_derivatives_are_those_of_the_curve_and_bounds_hold(seed: int) -> None:
    limits, path = drawn(seed)
    edges = np.unique(np.concatenate([path.at, path.breaks()]))
    middle, step = 0.5 * (edges[1:] + edges[:-1]), np.diff(edges)[:, None]
    q, first, second = path.states(edges)
    between = path.states(middle)[1]
    # Between breaks the curve is a cubic: Simpson's rule and trapezoids are exact.
    moved = step * (first[1:] + 4.0 * between + first[:-1]) / 6.0
    assert np.allclose(np.diff(q, axis=0), moved, atol=1e-9)
    gained = step * (second[1:] + second[:-1]) / 2.0
    assert np.allclose(np.diff(first, axis=0), gained, atol=1e-9)
    way = np.linspace(0.0, path.at[-1], 4001)
    step = way[1] - way[0]
    _, first, second = path.states(way)
    # No joint is faster than it may be, and none leaves the legs' box.
    assert np.max(np.abs(first) / limits.velocity) <= 1.0 + 1e-9
    pieces = path.bent_pieces()
    inside = np.zeros(len(way), dtype=bool)
    for k, (low, high) in enumerate(zip(pieces.low, pieces.high, strict=True)):
        own = (way >= low) & (way <= high)
        inside |= own
        assert np.all(np.abs(first[own]) <= pieces.first[k] + 1e-9)
        assert np.all(np.abs(second[own]) <= pieces.second[k] * (1 + 1e-9) + 1e-9)
        rise = np.abs(np.diff(second[own], axis=0)) / step
        assert np.all(rise <= pieces.third[k] * (1 + 1e-6) + 1e-3)
    assert np.allclose(second[~inside], 0.0, atol=1e-6)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_ends_and_what_is_beside_windows_are_on_the_polyline(seed: int) -> None:
    _, path = drawn(seed)
    way = np.linspace(0.0, path.at[-1], 2001)
    middle, half = path.at[1:-1], path.window / 2
    beside = np.all(np.abs(way[:, None] - middle) >= half, axis=1)
    q = path.states(way)[0]
    assert np.allclose(q[beside], polyline(path, way)[beside], atol=1e-9)
    assert np.allclose(q[[0, -1]], path.points[[0, -1]], atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(SEEDS)
def test_chords_stay_near_the_curve(seed: int) -> None:
    _, path = drawn(seed)
    low, high = 0.0, float(path.at[-1])
    count = path.chords(low, high)
    ends = path.states(np.linspace(low, high, count + 1))[0]
    share = (np.arange(200 * count) + 0.5) / 200
    q = path.states(low + (high - low) * share / count)[0]
    k = np.floor(share).astype(int)
    # A point of the chord at the same time is at least as far as the nearest one.
    near = ends[k] + (share - k)[:, None] * (ends[k + 1] - ends[k])
    assert np.max(np.abs(q - near).sum(axis=1)) <= STRAY * (1 + 1e-6)


@settings(max_examples=100, deadline=None)
@given(SEEDS)
def test_windows_are_in_the_order_of_their_corners_and_no_longer_than_asked_for(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    at = np.cumsum(rng.uniform(0.01, 1.0, int(rng.integers(1, 9))))
    most, high = rng.uniform(0.01, 3.0, len(at)), float(at[-1] + 0.5)
    window = ordered_windows(at, most, 0.0, high)
    low, stop = at - window / 2, at + window / 2
    assert np.all(window > 0)
    assert np.all(window <= most + 1e-12)
    assert np.all(low >= -1e-12)
    assert np.all(stop <= high + 1e-12)
    assert np.all(np.diff(low) >= -1e-12)
    assert np.all(np.diff(stop) >= -1e-12)


@settings(max_examples=80, deadline=None)
@given(SEEDS, st.floats(0.05, 3.0), st.floats(0.01, 0.2))
def test_the_greatest_speed_keeps_limits_and_no_greater_one_does(
    seed: int, rate: float, lag: float
) -> None:
    limits, path = drawn(seed)
    pieces = path.bent_pieces()
    for row in range(len(pieces.low)):
        bounds = pieces.first[row], pieces.second[row], pieces.third[row]

        def share(speed: float, bounds: tuple[np.ndarray, ...] = bounds) -> float:
            first, second, third = bounds
            a = first * rate + second * speed**2
            j = third * speed**3 + 3 * second * speed * rate + first * 2 * rate / lag
            return float(max(np.max(a / limits.acceleration), np.max(j / limits.jerk)))

        found = greatest_speed(limits.acceleration, limits.jerk, *bounds, rate, lag)
        if found > 0.0:
            assert share(found) <= 0.99 * (1 + 1e-9)
        if found < 1.0:
            assert share(found + 1e-6) > 0.99 * (1 - 1e-6)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_a_rounded_stretch_is_slower_than_full_speed_and_has_zones_around_corners(
    seed: int,
) -> None:
    limits, path = drawn(seed)
    pace = rounded_stretch(limits, path)
    assert pace is not None
    assert pace.seconds >= path.at[-1] + pace.lag
    assert np.all((pace.cap > 0) & (pace.cap <= 1))
    pieces = path.bent_pieces()
    assert np.allclose(pieces.low - pace.low, pace.lag * pace.cap)
    assert pace.bent_ramp >= pace.ramp


def test_where_the_longest_window_fits_the_corner_costs_no_speed() -> None:
    limits = MotionLimits(np.ones(2), np.full(2, 5.0), np.full(2, 1e9))
    turn = np.array([-1.0, 1.0])
    window = longest_window(limits, turn)
    points = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 3.0]])
    path = BlendedPath(np.array([0.0, 3.0, 6.0]), points, np.array([window]))
    rested = 2 * straight_stretch(limits, points[1]).seconds
    pace = rounded_stretch(limits, path)
    assert pace is not None
    assert np.min(pace.cap) > 0.85
    assert pace.seconds < rested - 0.15


def test_a_way_straight_back_is_not_quicker_rounded() -> None:
    limits = MotionLimits(np.ones(1), np.full(1, 5.0), np.full(1, 100.0))
    points = np.array([[0.0], [1.0], [0.0]])
    rested = 2 * straight_stretch(limits, points[1]).seconds
    for window in (0.05, 0.2, 0.5):
        path = BlendedPath(np.array([0.0, 1.0, 2.0]), points, np.array([window]))
        pace = rounded_stretch(limits, path)
        assert pace is not None
        # It turns back before the corner: by that much less it has to go.
        assert pace.seconds > rested - window


def drawn_polyline(seed: int) -> tuple[np.ndarray, float]:
    """Return a polyline, and how far a curve may stray from it."""
    rng = np.random.default_rng(seed)
    n, w = int(rng.integers(2, 7)), int(rng.integers(3, 12))
    bend = 10.0 ** rng.uniform(-3, 0.5)
    steps = (rng.normal(size=n) + bend * rng.normal(size=(w, n))) * 10.0 ** rng.uniform(
        -2, 0, (w, 1)
    )
    return np.cumsum(steps, axis=0), 10.0 ** rng.uniform(-5, -2)


def sampled(path: RoundedPath) -> np.ndarray:
    return np.unique(np.concatenate([np.linspace(0.0, path.at[-1], 3000), path.at]))


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_it_is_within_the_allowance_and_has_the_same_ends(seed: int) -> None:
    corners, stray = drawn_polyline(seed)
    path = rounded_path(corners, stray)
    ways = sampled(path)
    points = path.points(ways)
    assert np.allclose(points[[0, -1]], corners[[0, -1]], atol=1e-12)
    beside = np.array([np.interp(ways, path.at, joint) for joint in corners.T]).T
    far = np.abs(points - beside).sum(axis=1)
    for a, b in zip(corners, corners[1:], strict=False):
        share = np.clip((points - a) @ (b - a) / float((b - a) @ (b - a)), 0.0, 1.0)
        off = np.abs(points - a - share[:, None] * (b - a)).sum(axis=1)
        far = np.minimum(far, off)
    assert far.max() <= stray * (1.0 + 1e-9) + 1e-12


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_curvature_is_continuous_and_as_said(seed: int) -> None:
    corners, stray = drawn_polyline(seed)
    path = rounded_path(corners, stray)
    bends = path.curvature()
    for k in range(1, len(corners) - 1):
        if path.reach[k] <= 0.0:
            continue
        step = path.reach[k] * 1e-3
        around = path.at[k] + step * np.arange(-3, 4)
        points = path.points(around)
        second = np.diff(points, 2, axis=0) / step**2
        # It changes within a thousandth of the rounding by a few hundredths of the most (0.032 in 6,000 polylines), and
        # by about as much in the next: a jump would be several tenths, in some of them.
        most = bends[k - 1 : k + 2].max()
        changes = np.abs(np.diff(second, axis=0)).sum(axis=1)
        assert np.all(changes <= most * 0.05)
        assert np.ptp(changes) <= most * 0.02
        assert np.abs(second).sum(axis=1).max() <= most * 1.001 + 1e-6


def test_a_corner_by_itself_is_rounded_as_far_as_the_allowance_goes() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.1]])
    path = rounded_path(corners, 1e-3)
    off = np.abs(path.points(path.at[1:2])[0] - corners[1]).sum()
    assert 0.999e-3 <= off <= 1.0001e-3
