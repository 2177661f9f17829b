"""Quickest motions along lines and polylines: within limits, on the path, and not slower than need be.

Stops in the middle of a skill, and speeds at borders: within limits, on the path, and no longer or slower than need be.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.motion_limits import MotionLimits
from planning.timing.braking import StoppedPath, stop_along_path
from planning.timing.rounded_path import STRAY
from planning.timing.smooth_path import SmoothPath, smooth_path
from planning.timing.stretch import (
    brake_within_piece,
    exit_bound,
    passage_seconds,
    straight_stretch,
)


def drawn(
    seed: int, *, gentle: bool = False, jerk: bool = True
) -> tuple[MotionLimits, np.ndarray]:
    """Return limits and a polyline."""
    rng = np.random.default_rng(seed)
    n, w = int(rng.integers(1, 8)), int(rng.integers(2, 9))
    limits = MotionLimits(
        rng.uniform(0.5, 3.0, n),
        rng.uniform(1.0, 10.0, n),
        rng.uniform(20.0, 500.0, n) if jerk else np.full(n, np.inf),
    )
    if gentle:
        steps = np.tile(rng.normal(size=n), (w, 1)) * rng.uniform(0.02, 0.3, (w, 1))
        return limits, np.cumsum(steps + rng.normal(size=(w, n)) * 0.003, axis=0)
    scale = 10.0 ** rng.uniform(-3, 0)
    return limits, np.cumsum(rng.normal(size=(w, n)) * scale, axis=0)


@settings(deadline=None)
@given(st.integers(0, 10**6), st.booleans(), st.booleans())
def test_no_limit_is_passed(seed: int, gentle: bool, jerk: bool) -> None:
    limits, path = drawn(seed, gentle=gentle, jerk=jerk)
    motion = smooth_path(limits, path)
    span = np.diff(motion.t)[:, None]
    assert np.all(span > 0.0)
    assert np.max(np.abs(motion.v) / limits.velocity) <= 1.0 + 1e-9
    assert np.max(np.abs(motion.a) / limits.acceleration) <= 1.0 + 1e-6
    jerks = np.abs(np.diff(motion.a, axis=0)) / span / limits.jerk
    assert np.max(jerks) <= 1.0 + 1e-6
    # What is said of speeds and accelerations is what positions do.
    a0, a1, v0 = motion.a[:-1], motion.a[1:], motion.v[:-1]
    assert np.allclose(np.diff(motion.v, axis=0), span * (a0 + a1) / 2, atol=1e-8)
    moved = span * v0 + span**2 * (2 * a0 + a1) / 6
    assert np.allclose(np.diff(motion.q, axis=0), moved, atol=1e-8)


@settings(deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_it_stays_on_the_path_but_for_gentle_corners(seed: int, gentle: bool) -> None:
    limits, path = drawn(seed, gentle=gentle)
    motion = smooth_path(limits, path)
    assert np.allclose(motion.q[0], path[0])
    assert np.allclose(motion.q[-1], path[-1])
    times = np.linspace(0.0, motion.seconds, 400)
    far = [distance_to(path, q) for q in positions(motion, times)]
    assert max(far) <= STRAY * 1.01 + 1e-9


def positions(motion: SmoothPath, times: np.ndarray) -> np.ndarray:
    """Integrate the motion from its rows."""
    k = np.clip(np.searchsorted(motion.t, times) - 1, 0, len(motion.t) - 2)
    h = (times - motion.t[k])[:, None]
    span = (motion.t[k + 1] - motion.t[k])[:, None]
    jerk = (motion.a[k + 1] - motion.a[k]) / span
    return motion.q[k] + h * motion.v[k] + h**2 * motion.a[k] / 2 + h**3 * jerk / 6


def distance_to(path: np.ndarray, q: np.ndarray) -> float:
    """Return the distance of a configuration from a polyline, all joints added up."""
    best = np.inf
    for a, b in zip(path, path[1:], strict=False):
        way = b - a
        share = np.clip((q - a) @ way / max(float(way @ way), 1e-30), 0.0, 1.0)
        best = min(best, float(np.abs(q - a - share * way).sum()))
    return best


@settings(deadline=None)
@given(st.integers(0, 10**6))
def test_it_stops_where_it_is_told_to(seed: int) -> None:
    limits, path = drawn(seed, gentle=True)
    stops = set(range(1, len(path) - 1))
    motion = smooth_path(limits, path, stops)
    for k in stops:
        row = int(np.argmin(np.abs(motion.t - motion.passed[k])))
        assert np.allclose(motion.q[row], path[k], atol=1e-9)
        assert np.allclose(motion.v[row], 0.0, atol=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_a_skill_along_a_straight_line_takes_the_least_time(seed: int) -> None:
    limits, path = drawn(seed)
    way = path[-1] - path[0]
    least = least_seconds(limits, way)
    # Whole numbers of time steps cost a little; waypoints on the line cost no more.
    between = path[0] + np.linspace(0.0, 1.0, 7)[:, None] * way
    for line in (between[[0, -1]], between):
        assert least * (1 - 1e-9) <= smooth_path(limits, line).seconds <= least * 1.03


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6))
def test_a_line_that_bends_gently_takes_little_longer_than_a_straight_one(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 8))
    limits = MotionLimits(
        np.full(n, 2.0), rng.uniform(3.0, 8.0, n), rng.uniform(60.0, 200.0, n)
    )
    # An arc of 15 degrees like that of a straight line of the tool, in small steps.
    turn = np.radians(np.linspace(0.0, 15.0, 33))
    plane = np.linalg.qr(rng.normal(size=(n, 2)))[0].T
    radius = rng.uniform(0.5, 1.5)
    path = radius * (
        np.sin(turn)[:, None] * plane[0] - np.cos(turn)[:, None] * plane[1]
    )
    # What the joints go in all, along a straight line with the greatest share of each.
    share = np.abs(np.diff(path, axis=0))
    longest = np.max(share / np.linalg.norm(share, axis=1)[:, None], axis=0)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    assert smooth_path(limits, path).seconds <= 1.1 * least_seconds(
        limits, longest * length
    )


def test_a_stop_at_a_corner_is_chosen_where_it_is_quicker() -> None:
    limits = MotionLimits(np.ones(2), np.full(2, 5.0), np.full(2, 100.0))
    turn = np.radians(15.0)
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1 + np.cos(turn), np.sin(turn)]])
    motion = smooth_path(limits, path)
    parts = (
        smooth_path(limits, path[:2]).seconds + smooth_path(limits, path[1:]).seconds
    )
    assert motion.seconds <= parts + 1e-9
    beside = positions(motion, motion.passed[1:2])
    assert np.allclose(beside, path[1], atol=STRAY)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_waypoints_that_are_given_twice_change_nothing(seed: int) -> None:
    limits, path = drawn(seed, gentle=True)
    twice = np.repeat(path, 2, axis=0)
    once, other = smooth_path(limits, path), smooth_path(limits, twice)
    assert np.allclose(once.t, other.t)
    assert np.allclose(once.q, other.q)
    assert np.allclose(np.repeat(once.passed, 2), other.passed)


def least_seconds(limits: MotionLimits, way: np.ndarray) -> float:
    """Return the least time along a straight line, from rest to rest."""
    ruckig = pytest.importorskip("ruckig")
    profile = ruckig.Ruckig(1)
    ask = ruckig.InputParameter(1)
    ask.current_position, ask.target_position = [0.0], [1.0]
    ask.max_velocity = [float(np.min(limits.velocity / np.abs(way)))]
    ask.max_acceleration = [float(np.min(limits.acceleration / np.abs(way)))]
    ask.max_jerk = [float(np.min(limits.jerk / np.abs(way)))]
    out = ruckig.Trajectory(1)
    profile.calculate(ask, out)
    return float(out.duration)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_without_a_limit_of_jerk_it_is_the_trapezoid(seed: int) -> None:
    limits, path = drawn(seed, jerk=False)
    way = path[-1] - path[0]
    v = np.min(limits.velocity / np.abs(way))
    a = np.min(limits.acceleration / np.abs(way))
    expected = 1 / v + v / a if v * v <= a else 2 / np.sqrt(a)
    found = straight_stretch(limits, way).seconds
    assert found == pytest.approx(expected, abs=2e-6)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_no_way_is_much_slower_than_the_least_time_with_jerk(seed: int) -> None:
    limits, path = drawn(seed)
    way = path[-1] - path[0]
    least = least_seconds(limits, way)
    stretch = straight_stretch(limits, way)
    assert stretch.seconds >= least * (1 - 1e-9)
    # The lag covers the worst of what may be commanded on the way, not only this motion.
    assert stretch.seconds <= least + stretch.lag


NEVER = 1e9


def stopped(
    limits: MotionLimits,
    motion: SmoothPath,
    slower: float,
    *stops: tuple[float, float],
) -> StoppedPath:
    def after(t: float) -> tuple[float, float]:
        return next((stop for stop in stops if stop[1] > t), (NEVER, NEVER))

    return stop_along_path(limits, motion, slower, 0.0, after)


@settings(deadline=None)
@given(
    st.integers(0, 10**6),
    st.booleans(),
    st.floats(1.0, 3.0),
    st.lists(st.tuples(st.floats(0.0, 1.2), st.floats(0.01, 1.0)), max_size=3),
)
def test_stopped_motions_keep_limits_and_the_path(
    seed: int, gentle: bool, slower: float, shares: list[tuple[float, float]]
) -> None:
    limits, path = drawn(seed, gentle=gentle)
    motion = smooth_path(limits, path)
    lasts = motion.seconds * slower
    stops, over = [], 0.0
    for begin, length in sorted(shares):
        low = max(begin * lasts, over + 1e-3)
        over = low + length
        stops.append((low, over))
    found = stopped(limits, motion, slower, *stops)
    t, q, v, a = found.rows()
    kept = np.append(True, np.diff(t) > 1e-12)
    t, q, v, a = t[kept], q[kept], v[kept], a[kept]
    span = np.diff(t)[:, None]
    assert np.max(np.abs(v) / limits.velocity) <= 1.0 + 1e-6
    assert np.max(np.abs(a) / limits.acceleration) <= 1.0 + 1e-6
    rise = np.abs(np.diff(a, axis=0))
    assert np.all(rise <= limits.jerk * span * (1.0 + 1e-6) + 1e-7)
    gained = span * (a[:-1] + a[1:]) / 2.0
    assert np.allclose(np.diff(v, axis=0), gained, atol=1e-8)
    moved = span * v[:-1] + span**2 * (2.0 * a[:-1] + a[1:]) / 6.0
    assert np.allclose(np.diff(q, axis=0), moved, atol=1e-8)
    assert np.allclose(q[-1], path[-1])
    assert max(distance_to(path, row) for row in q) <= STRAY * 1.01 + 1e-9
    assert t[-1] >= lasts - 1e-9
    assert found.stopped_times(lasts) == pytest.approx(t[-1])
    if not stops or stops[0][0] > lasts:
        assert t[-1] == pytest.approx(lasts)


def test_a_stop_in_the_middle_is_at_rest_about_as_soon_as_can_be() -> None:
    limits = MotionLimits(np.full(2, 2.0), np.full(2, 5.0), np.full(2, 100.0))
    motion = smooth_path(limits, np.array([[0.0, 0.0], [3.0, 1.0]]))
    found = stopped(limits, motion, 1.0, (0.8, 3.0))
    t, q, v, _ = found.rows()
    rest = float(t[(t > 0.8) & np.all(np.abs(v) < 1e-12, axis=1)].min())
    # From 2 rad/s at 5 rad/s^2, which build up in 50 ms: 0.45 s is the least.
    assert 0.45 <= rest - 0.8 <= 0.62
    stands = (t >= rest) & (t <= 3.0)
    assert np.allclose(q[stands], q[stands][0])
    # Before the stop nobody knows of it.
    free = motion.t <= 0.8 - motion.pieces[0].step
    assert np.allclose(q[: free.sum()], motion.q[free])


def test_at_the_very_end_a_skill_is_finished_first() -> None:
    limits = MotionLimits(np.full(2, 2.0), np.full(2, 5.0), np.full(2, 100.0))
    motion = smooth_path(limits, np.array([[0.0, 0.0], [1.0, 0.5]]))
    late = motion.seconds - 0.5 * motion.pieces[0].step
    found = stopped(limits, motion, 1.0, (late, late + 2.0))
    assert found.ends[-1] == late + 2.0
    assert len(found.pieces) == 1


LENGTHS = st.lists(st.floats(0.01, 2.0), min_size=2, max_size=12)
RAMPS = st.floats(0.05, 5.0)


def can_stop(
    length: list[float], top: list[float], node: int, last: int, entry: float, r: float
) -> bool:
    """Try it: brake as hard as possible from the end of a node, and watch every border."""
    speed = entry
    if last == node:
        return entry <= 0.0
    for k in range(node + 1, last + 1):
        if speed > min(top[k - 1], top[k]) * (1 + 1e-9):
            return False
        rest = speed * speed - 2.0 * length[k] / r
        if rest <= 0.0:
            return True
        speed = rest**0.5
    return speed <= 1e-9


@settings(deadline=None)
@given(LENGTHS, RAMPS, st.data())
def test_a_robot_leaves_a_node_as_fast_as_it_can_still_stop(
    lengths: list[float], ramp: float, data: st.DataObject
) -> None:
    tops = data.draw(
        st.lists(st.floats(0.1, 1.0), min_size=len(lengths), max_size=len(lengths))
    )
    last = data.draw(st.integers(0, len(lengths) - 1))
    node = data.draw(st.integers(0, last))
    bound = exit_bound(
        np.array(lengths), np.array(tops), node, last, np.full(len(lengths), ramp)
    )
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if can_stop(lengths, tops, node, last, middle, ramp):
            low = middle
        else:
            high = middle
    assert bound == pytest.approx(low, abs=1e-7)


@settings(deadline=None)
@given(st.floats(0.01, 3.0), st.floats(0.1, 1.0), RAMPS, st.data())
def test_a_piece_is_passed_in_the_least_time(
    length: float, top: float, ramp: float, data: st.DataObject
) -> None:
    entry = data.draw(st.floats(0.0, top))
    slowest = max(0.0, entry * entry - 2.0 * length / ramp) ** 0.5
    bound = data.draw(st.floats(slowest, top))
    took, leave, peak = passage_seconds(length, top, entry, bound, ramp)
    assert slowest - 1e-9 <= leave <= bound + 1e-12
    assert peak <= max(top, entry) + 1e-12
    # The oracle: at each place as fast as full acceleration from the start, the greatest
    # speed, and full braking before the end allow.
    s = np.linspace(0.0, length, 20001)
    middle = 0.5 * (s[1:] + s[:-1])
    fastest = np.minimum(
        np.sqrt(entry**2 + 2 * middle / ramp),
        np.sqrt(bound**2 + 2 * (length - middle) / ramp),
    )
    least = np.sum(np.diff(s) / np.minimum(fastest, top))
    assert took == pytest.approx(least, rel=2e-2)


@settings(deadline=None)
@given(st.floats(0.01, 3.0), st.floats(0.0, 1.0), RAMPS)
def test_braking_ends_at_rest_or_at_the_end_of_the_piece(
    length: float, entry: float, ramp: float
) -> None:
    took, leave, way = brake_within_piece(length, entry, ramp)
    assert leave == pytest.approx(entry - took / ramp, abs=1e-9)
    assert way == pytest.approx(0.5 * took * (entry + leave), abs=1e-9)
    assert leave == 0.0 or way == length
