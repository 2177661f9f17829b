"""Stops in the middle of a skill, and speeds at borders: within limits, on the path, and no longer or slower than need be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.robot_model import MotionLimits
from planning.timing.braking import StoppedPath, stopped_path
from planning.timing.smooth_path import STRAY, SmoothPath, smooth_path
from planning.timing.stretch import braked, exit_bound, pass_through
from tests.planning.timing.test_motions_within_limits import distance_to, drawn

NEVER = 1e9


def stopped(
    limits: MotionLimits,
    motion: SmoothPath,
    slower: float,
    *stops: tuple[float, float],
) -> StoppedPath:
    def after(t: float) -> tuple[float, float]:
        return next((stop for stop in stops if stop[1] > t), (NEVER, NEVER))

    return stopped_path(limits, motion, slower, 0.0, after)


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
    assert found.when(lasts) == pytest.approx(t[-1])
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
    took, leave, peak = pass_through(length, top, entry, bound, ramp)
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
    took, leave, way = braked(length, entry, ramp)
    assert leave == pytest.approx(entry - took / ramp, abs=1e-9)
    assert way == pytest.approx(0.5 * took * (entry + leave), abs=1e-9)
    assert leave == 0.0 or way == length
