"""Speeds at borders: robots can always stop where they may not go on, and are no slower than that asks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.timing.stretch import braked, exit_bound, pass_through

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
