"""Transit planning on a plane world where right and wrong can be seen."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.motion.speed import (
    JointSpeed,
    L1Speed,
    cut_path,
    path_duration,
    path_times,
)
from planning.motion.transit import RrtConnect, shortcut_polyline
from planning.transforms import Array
from scheduling.synchronous.composite import CompositeSpeed


class _Discs:
    """Free space of the unit square without some discs."""

    def __init__(self, *discs: tuple[float, float, float]) -> None:
        self.discs = discs
        rows = np.array(discs).reshape(-1, 3)
        self._centres, self._radii = rows[:, :2], rows[:, 2]

    def configuration_free(self, q: Array) -> bool:
        return self.motion_free(q, q)

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        # Exact: pieces of what passes have to pass as well.
        way, ahead = q_b - q_a, self._centres - q_a
        share = np.clip(ahead @ way / max(float(way @ way), 1e-300), 0.0, 1.0)
        off = ahead - share[:, None] * way
        return bool(np.all(np.hypot(off[:, 0], off[:, 1]) > self._radii))

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        return all(self.configuration_free(q) for q in (q_b, 0.5 * (q_a + q_b)))


_START, _GOAL = np.array([0.05, 0.5]), np.array([0.95, 0.5])


def _planner() -> RrtConnect:
    return RrtConnect(np.zeros(2), np.ones(2), L1Speed(1.0), reach=0.2)


def _wall_with_gap() -> _Discs:
    return _Discs(*((0.5, y, 0.08) for y in np.arange(0.0, 0.9, 0.07)))


def test_a_free_line_is_taken_as_it_is() -> None:
    path = _planner().plan(_Discs(), _START, _GOAL, seed=0)
    assert path is not None
    assert np.array_equal(path, [_START, _GOAL])


@pytest.mark.parametrize("seed", range(5))
def test_the_gap_is_found_and_every_edge_is_free(seed: int) -> None:
    world = _wall_with_gap()
    path = _planner().plan(world, _START, _GOAL, seed)
    assert path is not None
    assert np.array_equal(path[0], _START)
    assert np.array_equal(path[-1], _GOAL)
    assert all(world.motion_free(a, b) for a, b in zip(path, path[1:], strict=False))


def test_the_same_seed_gives_the_same_path_whatever_ran_before() -> None:
    world = _wall_with_gap()
    first = _planner().plan(world, _START, _GOAL, seed=3)
    _planner().plan(world, _GOAL, _START, seed=8)
    again = _planner().plan(world, _START, _GOAL, seed=3)
    other = _planner().plan(world, _START, _GOAL, seed=4)
    assert first is not None
    assert again is not None
    assert np.array_equal(first, again)
    assert other is None or not np.array_equal(first, other)


@given(st.integers(0, 2**20), st.integers(1, 12))
@settings(max_examples=40, deadline=None)
def test_what_only_seems_free_is_gone_around(seed: int, count: int) -> None:
    """Discs far smaller than the steps of the trees, which hardly ever see them."""
    rng = np.random.default_rng(seed)
    discs = np.column_stack([rng.uniform(0.0, 1.0, (count, 2)), np.full(count, 0.03)])
    wall = [(0.5, y, 0.012) for y in np.arange(0.0, 0.9, 0.02)]
    world = _Discs(*map(tuple, discs.tolist()), *wall)
    if not (world.configuration_free(_START) and world.configuration_free(_GOAL)):
        return
    seeming = _Seeming(*world.discs)
    path = _planner().plan(seeming, _START, _GOAL, seed)
    if path is not None:
        assert np.array_equal(path[[0, -1]], [_START, _GOAL])
        assert all(world.motion_free(a, b) for a, b in pairwise(path))
        again = _planner().plan(seeming, _START, _GOAL, seed)
        assert again is not None
        assert np.array_equal(path, again)


class _Seeming(_Discs):
    """Discs that are not seen on the way, only where a motion ends."""

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        return self.configuration_free(q_b)


def test_the_wall_that_is_not_seen_is_gone_around() -> None:
    wall = [(0.5, y, 0.012) for y in np.arange(0.0, 0.9, 0.02)]
    path = _planner().plan(_Seeming(*wall), _START, _GOAL, seed=0)
    assert path is not None
    assert np.max(path[:, 1]) > 0.88


@pytest.mark.parametrize(("tours", "enough"), [(1, 500), (3, 1), (3, 500)])
def test_more_tours_never_make_a_rough_path_longer(tours: int, enough: int) -> None:
    world = _Discs((0.3, 0.5, 0.15), (0.7, 0.4, 0.2))
    planner = replace(
        _planner(), tours=tours, enough=enough, rough=0, smoothing=0, good_enough=1.0
    )
    one = replace(planner, tours=1)
    for seed in range(5):
        first = one.plan(world, _START, _GOAL, seed)
        path = planner.plan(world, _START, _GOAL, seed)
        assert first is not None
        assert path is not None
        assert path_duration(path, L1Speed()) <= path_duration(first, L1Speed())
        if 1 in (tours, enough):
            assert np.array_equal(path, first)


def test_no_way_ends_without_a_path() -> None:
    world = _Discs(*((0.5, y, 0.08) for y in np.arange(0.0, 1.05, 0.07)))
    planner = RrtConnect(np.zeros(2), np.ones(2), L1Speed(), reach=0.2, checks=300)
    assert planner.plan(world, _START, _GOAL, seed=0) is None


def test_smoothing_shortens_and_stays_free() -> None:
    world = _Discs((0.5, 0.5, 0.2))
    zigzag = np.array([_START, [0.1, 0.95], [0.4, 0.8], [0.6, 0.95], [0.9, 0.9], _GOAL])
    speed = L1Speed()
    rng = np.random.default_rng(0)
    path = shortcut_polyline(world, zigzag, speed, rng, 200)
    assert all(world.motion_free(a, b) for a, b in zip(path, path[1:], strict=False))
    # Over the disc and back is 0.9 + 2 * 0.2 in L1; the zigzag is 2.15.
    assert path_duration(path, speed) <= 1.1 * 1.3
    assert path_duration(path, speed) < path_duration(zigzag, speed)


@pytest.mark.parametrize("count", [None, 11])
def test_parts_keep_corners_goal_and_speed(count: int | None) -> None:
    path = np.array([[0.0, 0.0], [0.3, 0.1], [0.3, 0.1], [0.3, -0.22]])
    found = cut_path(path, L1Speed(2.0), 0.05, count)
    assert found is not None
    ends, seconds = found
    assert len(ends) == (count or 8)
    assert seconds.sum() == pytest.approx(0.72 / 2.0)
    assert np.all((seconds > 0.0) & (seconds <= 0.05 + 1e-12))
    assert any(np.allclose(end, [0.3, 0.1]) for end in ends)
    assert np.array_equal(ends[-1], path[-1])
    way = np.abs(np.diff(np.vstack([path[:1], ends]), axis=0)).sum(axis=1)
    assert np.allclose(way / seconds, 2.0)
    assert cut_path(path, L1Speed(2.0), 0.05, 7) is None


def test_joint_speed_waits_for_the_slowest_joint() -> None:
    model = JointSpeed(np.array([1.0, 0.25]))
    assert model.duration(np.zeros(2), np.array([1.0, 0.5])) == pytest.approx(2.0)


@given(st.integers(0, 2**20), st.integers(2, 5), st.booleans())
def test_durations_are_those_of_the_motions_one_by_one(
    seed: int, joints: int, limited: bool
) -> None:
    rng = np.random.default_rng(seed)
    path = rng.uniform(-3.0, 3.0, (6, joints))
    velocity = rng.uniform(0.1, 2.0, joints)
    both = CompositeSpeed(
        (L1Speed(0.7, velocity[:1]), JointSpeed(velocity[1:])),
        (slice(0, 1), slice(1, joints)),
    )
    l1 = L1Speed(0.7, velocity if limited else None)
    for speed in (l1, JointSpeed(velocity), both):
        steps = [speed.duration(a, b) for a, b in pairwise(path)]
        assert speed.durations(np.diff(path, axis=0)).tolist() == pytest.approx(steps)
        assert path_duration(path, speed) == pytest.approx(sum(steps))
        assert path_times(path, speed)[-1] == pytest.approx(sum(steps))
    travel = np.abs(path[1] - path[0])
    slowest = max(travel / velocity)
    assert JointSpeed(velocity).duration(*path[:2]) == pytest.approx(slowest)
    assert L1Speed(0.7).duration(*path[:2]) == pytest.approx(sum(travel) / 0.7)
    alone = [travel[0] / 0.7, travel[0] / velocity[0], *(travel / velocity)[1:]]
    assert both.duration(*path[:2]) == pytest.approx(max(alone))
