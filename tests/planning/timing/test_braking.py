"""Stops in the middle of a skill: within limits, on the path, and no longer than need be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.robot_model import MotionLimits
from planning.timing.braking import StoppedPath, stopped_path
from planning.timing.smooth_path import STRAY, SmoothPath, smooth_path
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
